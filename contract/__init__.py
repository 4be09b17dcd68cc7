"""The messages between vehicle and server: pydantic and the standard library, nothing else."""
