"""The road of a sweep: what may be ground, its surface, its noise, the corridor ahead."""
