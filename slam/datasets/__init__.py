"""Recorded drives, read frame by frame."""
