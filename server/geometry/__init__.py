"""Places on the earth: geodesics, tiles, footprints, boxes of latitude and longitude."""
