"""Vehicles told at once: the stream, and what vehicles at other servers were told."""
