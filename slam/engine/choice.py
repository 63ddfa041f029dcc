"""The executor that the options --workers and --scheduler ask for."""

from slam.engine.cluster import DaskExecutor
from slam.engine.engine import Executor, SerialExecutor
from slam.errors import ConfigError


def make_executor(workers: int | None, scheduler: str | None, default: int) -> Executor:
    """Make the executor for the options of a command.

    Args:
        workers: number of processes on this machine; 0 for this process alone, None if the option was not given.
        scheduler: address of a dask scheduler to use instead, or None.
        default: number of workers if neither option was given.

    Raises:
        ConfigError: the number of workers is negative, both options are given, or dask is not installed.
    """
    if scheduler is not None and workers is not None:
        raise ConfigError("--scheduler: expected no --workers beside it, found both; the scheduler has its own")
    count = default if workers is None else workers
    if count < 0:
        raise ConfigError(f"--workers: expected 0 or more, found {count}")
    alone = count == 0 and scheduler is None
    return SerialExecutor() if alone else DaskExecutor(count, scheduler)
