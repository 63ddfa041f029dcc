"""Options of `revisit places`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam.datasets.source import DatasetSpec
from slam.errors import ConfigError
from slam.parts import check_features, check_paradigm


@dataclass(frozen=True)
class PlacesOptions:
    """Input, output and settings of `revisit places`; the names are those of the command line.

    Attributes:
        source: recording of any supported kind.
        paradigm: name of the recogniser.
        out: folder for the results.
        sequence: name of the sequence; None where the source has only one.
        ground_truth: file with a matrix (.mat, .npz) or with poses; None to use the poses of the source.
        features: name of the local features.
        vocabulary: vocabulary file; None for the general vocabulary.
        descriptor: descriptor of `global-descriptor`.
        exclude: images less than this number of seconds old are no match; None to leave it to the recogniser.
        fps: images per second, where the source has no timestamps.
        seed: seed of every random generator.
        overwrite: whether to replace earlier results.
        kind: kind of the source; None to detect it.
        topics: topics of the left camera in a bag; empty to detect them.
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
    format: str | None = None
    topics: tuple[str, ...] = ()

    @property
    def recording(self) -> DatasetSpec:
        """The source with the options of how to read it."""
        return DatasetSpec(self.source, self.sequence, self.format, self.fps, self.topics)


def check_options(options: PlacesOptions) -> None:
    """Raise ConfigError for an unknown name or a number out of range."""
    check_paradigm(options.paradigm)
    check_features(options.features)
    if options.exclude is not None and not 0 <= options.exclude < np.inf:
        raise ConfigError(f"--exclude: expected seconds from 0, found {options.exclude}")
