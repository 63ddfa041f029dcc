"""Evaluation against ground truth: errors of trajectories, truth of loops, precision and recall of matches."""
