"""Record of a run in numpy: the common source of its files, figures and report."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.precision_recall import PrecisionRecall
from place_recognition.evaluation.similarity_matrix import SimilarityMatrix
from place_recognition.evaluation.stages import Reliability, StageResults

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LoopRow:
    """One row of the loop log `loops.csv`: the belief about one query image and its outcome.

    Attributes:
        query, match: frame indices.
        score: score of the recogniser, on its own scale.
        accepted: whether the recogniser accepted the match as a revisit.
        matches, inliers: number of landmark matches, and of those that agree with the relative pose; 0 where none
            were searched.
        verified: whether geometric verification found a relative pose.
        in_graph: whether the loop is in the corrected graph.
        weight: weight that the robust back end gave it, 0 to 1; NaN where the loop never entered the graph.
        residual: square root of chi-square (6 degrees of freedom) after optimisation; NaN likewise.
        truth: whether it is a true revisit by ground truth; None without ground truth.
        reason: reason why it was kept or rejected, in words.
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
    """One line of `loop_stages.csv`: what each stage measured of a belief; NaN or empty where a stage did not run.

    Attributes:
        query, match: frame indices.
        epipolar_inliers: number of matches that agree with one epipolar geometry; None where none was searched.
        epipolar_verified: False where that was tried and failed.
        x_m, y_m, z_m: position of the query's camera in the match's camera frame (right, down, forward), metres.
        rotation_deg: angle between the two cameras, degrees.
        position_sigma_m, rotation_sigma_deg: standard deviation of the relative pose along one axis, by its covariance.
        gate_sigma: square root of chi-square (6 degrees of freedom) of the loop against odometry and its drift.
        gate_passed: whether drift explains the loop; None where the gate was not reached.
        gate_reason: reason of the gate's decision, in plain words.
        translation_error_m, rotation_error_deg: error of the relative pose by ground truth; NaN without ground truth.
    """

    query: int
    match: int
    epipolar_inliers: int | None = None
    epipolar_verified: bool = True
    x_m: float = float("nan")
    y_m: float = float("nan")
    z_m: float = float("nan")
    rotation_deg: float = float("nan")
    position_sigma_m: float = float("nan")
    rotation_sigma_deg: float = float("nan")
    gate_sigma: float = float("nan")
    gate_passed: bool | None = None
    gate_reason: str = ""
    translation_error_m: float = float("nan")
    rotation_error_deg: float = float("nan")


@dataclass(frozen=True)
class LoopEventRow:
    """One line of `loop_events.csv`: a decision of the online pose graph about a verified loop.

    Attributes:
        query, match: frame indices of the loop.
        frame: index of the newest frame when the decision was made.
        in_graph: whether the online pose graph uses the loop from then on; False where it waits or was removed.
        reason: reason of the decision, in plain words.
    """

    query: int
    match: int
    frame: int
    in_graph: bool
    reason: str


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
    """Everything that the files and the report of a run are written from.

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
        metrics: contents of metrics.json, nested.
        stages: what each stage measured of each row of the loop log.
        events: decisions of the online pose graph about the verified loops, by query.
        matched: matched pixels of the rows whose images agree somewhere.
        curve: precision over recall of the recogniser; None without ground truth.
        place_stages: what each stage of the recogniser reaches; None without ground truth.
        reliability: how far its probabilities can be trusted; None without ground truth or probabilities.
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
    events: tuple[LoopEventRow, ...] = ()
    matched: tuple[MatchedPixels, ...] = ()
    curve: PrecisionRecall | None = None
    place_stages: StageResults | None = None
    reliability: Reliability | None = None
    matrices: Mapping[str, SimilarityMatrix] = field(default_factory=dict)
    odometry_covariances: Array | None = None
    corrected_covariances: Array | None = None
