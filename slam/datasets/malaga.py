"""Malaga 2009, parking lot 6L (Blanco, Moreno, Gonzalez, Autonomous Robots 27(4) 2009), as the chapter uses it.

The left images of the rectified stereo pair, 1024 x 768 at 7.5 Hz: 3,474 of them.
"""

from pathlib import Path

from slam.datasets.images import ImageSequence
from slam.datasets.named import find_named_images, parse_times
from slam.errors import DataError

ORIGIN = "https://www.mrpt.org/Paper:Malaga_Dataset_2009 (parking 6L, rectified stereo images)"
FPS = 7.5


def open_malaga(root: Path) -> ImageSequence:
    """Open the images unpacked anywhere below `root`: `CAMERA1_<seconds>_left.jpg`.

    Raises:
        DataError: there are no such images.
    """
    if not root.is_dir():
        raise DataError(f"{root}: expected the Malaga parking 6L recording, found nothing; get it from {ORIGIN}")
    # If the raw images were unpacked too, the rectified ones are in a folder with this word in its name.
    rectified = next((item for item in sorted(root.rglob("*rectified*")) if item.is_dir()), root)
    pattern = r".*left.*\.(jpg|jpeg|png|bmp)"
    files = find_named_images(rectified, pattern, "CAMERA1_1228314331.283640_left.jpg", ORIGIN)
    return ImageSequence("Malaga 2009 6L", files, parse_times(files, FPS))
