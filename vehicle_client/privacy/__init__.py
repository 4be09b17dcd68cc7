"""What leaves the vehicle: coarse places, rotating names, quiet zones."""
