"""Roads, potholes, ray-cast LiDAR and camera, several vehicles."""
