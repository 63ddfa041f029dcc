"""New College (Smith, Baldwin, Churchill, Paul, Newman, IJRR 28(5) 2009), as the chapter uses it.

Every twentieth left image of the stereo camera, 512 x 384: 2,624 images at 1 Hz, of 52,480 at 20 Hz. Another dataset
has the same name: the New College of FAB-MAP, 1,073 pairs of images that look sideways.
"""

from pathlib import Path

import numpy as np

from slam.datasets.images import ImageSequence
from slam.datasets.named import find_named_images
from slam.errors import DataError

ORIGIN = "https://www.robots.ox.ac.uk/NewCollegeData (stereo images)"
STEP, FPS = 20, 1.0


def open_new_college(root: Path) -> ImageSequence:
    """Open the images unpacked anywhere below `root`: `StereoImages__<seconds>-left.pnm`.

    Raises:
        DataError: there are no such images.
    """
    if not root.is_dir():
        raise DataError(f"{root}: expected the New College recording, found nothing; get it from {ORIGIN}")
    pattern = r".*left.*\.(pnm|ppm|pgm|png|jpg)"
    files = find_named_images(root, pattern, "StereoImages__1225719868.172886-left.pnm", ORIGIN)[::STEP]
    return ImageSequence("New College", files, np.arange(len(files)) / FPS)
