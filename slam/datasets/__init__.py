"""Recorded datasets of every supported format, read frame by frame."""
