"""LiDARs, cameras, receivers and inertial units of a vehicle, and how they are configured."""
