"""Least squares on pose graphs: edges, Lie groups, solvers, covariances, scale."""
