"""Watching a run: the rerun recording, or nothing at all."""
