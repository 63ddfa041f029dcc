"""What is driven: the settings of a simulated drive, and its path."""
