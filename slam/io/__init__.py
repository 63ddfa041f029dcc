"""File formats of results; every file is written beside its place and renamed, so that none is ever half written."""
