"""Points near points: exact nearest neighbours of every point of a cloud."""
