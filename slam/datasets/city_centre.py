"""City Centre (Cummins, Newman, IJRR 27(6) 2008, the data of FAB-MAP), as the chapter uses it.

The dataset has 2,474 images, odd numbers from a camera that looks to the left, even numbers from one that looks to the
right. The 1,237 images of the left camera are used.
"""

from pathlib import Path

import numpy as np

from slam.datasets.images import ImageSequence
from slam.datasets.named import find_named_images
from slam.errors import DataError

ORIGIN = "http://www.ijrr.org/ijrr_2008/volume27-issue6/090961/3_data.htm (City Centre, images)"
FPS = 7.0


def open_city_centre(root: Path) -> ImageSequence:
    """Open the images unpacked anywhere below `root`: `0001.jpg` to `2474.jpg`.

    Raises:
        DataError: there are no such images.
    """
    if not root.is_dir():
        raise DataError(f"{root}: expected the City Centre recording, found nothing; get it from {ORIGIN}")
    files = [file for file in find_named_images(root, r"\d+\.jpg", "0001.jpg", ORIGIN) if int(file.stem) % 2 == 1]
    return ImageSequence("City Centre", tuple(files), np.arange(len(files)) / FPS)
