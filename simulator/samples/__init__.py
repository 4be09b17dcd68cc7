"""Single potholes and things as clouds, meshes and pictures, with their exact measures."""
