"""How good was it? Trajectory and loop errors against ground truth."""
