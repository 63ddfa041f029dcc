"""Precision, recall and metric errors of closed loops by ground-truth poses and a declared rule.

Figures in the literature depend strongly on the rule, so it is one dataclass that holds every number of it.
The choice of the numbers: docs/decisions/evaluation_rules.md.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from place_recognition.evaluation.revisit_ground_truth import PoseTruth, RevisitRule, truth_from_poses
from slam.run_result import LoopRow, StageRow

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LoopRule:
    """Rule for true loops and for the revisits that should be found.

    Attributes:
        max_distance_m: maximum distance of two cameras at the same place, metres.
        max_translation_m: maximum translation error of a measured relative pose, metres. KITTI's own ground truth is
            inconsistent by about a metre between two passes.
        max_rotation_deg: maximum rotation error of a measured relative pose, degrees.
        revisit: rule by which an image is a revisit of an earlier one.
    """

    max_distance_m: float = 10.0
    max_translation_m: float = 3.0
    max_rotation_deg: float = 10.0
    revisit: RevisitRule = field(default_factory=RevisitRule)


@dataclass(frozen=True)
class LoopError:
    """Error of the relative pose of a measured loop by ground truth; NaN without ground truth.

    Attributes:
        translation_m: distance of the measured from the true position of the query's camera, metres.
        rotation_deg: angle between its measured and its true orientation, degrees.
    """

    translation_m: float = float("nan")
    rotation_deg: float = float("nan")


@dataclass(frozen=True)
class LoopCounts:
    """Counts of loops for metrics.json; None if there is no ground truth or nothing to divide by.

    Attributes:
        proposed: number of beliefs that the recogniser accepted.
        verified: number of loops whose relative pose was verified by geometry.
        kept: number of loops in the corrected graph.
        true, false: number of true and false ones among the kept loops, by ground truth.
        precision: share of the kept loops that are true.
        recall: share of the revisits among the queries that have a true kept loop.
        reasons: reason why a value is None, by the name of the value.
    """

    proposed: int
    verified: int
    kept: int
    true: int | None
    false: int | None
    precision: float | None
    recall: float | None
    reasons: dict[str, str] = field(default_factory=dict)

    def as_metrics(self) -> dict[str, object]:
        """Return the counts without the reasons, for metrics.json."""
        return {name: value for name, value in vars(self).items() if name != "reasons"}


def is_same_place(truth: Array, query: int, match: int, rule: LoopRule | None = None) -> bool:
    """Whether two frames of T_world_camera (N, 4, 4), metres, were taken within `max_distance_m` of each other."""
    rule = rule or LoopRule()
    return float(np.linalg.norm(truth[query, :3, 3] - truth[match, :3, 3])) <= rule.max_distance_m


def is_true_loop(truth: Array, query: int, match: int, T_match_query: Array, rule: LoopRule | None = None) -> bool:
    """Whether the relative pose (4, 4) of a measured loop, metres, agrees with the true poses (N, 4, 4).

    The distance of the two cameras does not matter: on a straight street a place is seen from afar, and a correct
    measurement of it is a correct edge of the graph. Use `is_same_place` for loops without metric scale.
    """
    rule = rule or LoopRule()
    error = loop_error(truth, query, match, T_match_query)
    return error.translation_m <= rule.max_translation_m and error.rotation_deg <= rule.max_rotation_deg


def loop_error(truth: Array, query: int, match: int, T_match_query: Array) -> LoopError:
    """Compute the error of the measured relative pose (4, 4) of a loop, metres, by true poses (N, 4, 4), metres."""
    # Motion that is left over: measured query frame to true query frame.
    error = se3.inverse(T_match_query) @ se3.inverse(truth[match]) @ truth[query]
    return LoopError(float(np.linalg.norm(error[:3, 3])), float(np.degrees(se3.angle(error))))


def kept_loop_errors(loops: Iterable[LoopRow], stages: Iterable[StageRow]) -> list[LoopError]:
    """Return the known errors of the loops that are in the corrected graph."""
    kept = {(row.query, row.match) for row in loops if row.in_graph}
    rows = [row for row in stages if (row.query, row.match) in kept and not np.isnan(row.translation_error_m)]
    return [LoopError(row.translation_error_m, row.rotation_error_deg) for row in rows]


def summarize_loop_errors(errors: Iterable[LoopError]) -> dict[str, dict[str, float] | None]:
    """Summarize the errors of the kept loops for metrics.json: median, 95th percentile and maximum; None without any.

    The 95th percentile is interpolated linearly between the two nearest errors.
    """
    rows = np.array([(error.translation_m, error.rotation_deg) for error in errors]).reshape(-1, 2)
    names = ("translation_error_m", "rotation_error_deg")
    return {name: _summarize(column) for name, column in zip(names, rows.T, strict=True)}


def _summarize(errors: Array) -> dict[str, float] | None:
    if not len(errors):
        return None
    return {"median": float(np.median(errors)), "p95": float(np.percentile(errors, 95)), "max": float(errors.max())}


def revisit_matrix(truth: Array, rule: LoopRule | None = None) -> NDArray[np.bool_]:
    """Compute which earlier frames each frame revisits: (N, N) bool, row = query, column = earlier frame.

    Args:
        truth: true poses T_world_camera (N, 4, 4), metres.
        rule: what counts as a revisit; `rule.revisit.min_time_gap_s` must be 0, because no times are given.
    """
    return truth_from_poses(truth, rule=(rule or LoopRule()).revisit)


def revisit_truth(truth: Array, rule: LoopRule | None = None) -> PoseTruth:
    """Return what `revisit_matrix` computes, cell by cell where it is asked for: for drives of any length."""
    return PoseTruth(truth, rule=(rule or LoopRule()).revisit)


def find_revisits(truth: Array, rule: LoopRule | None = None) -> NDArray[np.bool_]:
    """Whether each frame (N,) of true poses T_world_camera (N, 4, 4), metres, is a revisit by the rule."""
    return np.asarray(revisit_truth(truth, rule).any(axis=1))


def count_loops(
    rows: Iterable[LoopRow], queries: NDArray[np.int64], truth: Array | None, rule: LoopRule | None = None
) -> LoopCounts:
    """Count the loops of a recording and compare them with ground truth.

    Args:
        rows: rows of loops.csv; a row without `truth` is true if its two frames are at the same place.
        queries: indices of all query frames, whether or not they have a row.
        truth: true poses T_world_camera (N, 4, 4), metres, or None.
        rule: what counts as a true loop and as a revisit.
    """
    rows = tuple(rows)
    # A loop is a result only if it is in the graph; the others count as steps towards it.
    kept = [row for row in rows if row.in_graph]
    proposed, verified = sum(row.accepted for row in rows), sum(row.verified for row in rows)
    if truth is None:
        reasons = dict.fromkeys(("true", "false", "precision", "recall"), "there is no ground truth")
        return LoopCounts(proposed, verified, len(kept), None, None, None, None, reasons)
    true = [row for row in kept if _is_true(row, truth, rule)]
    revisits = np.intersect1d(np.flatnonzero(find_revisits(truth, rule)), queries)
    # By frames, not by loops: a revisit with two true loops counts once.
    found = np.intersect1d(revisits, [row.query for row in true])
    reasons = {} if kept else {"precision": "no loop was kept"}
    if len(revisits) == 0:
        reasons["recall"] = "no query is a revisit by ground truth"
    return LoopCounts(
        proposed=proposed,
        verified=verified,
        kept=len(kept),
        true=len(true),
        false=len(kept) - len(true),
        precision=_ratio(len(true), len(kept)),
        recall=_ratio(len(found), len(revisits)),
        reasons=reasons,
    )


def _is_true(row: LoopRow, truth: Array, rule: LoopRule | None) -> bool:
    return is_same_place(truth, row.query, row.match, rule) if row.truth is None else row.truth


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None
