"""The detector on a survey: a dense patch of road without one viewpoint."""
