"""Which images of a drive show the same place."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RADIUS = 5.0  # metres
HEADING = np.radians(45.0)
APART = 50.0  # metres of way


def loop_truth(
    poses: Array, radius: float = RADIUS, heading: float = HEADING, apart: float = APART
) -> NDArray[np.uint8]:
    """Matrix (N, N): row = query image, column = earlier image, 1 = the same place seen the same way round.

    The same place: within `radius` metres, looking within `heading` radians of each other, with at least
        `apart` metres driven in between (so that the images just before are no revisits). poses:
        T_world_camera (N, 4,
    4).
    """
    positions, forward = poses[:, :3, 3], poses[:, :3, 2]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    truth = np.zeros((len(poses), len(poses)), dtype=np.uint8)
    for query in range(len(poses)):
        near = np.linalg.norm(positions[:query] - positions[query], axis=1) <= radius
        same_way = forward[:query] @ forward[query] >= np.cos(heading)
        truth[query, :query] = near & same_way & (way[query] - way[:query] >= apart)
    return truth
