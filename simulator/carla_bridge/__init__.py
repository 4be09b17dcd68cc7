"""Recordings from a running CARLA server. The only part of the simulator that talks to one."""
