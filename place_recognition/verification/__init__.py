"""Geometric verification: which earlier images belong to the present view, and which candidates agree."""
