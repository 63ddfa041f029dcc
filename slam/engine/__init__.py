"""Who does the work: this process, or many, on this machine or on others."""
