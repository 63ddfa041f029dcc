"""What can go wrong for a user, as one family that the command line turns into one line and an exit code."""


class RevisitError(Exception):
    """Something the user can mend. The message names the file, what was expected and found, and the remedy."""


class DataError(RevisitError):
    """A recording, or one of its files, is missing, damaged or inconsistent."""


class OutputError(RevisitError):
    """Results cannot be written where they should go."""


class ConfigError(RevisitError):
    """A parameter has a value that cannot work."""


class GraphError(RevisitError):
    """A pose graph cannot be read or optimised."""
