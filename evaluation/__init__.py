"""Figures that prove things: the paper's tables, real scans, LiDAR at range, passes over the same obstacle."""
