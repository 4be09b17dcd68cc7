"""Points in, obstacles out; knows no map, no network, no clock."""
