"""Which engine the user has asked for."""

from slam.engine.cluster import Cluster
from slam.engine.engine import Engine, OneProcess
from slam.errors import ConfigError


def choose_engine(workers: int | None, scheduler: str | None, default: int) -> Engine:
    """What does the work.

    Args:
        workers: processes on this machine; 0 for this one alone, None where nothing was asked for.
        scheduler: address of a dask scheduler to use instead.
        default: workers where neither was asked for.

    Raises:
        ConfigError: there cannot be so many, or both are given, or dask is not installed.
    """
    if scheduler is not None and workers is not None:
        raise ConfigError("--scheduler: expected no --workers beside it, found both; the scheduler has its own")
    count = default if workers is None else workers
    if count < 0:
        raise ConfigError(f"--workers: expected 0 or more, found {count}")
    alone = count == 0 and scheduler is None
    return OneProcess() if alone else Cluster(count, scheduler)
