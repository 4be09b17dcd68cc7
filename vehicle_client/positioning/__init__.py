"""Where the vehicle is: satellite fixes, heading and odometry joined."""
