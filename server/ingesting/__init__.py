"""Reports on their way in: checked, queued, decided in groups."""
