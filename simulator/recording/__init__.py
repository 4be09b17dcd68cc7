"""Recordings: what the sensors of several vehicles said, in CARLA's layout and as MCAP, with the truth beside it."""
