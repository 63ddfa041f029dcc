"""How sure positions are, as ellipses in plan view."""

import numpy as np
from numpy.typing import NDArray

from slam.evaluation.trajectory import Similarity, distances_along

Array = NDArray[np.float64]

_SHOWN = 24  # ellipses in a panel, evenly spread along the way
_SCALE = np.sqrt(5.991)  # 95 % of 2 degrees of freedom
_CORNERS = 48
_PLAN = np.array([0, 2])  # x and z


def confidence_ellipses(poses: Array, covariances: Array, aligned: Similarity) -> Array:
    """Outlines (K, 48, 2) in metres of where the camera is with 95 % confidence, x and z.

    Args:
        poses: T_world_camera (N, 4, 4), metres.
        covariances: (N, 6, 6) of right perturbations, rotation first.
        aligned: moves the poses into the frame of the picture.
    """
    way = distances_along(poses)
    shown = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], _SHOWN + 1)[1:]).clip(max=len(way) - 1))
    R = aligned.scale * aligned.R @ poses[shown, :3, :3]
    plan = (R @ covariances[shown, 3:, 3:] @ np.swapaxes(R, 1, 2))[:, _PLAN[:, None], _PLAN]
    values, vectors = np.linalg.eigh(plan)
    angles = np.linspace(0.0, 2.0 * np.pi, _CORNERS)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    outlines = vectors @ (_SCALE * np.sqrt(values.clip(min=0.0))[:, :, None] * circle)
    centres = aligned.apply(poses[shown, :3, 3])[:, _PLAN]
    return centres[:, None, :] + np.swapaxes(outlines, 1, 2)
