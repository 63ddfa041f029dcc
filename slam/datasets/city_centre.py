"""City Centre (Cummins, Newman, IJRR 27(6) 2008, the data of FAB-MAP), as the chapter uses it.

2,474 images that look to the left (odd numbers) and to the right (even numbers): the 1,237 of one camera.
"""

from pathlib import Path

import numpy as np

from slam.datasets.images import ImageSequence
from slam.datasets.named import images_named
from slam.errors import DataError

ORIGIN = "http://www.ijrr.org/ijrr_2008/volume27-issue6/090961/3_data.htm (City Centre, images)"
RATE = 7.0


def open_city_centre(root: Path) -> ImageSequence:
    """Open the recording unpacked somewhere below `root`: `0001.jpg` to `2474.jpg`.

    Raises:
        DataError: there are no such images.
    """
    if not root.is_dir():
        raise DataError(f"{root}: expected the City Centre recording, found nothing; get it from {ORIGIN}")
    files = [file for file in images_named(root, r"\d+\.jpg", "0001.jpg", ORIGIN) if int(file.stem) % 2 == 1]
    return ImageSequence("City Centre", tuple(files), np.arange(len(files)) / RATE)
