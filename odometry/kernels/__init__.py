"""Compiled inner loops of the three adjustments: residuals, Jacobians, and the Schur complement they share."""
