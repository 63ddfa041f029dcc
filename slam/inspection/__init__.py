"""A recording looked at before a run: `revisit check`."""
