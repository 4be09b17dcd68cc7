"""What cameras see of it: materials, light and sky."""
