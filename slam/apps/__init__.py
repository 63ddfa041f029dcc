"""One file a command: what each command of the command line does."""
