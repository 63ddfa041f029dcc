"""Executors of the benchmark: one process, or many on this machine or on others."""
