"""One vehicle: sensor source, pose, reporting, the obstacle map around it, alerts, AR frames."""
