"""`revisit locate`: the poses of images in a saved map of the same camera."""

import json
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.markup import escape
from rich.table import Table
from scipy.spatial.transform import Rotation

from odometry.camera import StereoCamera
from place_recognition.image_processing.local_features import FeatureExtractor
from place_recognition.paradigms.registry import make_feature_extractor, with_preset
from slam.config import RunConfig, from_values
from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.image_sequence import IMAGE_SUFFIXES, ImageSequence
from slam.datasets.formats.recording import ImageDataset, LeftImages
from slam.datasets.formats.registry import open_images
from slam.errors import ConfigError, DataError
from slam.io.files import check_output_file
from slam.io.frames_and_loops_csv import write_table
from slam.localization.keyframe_map import SavedMap
from slam.localization.localizer import LocalizationResult, Localizer, NotLocalized
from slam.map_database.database import MapDatabase, map_file
from slam.pipeline.progress import progress_bar

Image = NDArray[np.uint8]

# Share of the image's width by which two calibrations of one camera may differ.
_CAMERA_TOLERANCE = 0.01
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")  # metres, and the quaternion of T_world_camera
_COLUMNS = (
    "image", "localized", *_POSE, "inliers", "position_sigma_m", "rotation_sigma_deg", "matched_image", "map_id",
    "reason",
)  # fmt: skip


@dataclass(frozen=True)
class Queries:
    """The images to be localized: one, those of a folder or video, or the left images of a dataset.

    Attributes:
        images: images of the map's camera; their order is not used.
        camera: camera of the map.
    """

    images: ImageDataset
    camera: StereoCamera

    def __len__(self) -> int:
        return len(self.images)

    def __iter__(self) -> Iterator[tuple[str, Image]]:
        """Yield the name and the content of each image.

        Raises:
            DataError: an image cannot be read, or its size is not that of the map's images.
        """
        for index in range(len(self)):
            name, image = self._name(index), self.images[index]
            if image.shape != (self.camera.height, self.camera.width):
                size = f"{self.camera.width} x {self.camera.height}"
                raise DataError(
                    f"{self._where(index)}: expected {size} pixels as in the map, found {image.shape[1]} x"
                    f" {image.shape[0]}; give images of the camera that made the map"
                )
            yield name, image

    def _name(self, index: int) -> str:
        return self.images.files[index].name if isinstance(self.images, ImageSequence) else self._where(index)

    def _where(self, index: int) -> str:
        return self.images.where(index) if isinstance(self.images, ImageSequence) else f"{self.images.name}:{index}"


def open_queries(source: DatasetSpec, camera: StereoCamera) -> Queries:
    """Open images that the camera of a map has taken.

    Raises:
        DataError: there are no images, or their calibration is that of another camera.
    """
    if source.path.is_file() and source.path.suffix.lower() in IMAGE_SUFFIXES:
        return Queries(ImageSequence(source.path.stem, (source.path,), None), camera)
    images = open_images(source)
    if isinstance(images, LeftImages):
        _compare(source.path, images.dataset.camera, camera)
    return Queries(images, camera)


def _compare(path: Path, found: StereoCamera, expected: StereoCamera) -> None:
    numbers = [np.array([camera.fx, camera.fy, camera.cx, camera.cy]) for camera in (found, expected)]
    if np.abs(numbers[0] - numbers[1]).max() > _CAMERA_TOLERANCE * expected.width:
        shown = [", ".join(f"{value:.1f}" for value in each) for each in numbers]
        raise DataError(
            f"{path}: expected the camera of the map, fx, fy, cx, cy = {shown[1]}, found {shown[0]};"
            " give images of the camera that made the map"
        )


@dataclass(frozen=True)
class LocateOptions:
    """Options of `revisit locate`.

    Attributes:
        map: map database, or the folder of a run that holds one.
        images: images to be localized.
        out: CSV file for the poses; None to write none.
    """

    map: Path
    images: DatasetSpec
    out: Path | None = None


@dataclass(frozen=True)
class QueryResult:
    """Result for one image.

    Attributes:
        name: name of the image.
        found: its pose, or why there is none.
    """

    name: str
    found: LocalizationResult | NotLocalized

    def cells(self) -> dict[str, object]:
        """Return the value of each column; None where there is none."""
        found = self.found
        values: dict[str, object] = dict.fromkeys(_COLUMNS)
        values |= {"image": self.name, "inliers": found.inliers, "matched_image": found.image}
        if isinstance(found, NotLocalized):
            return values | {"localized": False, "reason": found.reason}
        numbers = [*found.T_world_camera[:3, 3], *Rotation.from_matrix(found.T_world_camera[:3, :3]).as_quat()]
        pose = dict(zip(_POSE, map(float, numbers), strict=True))
        sigmas = {"position_sigma_m": found.sigma_m, "rotation_sigma_deg": found.sigma_deg}
        return values | pose | sigmas | {"localized": True, "map_id": found.map_id, "reason": ""}


def locate(options: LocateOptions, messages: Console) -> tuple[QueryResult, ...]:
    """Localize images in a saved map, and write the table of their poses if the options name a file.

    Raises:
        DataError: there is no map, there are no images, or they are of different cameras.
        OutputError: the table cannot be written; a missing or read-only folder is found before the work begins.
    """
    if options.out is not None:
        check_output_file(options.out)
    with MapDatabase.open(map_file(options.map)) as database:
        saved = SavedMap.open(database)
        queries = open_queries(options.images, saved.camera)
        localizer = Localizer(saved, _extractor(database))
        results = []
        with progress_bar(messages, "Locating") as progress:
            for name, image in queries:
                results.append(QueryResult(name, localizer.locate(image)))
                progress(len(results), len(queries))
    if options.out is not None:
        write_table(options.out, _COLUMNS, (result.cells().values() for result in results))
    return tuple(results)


def _extractor(database: MapDatabase) -> FeatureExtractor:
    """Return the extractor of the features that the map is made of."""
    try:
        config = from_values(RunConfig, tomllib.loads(database.sessions()[0].config), "settings")
        return make_feature_extractor(with_preset(config.paradigm, config.place_recognition))
    except (ConfigError, ValueError) as error:
        raise DataError(
            f"{database.path}: expected settings that this version reads, found others ({error}); make the map again"
        ) from error


def as_table(results: Sequence[QueryResult]) -> Group:
    """Format the results for people, one line for each image."""
    table = Table("image", "x m", "y m", "z m", "sigma m", "inliers", "matched image", "", box=None)
    for result in results:
        table.add_row(*_row(result.cells()))
    return Group(table, count_line(results))


def _row(cells: dict[str, object]) -> Iterable[str]:
    yield escape(str(cells["image"]))
    for name in ("x_m", "y_m", "z_m", "position_sigma_m"):
        yield "" if cells[name] is None else f"{cells[name]:.2f}"
    yield str(cells["inliers"])
    yield "" if cells["matched_image"] is None else str(cells["matched_image"])
    yield escape(f"not found: {cells['reason']}") if cells["reason"] else ""


def count_line(results: Sequence[QueryResult]) -> str:
    """Return in words how many images were localized."""
    return f"{sum(isinstance(result.found, LocalizationResult) for result in results)} of {len(results)} images found"


def as_json(results: Sequence[QueryResult]) -> str:
    """Format the results as JSON, for scripts."""
    return json.dumps([result.cells() for result in results], indent=2)
