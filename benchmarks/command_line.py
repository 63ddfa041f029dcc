"""The command line of all benchmarks: a wrong path, or another error of the user's, is one line and exit code 1."""

import sys
from collections.abc import Callable
from pathlib import Path

from slam.errors import DataError, RevisitError


def existing(path: str) -> Path:
    """Return the path of an input; for argparse.

    Raises:
        DataError: there is nothing.
    """
    if not Path(path).exists():
        raise DataError(f"{path}: expected a file or a folder, found nothing; check the path")
    return Path(path)


def run_script(main: Callable[[], object]) -> None:
    """Run the main function of a benchmark and end the process."""
    try:
        main()
    except (RevisitError, OSError) as error:
        sys.exit(f"{Path(sys.argv[0]).name}: {error}")
