"""Ground truth of place recognition: which images of a dataset show the same place."""

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.ground_truth import RevisitRule, truth_from_poses

Array = NDArray[np.float64]

# The rule by which runs are evaluated, with a longer minimum distance along the path.
RULE = RevisitRule(min_path_length_m=50.0)


def loop_truth(T_world_camera: Array) -> NDArray[np.uint8]:
    """Matrix (N, N) of poses (N, 4, 4), metres: row = query image, column = earlier image, 1 = the same place.

    The same place: within 10 m, looking within 45 degrees of each other, with at least 50 m of path in between.
    """
    return truth_from_poses(T_world_camera, rule=RULE).astype(np.uint8)
