"""What the driver sees: camera model, what to draw, and the drawing."""
