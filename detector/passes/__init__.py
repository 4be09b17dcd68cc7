"""What the sweeps of a pass show together: shapes, far obstacles, and whether a known place is empty."""
