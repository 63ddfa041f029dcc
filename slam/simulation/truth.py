"""Which images of a drive show the same place."""

import numpy as np
from numpy.typing import NDArray

from slam.evaluation.loops import LoopRule, revisit_matrix

Array = NDArray[np.float64]

# The rule by which runs are judged, but for a longer way in between.
RULE = LoopRule(revisit_m=5.0, revisit_heading_deg=45.0, revisit_way_radii=10.0)


def loop_truth(T_world_camera: Array) -> NDArray[np.uint8]:
    """Matrix (N, N) of poses (N, 4, 4), metres: row = query image, column = earlier image, 1 = the same place.

    The same place: within 5 m, looking within 45 degrees of each other, with at least 50 m of way in between.
    """
    return revisit_matrix(T_world_camera, RULE).astype(np.uint8)
