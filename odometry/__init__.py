"""How did the camera move? Visual odometry that knows nothing of places, maps or files."""
