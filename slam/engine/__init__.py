"""Executors: run many items in this process, in several on this machine, or on a dask cluster."""
