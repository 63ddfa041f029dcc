"""Watching a run in the rerun viewer, live or from its recording."""
