"""Section 4.2.2: how the route travelled so far is remembered."""
