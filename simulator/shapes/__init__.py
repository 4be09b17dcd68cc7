"""Shapes of potholes, bumps and debris, as relief of the road or as meshes that lie on it."""
