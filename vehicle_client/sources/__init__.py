"""Where frames come from: recorded files and live sensors, as `LidarFrame`."""
