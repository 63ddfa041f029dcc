"""Localization: the pose of single images in a map that was saved before."""
