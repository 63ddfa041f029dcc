"""Parameter sweeps: every source with every paradigm, back end and seed, on one or several processes."""
