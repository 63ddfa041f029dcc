"""Covariances of positions as 95 % confidence ellipses in plan view."""

import numpy as np
from numpy.typing import NDArray

from slam.evaluation.trajectory import Similarity, distances_along

Array = NDArray[np.float64]

_NUM_ELLIPSES = 24  # in a panel, evenly spread along the path
_SCALE = np.sqrt(5.991)  # square root of the 95 % quantile of chi-square with 2 degrees of freedom
_NUM_CORNERS = 48
_PLAN = np.array([0, 2])  # rows of x and z


def confidence_ellipses(poses: Array, covariances: Array, aligned: Similarity) -> Array:
    """Return outlines (K, 48, 2), x and z in metres, of the regions that hold the camera with 95 % confidence.

    Args:
        poses: T_world_camera, (N, 4, 4), metres.
        covariances: covariances of right perturbations, (N, 6, 6), rotation first.
        aligned: similarity from the frame of the poses to that of the picture.
    """
    distance_m = distances_along(poses)
    shown = np.unique(
        np.searchsorted(distance_m, np.linspace(0.0, distance_m[-1], _NUM_ELLIPSES + 1)[1:]).clip(
            max=len(distance_m) - 1
        )
    )
    R = aligned.scale * aligned.R @ poses[shown, :3, :3]
    plan = (R @ covariances[shown, 3:, 3:] @ np.swapaxes(R, 1, 2))[:, _PLAN[:, None], _PLAN]
    values, vectors = np.linalg.eigh(plan)
    angles = np.linspace(0.0, 2.0 * np.pi, _NUM_CORNERS)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    outlines = vectors @ (_SCALE * np.sqrt(values.clip(min=0.0))[:, :, None] * circle)
    centres = aligned.apply(poses[shown, :3, 3])[:, _PLAN]
    return centres[:, None, :] + np.swapaxes(outlines, 1, 2)
