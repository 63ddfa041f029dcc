"""A procedural town, driven and filmed: recorded drives with exact ground truth and no download."""
