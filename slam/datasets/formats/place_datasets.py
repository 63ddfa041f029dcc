"""Image datasets of published work on place recognition: City Centre, Malaga 2009 and New College.

Their images are found by name, anywhere below a folder, and selected as in the experiments of the chapter:

* City Centre (Cummins, Newman, IJRR 27(6) 2008, the data of FAB-MAP): 2,474 images, odd numbers from a camera that
  looks to the left, even numbers from one that looks to the right. The 1,237 images of the left camera are used.
* Malaga 2009, parking lot 6L (Blanco, Moreno, Gonzalez, Autonomous Robots 27(4) 2009): the left images of the rectified
  stereo pair, 1024 x 768 at 7.5 Hz: 3,474 of them.
* New College (Smith, Baldwin, Churchill, Paul, Newman, IJRR 28(5) 2009): every twentieth left image of the stereo
  camera, 512 x 384: 2,624 images at 1 Hz, of 52,480 at 20 Hz. Another dataset has the same name: the New College of
  FAB-MAP, 1,073 pairs of images that look sideways.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.formats.image_sequence import ImageSequence, natural_sort_key
from slam.errors import DataError

_CITY_CENTRE_ORIGIN = "http://www.ijrr.org/ijrr_2008/volume27-issue6/090961/3_data.htm (City Centre, images)"
_CITY_CENTRE_FPS = 7.0
_MALAGA_ORIGIN = "https://www.mrpt.org/Paper:Malaga_Dataset_2009 (parking 6L, rectified stereo images)"
_MALAGA_FPS = 7.5
_NEW_COLLEGE_ORIGIN = "https://www.robots.ox.ac.uk/NewCollegeData (stereo images)"
_NEW_COLLEGE_STEP, _NEW_COLLEGE_FPS = 20, 1.0  # every twentieth of 20 images per second


def find_named_images(root: Path, pattern: str, example: str, origin: str) -> tuple[Path, ...]:
    """Files below `root` whose whole name matches a pattern, in natural order of the names.

    Args:
        root: folder into which the dataset was unpacked.
        pattern: regular expression of a file name, matched without regard to case.
        example: a matching name, for the error message.
        origin: address from which the dataset can be downloaded, for the error message.

    Raises:
        DataError: no file matches, or two files have the same name (two datasets, or one unpacked twice).
    """
    name = re.compile(pattern, re.IGNORECASE)
    found = [path for path in root.rglob("*") if name.fullmatch(path.name) and path.is_file()]
    if not found:
        raise DataError(f"{root}: expected images such as {example}, found none; get them from {origin}")
    names = {path.name for path in found}
    if len(names) < len(found):
        raise DataError(
            f"{root}: expected each image once, found {len(found)} files of {len(names)} names; keep one set"
        )
    return tuple(sorted(found, key=lambda path: natural_sort_key(Path(path.name))))


def parse_times(files: Sequence[Path], fps: float) -> NDArray[np.float64]:
    """Times (N,) of images from their file names, seconds; at a fixed rate if the names have no increasing times.

    Args:
        files: N paths.
        fps: images per second of the fixed rate.
    """
    numbers = [re.search(r"\d+\.\d+", file.stem) for file in files]
    times = np.array([float(number.group()) if number else np.nan for number in numbers])
    return times if (np.diff(times) > 0).all() and np.isfinite(times).all() else np.arange(len(files)) / fps


def open_city_centre(root: Path) -> ImageSequence:
    """Open the images unpacked anywhere below `root`: `0001.jpg` to `2474.jpg`.

    Raises:
        DataError: there are no such images.
    """
    if not root.is_dir():
        raise DataError(f"{root}: expected the City Centre recording, found nothing; get it from {_CITY_CENTRE_ORIGIN}")
    both_cameras = find_named_images(root, r"\d+\.jpg", "0001.jpg", _CITY_CENTRE_ORIGIN)
    files = tuple(file for file in both_cameras if int(file.stem) % 2 == 1)
    return ImageSequence("City Centre", files, np.arange(len(files)) / _CITY_CENTRE_FPS)


def open_malaga(root: Path) -> ImageSequence:
    """Open the images unpacked anywhere below `root`: `CAMERA1_<seconds>_left.jpg`.

    Raises:
        DataError: there are no such images.
    """
    if not root.is_dir():
        raise DataError(f"{root}: expected the Malaga 6L recording, found nothing; get it from {_MALAGA_ORIGIN}")
    # If the raw images were unpacked too, the rectified ones are in a folder with this word in its name.
    rectified = next((item for item in sorted(root.rglob("*rectified*")) if item.is_dir()), root)
    pattern = r".*left.*\.(jpg|jpeg|png|bmp)"
    files = find_named_images(rectified, pattern, "CAMERA1_1228314331.283640_left.jpg", _MALAGA_ORIGIN)
    return ImageSequence("Malaga 2009 6L", files, parse_times(files, _MALAGA_FPS))


def open_new_college(root: Path) -> ImageSequence:
    """Open the images unpacked anywhere below `root`: `StereoImages__<seconds>-left.pnm`.

    Raises:
        DataError: there are no such images.
    """
    if not root.is_dir():
        raise DataError(f"{root}: expected the New College recording, found nothing; get it from {_NEW_COLLEGE_ORIGIN}")
    pattern = r".*left.*\.(pnm|ppm|pgm|png|jpg)"
    all_files = find_named_images(root, pattern, "StereoImages__1225719868.172886-left.pnm", _NEW_COLLEGE_ORIGIN)
    files = all_files[::_NEW_COLLEGE_STEP]
    return ImageSequence("New College", files, np.arange(len(files)) / _NEW_COLLEGE_FPS)
