"""Streets from OpenDRIVE maps."""
