"""Sensors on the vehicle: calibration, one clock, sweeps without the vehicle's own motion."""
