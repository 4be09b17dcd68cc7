"""The OGC API - Features (part 1: core) on the obstacles, for GIS programs."""
