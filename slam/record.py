"""Record of a run in numpy: the common source of its files, figures and report."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.matrix import Matrix
from place_recognition.evaluation.precision_recall import PrecisionRecall

Array = NDArray[np.float64]

ONLINE_SEPARATOR = " | "  # between the changes of `StageRow.online`


@dataclass(frozen=True)
class LoopRow:
    """One row of the loop log `loops.csv`: what became of the belief about one query image.

    Attributes:
        query, match: frame indices.
        score: score of the recogniser, on its own scale.
        accepted: the recogniser took the match for a revisit.
        matches, inliers: number of landmark matches, and of those that agree with the relative pose; 0 where none
            were sought.
        verified: geometric verification found a relative pose.
        in_graph: the loop stands in the corrected graph.
        weight: weight that the robust back end gave it, 0 to 1; NaN where the loop never entered the graph.
        residual: square root of chi-square (6 degrees of freedom) after optimisation; NaN likewise.
        truth: whether it is a true revisit, by ground truth; None where there is none.
        reason: why it was kept or rejected, in words.
    """

    query: int
    match: int
    score: float
    accepted: bool
    matches: int = 0
    inliers: int = 0
    verified: bool = False
    in_graph: bool = False
    weight: float = float("nan")
    residual: float = float("nan")
    truth: bool | None = None
    reason: str = ""


@dataclass(frozen=True)
class StageRow:
    """One line of `loop_stages.csv`: what each stage measured of a belief; NaN and empty where it never got there.

    Attributes:
        query, match: frame indices.
        epipolar_inliers: number of matches that agree with one epipolar geometry; None where none was sought.
        epipolar_verified: False where that was tried and failed.
        x, y, z: position of the query's camera in the match's frame (right, down, forward), metres.
        turn_deg: angle between the two cameras, degrees.
        sigma_m, sigma_deg: standard deviation of position and angle along each axis, by the covariance of the pose.
        gate_residual: square root of chi-square (6 degrees of freedom) against odometry and its drift.
        gate_passed: the drift of odometry explains the loop; None where this was not tested.
        gate_reason: why, in words.
        online: events of the loop in the online graph, `frame 120: waits ...`, separated by ` | `.
    """

    query: int
    match: int
    epipolar_inliers: int | None = None
    epipolar_verified: bool = True
    x: float = float("nan")
    y: float = float("nan")
    z: float = float("nan")
    turn_deg: float = float("nan")
    sigma_m: float = float("nan")
    sigma_deg: float = float("nan")
    gate_residual: float = float("nan")
    gate_passed: bool | None = None
    gate_reason: str = ""
    online: str = ""


@dataclass(frozen=True)
class MatchedPixels:
    """Pixels where two images show the same points and agree with one geometry, whether the loop was kept or not.

    Attributes:
        query, match: frame indices.
        pixels_query, pixels_match: (K, 2) float32 in the two left images, pixels.
        agree_with: the geometry: "one relative pose" or else "one epipolar geometry".
    """

    query: int
    match: int
    pixels_query: NDArray[np.float32]
    pixels_match: NDArray[np.float32]
    agree_with: str = "one relative pose"


@dataclass(frozen=True)
class PointCloud:
    """Points of the landmark map.

    Attributes:
        points: (N, 3) metres, world frame (first camera: x right, y down, z forward).
        grey: (N,) uint8, brightness in the image.
    """

    points: Array
    grey: NDArray[np.uint8]


@dataclass(frozen=True)
class RunRecord:
    """Everything known after a run.

    Attributes:
        name: name of the dataset.
        timestamps: (N,) seconds.
        odometry: T_world_camera (N, 4, 4) by odometry alone, metres.
        online: (N, 4, 4) the estimate of each frame at the moment it was processed.
        corrected: (N, 4, 4) after the final optimisation.
        ground_truth: (N, 4, 4), or None where it is not known.
        predicted: (N,) bool, frames whose motion was extrapolated.
        inliers: (N,) int, number of tracks that agree with the motion.
        loops: the loop log, by query.
        stage_ms: milliseconds of each stage for each frame, stage name to (N,).
        map_before, map_after: the landmarks on the odometry and on the corrected trajectory.
        metrics: what goes into metrics.json, nested.
        stages: what each stage measured, for each row of the loop log.
        matched: matched pixels, of the rows whose images agree with a geometry.
        curve: precision over recall of the recogniser; None without ground truth.
        matrices: similarity matrices of the recogniser by stage, "similarity" and "filtered".
        odometry_covariances, corrected_covariances: (N, 6, 6) of right perturbations, rotation first (rad, m), the
            first pose fixed; None where they are not known.
    """

    name: str
    timestamps: Array
    odometry: Array
    online: Array
    corrected: Array
    ground_truth: Array | None
    predicted: NDArray[np.bool_]
    inliers: NDArray[np.int64]
    loops: tuple[LoopRow, ...]
    stage_ms: dict[str, Array]
    map_before: PointCloud
    map_after: PointCloud
    metrics: dict[str, object]
    stages: tuple[StageRow, ...] = ()
    matched: tuple[MatchedPixels, ...] = ()
    curve: PrecisionRecall | None = None
    matrices: Mapping[str, Matrix] = field(default_factory=dict)
    odometry_covariances: Array | None = None
    corrected_covariances: Array | None = None
