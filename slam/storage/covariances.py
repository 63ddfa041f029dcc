"""`covariances.npz`: covariance of each pose of a run.

Arrays `odometry` and `corrected`, (N, 6, 6) float64: covariance of the right perturbation `T_world_camera @ exp(xi)` of
each pose in the trajectory file of that name, in the camera frame, rotation before translation (rad, m), with the first
pose held fixed. The covariance of a position in the world is `R @ C[3:, 3:] @ R.T`, with R of the pose.
"""

from pathlib import Path

import numpy as np

from slam.record import RunRecord
from slam.storage.atomic import atomic_writer


def write_covariances(path: Path, record: RunRecord) -> None:
    """Write covariances.npz; an estimate without covariances is left out.

    Raises:
        OutputError: the file cannot be written.
    """
    known = {"odometry": record.odometry_covariances, "corrected": record.corrected_covariances}
    with atomic_writer(path, "wb") as file:
        np.savez_compressed(file, **{name: rows for name, rows in known.items() if rows is not None})  # type: ignore[arg-type]
