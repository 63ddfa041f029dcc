"""Diagnostics of datasets and saved maps before they are used: `revisit check`."""
