"""The executor that the user asked for."""

from slam.engine.cluster import DaskExecutor
from slam.engine.engine import Executor, SerialExecutor
from slam.errors import ConfigError


def make_executor(workers: int | None, scheduler: str | None, default_workers: int) -> Executor:
    """Make an executor from the options `--workers` and `--scheduler`.

    Args:
        workers: number of processes on this machine; 0 for this process alone, None where the option is not given.
        scheduler: address of a dask scheduler to use instead; None where the option is not given.
        default_workers: number of processes where neither option is given.

    Raises:
        ConfigError: the number is negative, both options are given, or dask is not installed.
    """
    if scheduler is not None and workers is not None:
        raise ConfigError("--scheduler: expected no --workers beside it, found both; the scheduler has its own")
    count = default_workers if workers is None else workers
    if count < 0:
        raise ConfigError(f"--workers: expected 0 or more, found {count}")
    is_serial = count == 0 and scheduler is None
    return SerialExecutor() if is_serial else DaskExecutor(count, scheduler)
