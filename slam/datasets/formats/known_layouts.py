"""Layouts of public recordings that are not read as they are: how they are recognised, and what makes them readable."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from slam.datasets.dataset import subfolders


@dataclass(frozen=True)
class KnownLayout:
    """A layout and its remedy.

    Attributes:
        name: name of the data set.
        matches: whether a folder is one recording in this layout.
        remedy: what to write, and where; {folder} is the folder.
    """

    name: str
    matches: Callable[[Path], bool]
    remedy: str


def _has(*names: str) -> Callable[[Path], bool]:
    return lambda folder: all((folder / name).exists() for name in names)


def _is_icl_nuim(folder: Path) -> bool:
    return (folder / "rgb").is_dir() and any(folder.glob("*.gt.freiburg"))


def _has_associations(folder: Path) -> bool:
    names = ("associations.txt", "associate.txt", "associated.txt", "association.txt")
    return (folder / "rgb").is_dir() and any((folder / name).is_file() for name in names)


LAYOUTS = (
    KnownLayout(
        "TartanAir",
        _has("image_left", "pose_left.txt"),
        "write {folder}/camera.toml with fx = 320, fy = 320, cx = 320, cy = 240, baseline = 0.25, fps = 10;"
        " pose_left.txt has other axes and is not read",
    ),
    KnownLayout(
        "TartanAir V2",
        _has("image_lcam_front"),
        "write {folder}/camera.toml with fx = 320, fy = 320, cx = 320, cy = 320, baseline = 0.25, fps = 10,"
        ' left = "image_lcam_front", right = "image_rcam_front"; the poses have other axes and are not read',
    ),
    KnownLayout(
        "ICL-NUIM",
        _is_icl_nuim,
        'write {folder}/camera.toml with fx = 481.2, fy = 480, cx = 319.5, cy = 239.5, fps = 30, left = "rgb", and use'
        " --mono; the poses are numbered, not timed, and are not read",
    ),
    KnownLayout(
        "4Seasons",
        _has("undistorted_images"),
        "write {folder}/undistorted_images/camera.toml with fx, fy, cx, cy and baseline from the undistorted_calib"
        " files, and name the folder undistorted_images: the times are in the names of its images",
    ),
    KnownLayout(
        "4Seasons",
        _has("distorted_images", "times.txt"),
        "unpack undistorted_images too, and name that folder with a camera.toml in it",
    ),
    KnownLayout(
        "RGB-D with associations",
        _has_associations,
        "write {folder}/rgb.txt with a time in seconds and the file of its image, such as rgb/1.png, in each line",
    ),
)


def describe_known_layout(path: Path) -> str:
    """Return the name of the layout of a folder, or of one directly below, and its remedy; an empty text if unknown."""
    for folder in (path, *subfolders(path)):
        layout = next((layout for layout in LAYOUTS if layout.matches(folder)), None)
        if layout is not None:
            return f"this is the layout of {layout.name}: {layout.remedy.format(folder=folder)}"
    return ""
