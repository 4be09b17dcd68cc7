"""A drive written as an MCAP file: what was measured, found, told and shown."""
