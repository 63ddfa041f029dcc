"""Drives in the layout of TUM RGB-D (Sturm et al., IROS 2012), of which the colour images are read.

`[NAME/]{rgb.txt, rgb/<seconds>.png, groundtruth.txt}`. The layout has no place for the calibration: it is taken from a
`camera.toml` beside `rgb.txt`, else from the name of the sequence.
"""

import re
from pathlib import Path

from slam.datasets.assembly import Recording, assemble, read_eye, read_true_way
from slam.datasets.camera_drive import CameraDrive
from slam.datasets.camera_file import NAME, CameraFile, read_camera_file
from slam.datasets.folders import find_drive
from slam.datasets.left_images import ImageRecording, RawImages, left_images
from slam.datasets.lens import Lens
from slam.datasets.source import Source
from slam.datasets.stamped import BLANKS_SECONDS
from slam.errors import DataError

# Colour cameras of the benchmark by the number of the place (its page "Intrinsic Camera Calibration of the Kinect").
FREIBURG = {
    "1": Lens(517.306, 516.469, 318.643, 255.314, "radtan", (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)),
    "2": Lens(520.909, 521.007, 325.141, 249.702, "radtan", (0.231222, -0.784899, -0.003257, -0.000105, 0.917205)),
    "3": Lens(535.4, 539.2, 320.1, 247.6),
}


def is_tum_rgbd(folder: Path) -> bool:
    """Whether a folder is one drive in this layout."""
    return (folder / "rgb.txt").is_file()


def open_tum_rgbd(source: Source) -> CameraDrive:
    """Open a drive and check everything but the images themselves.

    Raises:
        DataError: one line that names the file, what was expected and found, and the remedy.
    """
    folder = _folder(source)
    camera = _camera(folder)
    if camera is None:
        raise DataError(
            f"{folder / NAME}: expected the calibration, as the folder's name has no freiburg1, 2 or 3, found none;"
            " write one with fx, fy, cx and cy"
        )
    left, truth = read_eye(folder / "rgb.txt", folder, BLANKS_SECONDS), folder / "groundtruth.txt"
    way = read_true_way(truth, left) if truth.is_file() else None
    return assemble(Recording(folder.absolute().name, left, truth=way), camera.rectification)


def left_of_tum_rgbd(source: Source) -> ImageRecording:
    """The colour images, straightened where the camera is known.

    Raises:
        DataError: one line that names the file, what was expected and found, and the remedy.
    """
    folder = _folder(source)
    if _camera(folder) is not None:
        return left_images(open_tum_rgbd(source))
    eye = read_eye(folder / "rgb.txt", folder, BLANKS_SECONDS)
    return RawImages(folder.absolute().name, eye.images, eye.times)


def _folder(source: Source) -> Path:
    return find_drive(source.path, source.sequence, is_tum_rgbd, "rgb.txt")


def _camera(folder: Path) -> CameraFile | None:
    path = folder / NAME
    if path.is_file():
        return read_camera_file(path)
    place = re.search(r"freiburg([123])", folder.absolute().name)
    return None if place is None else CameraFile(path, FREIBURG[place.group(1)])
