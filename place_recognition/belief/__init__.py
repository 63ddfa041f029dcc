"""Section 4.2.3: how sure we are that a place has been seen before."""
