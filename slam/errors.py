"""Errors that a user can fix, as one family that the command line turns into one line and an exit code."""

import re

_MAX_LENGTH = 1000  # characters of a message: a damaged file can hold words of any length


class RevisitError(Exception):
    """An error that the user can fix. The message names the file, what was expected and found, and what to do.

    It is one line of printable characters, whatever a damaged file has brought into it.
    """

    def __str__(self) -> str:
        """The message."""
        line = re.sub(r"\s*[\r\n]\s*", " ", super().__str__())
        shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in line)
        if len(shown) <= _MAX_LENGTH:
            return shown
        return f"{shown[: _MAX_LENGTH - 300]} ... {shown[-200:]}"  # the remedy stands at the end


class DataError(RevisitError):
    """A dataset, or one of its files, is missing, damaged or inconsistent."""


class UnmeasuredError(DataError):
    """Hardly any motion of a recording could be measured; the results were written all the same."""


class OutputError(RevisitError):
    """Results cannot be written where they should go."""


class ConfigError(RevisitError):
    """A setting has an invalid value."""


class GraphError(RevisitError):
    """A pose graph cannot be read or optimised."""
