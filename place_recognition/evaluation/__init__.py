"""Section 4.3: ground truth, precision and recall."""
