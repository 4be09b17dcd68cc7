"""A picture of a whole recording."""
