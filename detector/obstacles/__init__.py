"""From deviations off the road to obstacles: clusters, what lies around them, how sure they are, their descriptors."""
