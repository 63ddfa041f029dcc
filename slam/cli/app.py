"""The command line `revisit`: registers the commands and turns errors into exit codes.

Only this module and the commands print.
"""

import errno
import sys
from collections.abc import Callable

import typer

from slam.cli import evaluate, inspect, places, run
from slam.cli.options import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_USAGE, FORMAT_NAMES
from slam.environment import NUMBA_CACHE, outlive_readers, prepare_consoles
from slam.errors import ConfigError, RevisitError

__all__ = ["EXIT_USAGE", "FORMAT_NAMES", "app", "main"]

app = typer.Typer(
    name="revisit",
    help="Visual SLAM with loop closing: from a recorded drive to a corrected trajectory and map.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
evaluate_app = typer.Typer(no_args_is_help=True)
app.add_typer(evaluate_app, name="evaluate", help="Measure results against ground truth.")
filter_app = typer.Typer(no_args_is_help=True)
app.add_typer(filter_app, name="filter", help="Train the filter of the similarity matrix for the sequence paradigms.")
vocabulary_app = typer.Typer(no_args_is_help=True)
app.add_typer(vocabulary_app, name="vocabulary", help="Train the visual words that some paradigms need in advance.")

for command in (
    run.demo,
    run.simulate,
    run.run,
    run.reprocess,
    places.places,
    evaluate.optimize,
    evaluate.benchmark,
    evaluate.explain,
    inspect.locate,
    inspect.info,
    inspect.check,
    inspect.export,
    inspect.view,
    run.dense,
    inspect.doctor,
):
    app.command()(command)
evaluate_app.command("trajectory")(evaluate.evaluate_trajectory)
evaluate_app.command("loops")(evaluate.evaluate_loops)
vocabulary_app.command("train")(places.train_vocabulary)
filter_app.command("train")(places.filter_train)

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # a full disk or quota is an error of the user's, not a bug

_CACHE_REMEDY = f"set {NUMBA_CACHE} to a folder of yours"


def main() -> None:
    """Run the command line; known errors become one line on standard error and an exit code."""
    prepare_consoles()
    outlive_readers()
    sys.exit(_exit_code(app))


def _exit_code(command: Callable[[], None]) -> int:
    try:
        command()
    except RevisitError as error:
        print(f"revisit: {error}", file=sys.stderr)
        return EXIT_USAGE if isinstance(error, ConfigError) else EXIT_FAILED
    except OSError as error:
        if error.errno not in _NO_ROOM:
            raise
        where = f"{error.filename}: " if error.filename else ""
        print(f"revisit: {RevisitError(f'{where}{error.strerror}; free some space')}", file=sys.stderr)
        return EXIT_FAILED
    except RuntimeError as error:
        if "cannot cache function" not in str(error):  # numba, where `prepare_caches` has found no folder either
            raise
        print(f"revisit: found no folder for compiled code that can be written; {_CACHE_REMEDY}", file=sys.stderr)
        return EXIT_FAILED
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except SystemExit as exit_:
        return exit_.code if isinstance(exit_.code, int) else EXIT_FAILED
    return 0
