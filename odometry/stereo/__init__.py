"""Odometry of a stereo pair."""
