"""The map of other drives, with which a new one begins."""

from dataclasses import dataclass
from pathlib import Path

from slam.config import RunConfig, parse_config
from slam.datasets.dataset import Dataset
from slam.errors import ConfigError, DataError
from slam.map_store.store import MapDatabase, Session, map_file


@dataclass(frozen=True)
class PriorMap:
    """A map that a drive may join.

    Attributes:
        map_file: where it is.
        last: the drive through it that ended last.
    """

    map_file: Path
    last: Session

    @property
    def config(self) -> RunConfig:
        """The settings it was made with, which a recogniser that goes on needs."""
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


def check_fits(known: PriorMap, drive: Dataset, config: RunConfig) -> None:
    """Check that a drive can be compared with those of a map.

    Raises:
        DataError: another camera.
        ConfigError: another recogniser or other features, one camera only, or no map to write.
    """
    file, made = known.map_file, known.config
    if drive.camera != known.last.camera:
        raise DataError(f"{file}: expected drives of one camera, {known.last.camera}, found {drive.camera}")
    if config.mono or made.mono:
        raise ConfigError("--map: expected a stereo pair: drives of one camera have no common unit of length")
    if (config.paradigm, config.place_recognition) != (made.paradigm, made.place_recognition):
        raise ConfigError(
            f"--map: expected the recogniser that made {file}, {made.paradigm}, with its settings, found others; "
            "leave them out"
        )
    if not config.save_map:
        raise ConfigError("--no-map: a drive that joins a map is kept in one; leave it out")
