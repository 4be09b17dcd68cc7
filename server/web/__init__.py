"""HTTP: endpoints, bodies, journal, errors at the edge."""
