"""What streets are built of: ground, buildings, plants, cars, people, as meshes."""
