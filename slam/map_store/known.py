"""The prior map: a map of earlier sessions that a new session is added to."""

from dataclasses import dataclass
from pathlib import Path

from slam.config import RunConfig, parse_config
from slam.datasets.dataset import Dataset
from slam.errors import ConfigError, DataError
from slam.map_store.store import MapDatabase, Session, map_file


@dataclass(frozen=True)
class PriorMap:
    """A map of earlier sessions.

    Attributes:
        map_file: path of the map database.
        last: the session that was added last.
    """

    map_file: Path
    last: Session

    @property
    def config(self) -> RunConfig:
        """The settings it was made with; a recogniser that continues needs the same."""
        return parse_config(self.last.config, f"{self.map_file}: settings")


def read_prior_map(path: Path) -> PriorMap:
    """The map in a file, or in a run's folder.

    Raises:
        DataError: there is none, it is damaged, or its last drive has not ended.
    """
    file = map_file(path)
    with MapDatabase.open(file) as store:
        sessions = store.sessions()
    if not sessions or not sessions[-1].finished:
        raise DataError(
            f"{file}: expected the map of a drive that has ended, found one that stopped; --resume it first"
        )
    return PriorMap(file, sessions[-1])


def check_fits(prior: PriorMap, dataset: Dataset, config: RunConfig) -> None:
    """Check that a dataset can be added to a map.

    Raises:
        DataError: another camera.
        ConfigError: another recogniser or other features, one camera only, or no map is written.
    """
    file, made = prior.map_file, prior.config
    if dataset.camera != prior.last.camera:
        raise DataError(f"{file}: expected sessions of one camera, {prior.last.camera}, found {dataset.camera}")
    if config.mono or made.mono:
        raise ConfigError("--map: expected a stereo pair: drives of one camera have no common unit of length")
    if (config.paradigm, config.place_recognition) != (made.paradigm, made.place_recognition):
        raise ConfigError(
            f"--map: expected the recogniser that made {file}, {made.paradigm}, with its settings, found others; "
            "leave them out"
        )
    if not config.save_map:
        raise ConfigError("--no-map: a drive that joins a map is kept in one; leave it out")
