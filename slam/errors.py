"""What can go wrong for a user, as one family that the command line turns into one line and an exit code."""

import re

_LONGEST = 1000  # characters of a message: a damaged file can hold words of any length


class RevisitError(Exception):
    """Something the user can mend. The message names the file, what was expected and found, and the remedy.

    It is one line that a terminal shows as it is, whatever a file brought into it.
    """

    def __str__(self) -> str:
        """The message."""
        line = re.sub(r"\s*[\r\n]\s*", " ", super().__str__())
        shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in line)
        if len(shown) <= _LONGEST:
            return shown
        return f"{shown[: _LONGEST - 300]} ... {shown[-200:]}"  # the remedy stands at the end


class DataError(RevisitError):
    """A recording, or one of its files, is missing, damaged or inconsistent."""


class OutputError(RevisitError):
    """Results cannot be written where they should go."""


class ConfigError(RevisitError):
    """A parameter has a value that cannot work."""


class GraphError(RevisitError):
    """A pose graph cannot be read or optimised."""
