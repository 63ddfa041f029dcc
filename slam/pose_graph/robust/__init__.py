"""Robust back ends: which loops of a pose graph can be trusted."""
