"""Reports of a run: HTML pages, figures and tables."""
