"""What `revisit places` is asked to do."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam.datasets.source import DatasetSpec
from slam.errors import ConfigError
from slam.parts import check_features, check_paradigm


@dataclass(frozen=True)
class PlacesOptions:
    """Where to read and write, and how to recognise.

    Attributes:
        source: recording of any kind.
        paradigm: name of the recogniser.
        out: folder for the results.
        sequence: which of its sequences; None where there is only one.
        ground_truth: a matrix (.mat, .npz) or poses; None to use the poses that the source has.
        features: local ones, by name.
        vocabulary: file, or None for the general one.
        descriptor: of `global-descriptor`.
        exclude: images less than so many seconds old are no match; None for the recogniser's own guard alone.
        fps: images a second, where there are no times.
        seed: of every random generator.
        overwrite: replace earlier results.
        kind: of the source; None to recognise it.
        topics: of the left camera in a bag; empty to find it.
    """

    source: Path
    paradigm: str
    out: Path
    sequence: str | None = None
    ground_truth: Path | None = None
    features: str = "surf"
    vocabulary: Path | None = None
    descriptor: str = "hog"
    exclude: float | None = None
    fps: float | None = None
    seed: int = 0
    overwrite: bool = False
    kind: str | None = None
    topics: tuple[str, ...] = ()

    @property
    def recording(self) -> DatasetSpec:
        """What to read."""
        return DatasetSpec(self.source, self.sequence, self.kind, self.fps, self.topics)


def check(options: PlacesOptions) -> None:
    """Raise ConfigError for a name that does not exist or a number that cannot work."""
    check_paradigm(options.paradigm)
    check_features(options.features)
    if options.exclude is not None and not 0 <= options.exclude < np.inf:
        raise ConfigError(f"--exclude: expected seconds from 0, found {options.exclude}")
