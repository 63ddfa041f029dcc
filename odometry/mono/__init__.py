"""Odometry of one camera."""
