"""What one run leaves behind, in numpy: the common source of files, pictures and the report."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.matrix import SimilarityMatrix
from place_recognition.evaluation.precision_recall import PrecisionRecall

Array = NDArray[np.float64]

ONLINE_SEPARATOR = " | "  # between the changes of `StageRow.online`


@dataclass(frozen=True)
class LoopRow:
    """One line of the ledger `loops.csv`: what became of the belief about one query image.

    Attributes:
        query, match: frame indices.
        score: the recogniser's, on its own scale.
        accepted: the recogniser took the match for a revisit.
        matches, inliers: landmark matches, and those that agree with the relative pose; 0 where none were sought.
        verified: the relative pose was proved by geometry.
        in_graph: the loop stands in the corrected graph.
        weight: the robust back end's trust, 0 to 1; NaN where the loop never entered the graph.
        residual: square root of chi-square (6 degrees of freedom) after optimisation; NaN likewise.
        truth: whether it is a true revisit, by ground truth; None where there is none.
        reason: the verdict in plain words.
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
        epipolar_inliers: matches that agree with one epipolar geometry; None where none was sought.
        epipolar_verified: False where that was tried and failed.
        x, y, z: metres, where the query's camera is in the match's frame (right, down, forward).
        turn_deg: angle between the two cameras, degrees.
        sigma_m, sigma_deg: of position and angle along each axis, by the covariance of the relative pose.
        gate_residual: square root of chi-square (6 degrees of freedom) against odometry and its drift.
        gate_passed: drift explains the loop; None where it was not asked.
        gate_reason: in plain words.
        online: what became of the loop while driving: `frame 120: waits ...`, one after the other by ` | `.
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
    """Where two images show the same things, as far as geometry bears that out, believed in the end or not.

    Attributes:
        query, match: frame indices.
        pixels_query, pixels_match: (K, 2) float32 in the two left images, pixels.
        agree_with: what they agree with, "one relative pose" or else "one epipolar geometry".
    """

    query: int
    match: int
    pixels_query: NDArray[np.float32]
    pixels_match: NDArray[np.float32]
    agree_with: str = "one relative pose"


@dataclass(frozen=True)
class Cloud:
    """Points of the map.

    Attributes:
        points: (N, 3) metres, world frame (first camera: x right, y down, z forward).
        grey: (N,) uint8, brightness in the image.
    """

    points: Array
    grey: NDArray[np.uint8]


@dataclass(frozen=True)
class DriveRecord:
    """Everything known after a drive.

    Attributes:
        name: of the drive.
        timestamps: (N,) seconds.
        odometry: T_world_camera (N, 4, 4) by odometry alone, metres.
        online: (N, 4, 4) the estimate of each frame at the moment it was seen.
        corrected: (N, 4, 4) after the final optimisation.
        ground_truth: (N, 4, 4) or None.
        predicted: (N,) bool, frames whose motion was extrapolated.
        inliers: (N,) int, tracks that agree with the motion.
        loops: the ledger, by query.
        stage_ms: milliseconds of each stage for each frame, stage name to (N,).
        map_before, map_after: the landmarks on the odometry and on the corrected trajectory.
        metrics: what goes into metrics.json, nested.
        stages: what each stage measured of each row of the ledger.
        matched: of the rows whose images agree somewhere.
        curve: precision over recall of the recogniser; None without ground truth.
        matrices: what the recogniser thought of all pairs of images, by stage: "similarity", "filtered".
        odometry_covariances, corrected_covariances: (N, 6, 6) of right perturbations, rotation first (rad, m), the
            first pose held; None where they are not known.
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
    map_before: Cloud
    map_after: Cloud
    metrics: dict[str, object]
    stages: tuple[StageRow, ...] = ()
    matched: tuple[MatchedPixels, ...] = ()
    curve: PrecisionRecall | None = None
    matrices: Mapping[str, SimilarityMatrix] = field(default_factory=dict)
    odometry_covariances: Array | None = None
    corrected_covariances: Array | None = None
