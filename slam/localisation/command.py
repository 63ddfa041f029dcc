"""`revisit locate`: a saved map and images in, their poses out."""

import json
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console, Group
from rich.markup import escape
from rich.table import Table
from scipy.spatial.transform import Rotation

from place_recognition.image_processing.features import FeatureExtractor
from place_recognition.paradigms.catalogue import local_features
from slam.config import RunConfig, from_values
from slam.datasets.source import DatasetSpec
from slam.errors import ConfigError, DataError
from slam.localisation.images import open_queries
from slam.localisation.locator import Located, Locator, NotFound
from slam.localisation.saved_map import SavedMap
from slam.map_store.store import MapStore, map_file
from slam.progress import progress_bar
from slam.storage.tables import write_table

_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")  # metres, and the quaternion of T_world_camera
_COLUMNS = ("image", "found", *_POSE, "inliers", "sigma_m", "sigma_deg", "beside", "world", "reason")


@dataclass(frozen=True)
class LocateOptions:
    """What the user asks for.

    Attributes:
        map: a map store, or the folder of a run that holds one.
        images: to be placed.
        out: CSV file for the poses; None to write none.
    """

    map: Path
    images: DatasetSpec
    out: Path | None = None


@dataclass(frozen=True)
class Answer:
    """What became of one image.

    Attributes:
        name: of the image.
        found: its pose, or why there is none.
    """

    name: str
    found: Located | NotFound

    def cells(self) -> dict[str, object]:
        """The answer by its columns; None where it has no value."""
        found, values = self.found, dict.fromkeys(_COLUMNS)
        said: dict[str, object] = {"image": self.name, "found": isinstance(found, Located), "inliers": found.inliers}
        if isinstance(found, NotFound):
            return values | said | {"beside": found.image, "reason": found.reason}
        numbers = [*found.T_world_camera[:3, 3], *Rotation.from_matrix(found.T_world_camera[:3, :3]).as_quat()]
        pose = dict(zip(_POSE, map(float, numbers), strict=True))
        sigmas = {"sigma_m": found.sigma_m, "sigma_deg": found.sigma_deg}
        return values | said | pose | sigmas | {"beside": found.image, "world": found.world, "reason": ""}


def locate(options: LocateOptions, messages: Console) -> tuple[Answer, ...]:
    """Place images in a saved map, and write the table if that was asked for.

    Raises:
        DataError: no map, no images, or they do not belong together.
        OutputError: the table cannot be written.
    """
    with MapStore.open(map_file(options.map)) as store:
        saved = SavedMap.open(store)
        queries = open_queries(options.images, saved.camera)
        locator = Locator(saved, _extractor(store))
        answers = []
        with progress_bar(messages, "Locating") as progress:
            for name, image in queries:
                answers.append(Answer(name, locator.locate(image)))
                progress(len(answers), len(queries))
    if options.out is not None:
        write_table(options.out, _COLUMNS, (answer.cells().values() for answer in answers))
    return tuple(answers)


def _extractor(store: MapStore) -> FeatureExtractor:
    """Of the features that the map is made of."""
    try:
        config = from_values(RunConfig, tomllib.loads(store.sessions()[0].config), "settings")
        return local_features(config.places)
    except (ConfigError, ValueError) as error:
        raise DataError(
            f"{store.path}: expected the settings of its drive, found others ({error}); run again"
        ) from error


def as_table(answers: Sequence[Answer]) -> Group:
    """Poses for people, one image a line."""
    table = Table("image", "x m", "y m", "z m", "sigma m", "agree", "beside", "", box=None)
    for answer in answers:
        table.add_row(*_row(answer.cells()))
    return Group(table, said(answers))


def _row(cells: dict[str, object]) -> Iterable[str]:
    yield escape(str(cells["image"]))
    for name in ("x", "y", "z", "sigma_m"):
        yield "" if cells[name] is None else f"{cells[name]:.2f}"
    yield str(cells["inliers"])
    yield "" if cells["beside"] is None else str(cells["beside"])
    yield escape(f"not found: {cells['reason']}") if cells["reason"] else ""


def said(answers: Sequence[Answer]) -> str:
    """How many were found."""
    return f"{sum(isinstance(answer.found, Located) for answer in answers)} of {len(answers)} images found"


def as_json(answers: Sequence[Answer]) -> str:
    """The same for scripts."""
    return json.dumps([answer.cells() for answer in answers], indent=2)
