"""Are the closed loops true, and how many were missed? By ground truth poses and a declared rule.

The protocol alone moves the figures of the literature, so it is one dataclass with every number in it.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from place_recognition.evaluation.ground_truth import RevisitRule, truth_from_poses
from slam.record import LoopRow

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LoopRule:
    """What counts as a true loop and as a revisit that should have been found.

    Attributes:
        near_m: a pair of images shows one place when the cameras stood at most this far apart, metres.
        max_translation_m: a measured relative pose may differ from ground truth by this, metres; KITTI's own
            ground truth disagrees with itself by a metre or so between two passes.
        max_rotation_deg: the same for the rotation, degrees.
        revisit: when an image comes back to the place of an earlier one.
    """

    near_m: float = 10.0
    max_translation_m: float = 3.0
    max_rotation_deg: float = 10.0
    revisit: RevisitRule = field(default_factory=RevisitRule)


@dataclass(frozen=True)
class LoopCounts:
    """The counts of metrics.json; None where there is no ground truth or nothing to divide by.

    Attributes:
        proposed: beliefs that the recogniser accepted.
        verified: those proved by geometry.
        kept: those that stand in the corrected graph.
        true, false: of the kept ones, by ground truth.
        precision: true over kept.
        recall: revisits with a true kept loop over all revisits among the queries.
        reasons: why a value is None, by its name.
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
        """The counts without the reasons, ready for metrics.json."""
        return {name: value for name, value in vars(self).items() if name != "reasons"}


def is_same_place(truth: Array, query: int, match: int, rule: LoopRule | None = None) -> bool:
    """Whether two frames of T_world_camera (N, 4, 4), metres, were taken within `near_m` of each other."""
    rule = rule or LoopRule()
    return float(np.linalg.norm(truth[query, :3, 3] - truth[match, :3, 3])) <= rule.near_m


def is_true_loop(truth: Array, query: int, match: int, T_match_query: Array, rule: LoopRule | None = None) -> bool:
    """Whether a measured loop is true: its pose (4, 4), metres, agrees with `truth` (N, 4, 4).

    How far apart the two cameras stood does not matter: down a straight street one sees a place from afar, and
    a right measurement of it is a right edge of the graph. For one camera, whose loops have no metric scale, ask
    `is_same_place`.
    """
    rule = rule or LoopRule()
    error = se3.inverse(T_match_query) @ se3.inverse(truth[match]) @ truth[query]
    near = float(np.linalg.norm(error[:3, 3])) <= rule.max_translation_m
    turned = np.degrees(se3.angle(error)) <= rule.max_rotation_deg
    return bool(near and turned)


def revisit_matrix(truth: Array, rule: LoopRule | None = None) -> NDArray[np.bool_]:
    """Which earlier frames a frame comes back to: (N, N), row = query, column = earlier frame.

    Args:
        truth: T_world_camera (N, 4, 4), metres.
        rule: what counts as a revisit; `rule.revisit.min_time_gap_s` must be 0, as no times are given.
    """
    return truth_from_poses(truth, rule=(rule or LoopRule()).revisit)


def find_revisits(truth: Array, rule: LoopRule | None = None) -> NDArray[np.bool_]:
    """Frames (N,) of T_world_camera (N, 4, 4), metres, that come back to a place as the rule declares."""
    return np.asarray(revisit_matrix(truth, rule).any(axis=1))


def count_loops(
    rows: Iterable[LoopRow], queries: NDArray[np.int64], truth: Array | None, rule: LoopRule | None = None
) -> LoopCounts:
    """Counts of a ledger.

    Args:
        rows: the ledger; `truth` of the rows is used where it is known, else it is the same place or not.
        queries: the frames that the recogniser was asked about, whether or not they have a row.
        truth: T_world_camera (N, 4, 4), metres, or None.
        rule: what counts as true and as a revisit.
    """
    rows = tuple(rows)
    kept = [row for row in rows if row.in_graph]
    proposed, verified = sum(row.accepted for row in rows), sum(row.verified for row in rows)
    if truth is None:
        reasons = dict.fromkeys(("true", "false", "precision", "recall"), "there is no ground truth")
        return LoopCounts(proposed, verified, len(kept), None, None, None, None, reasons)
    true = [row for row in kept if _is_true(row, truth, rule)]
    revisits = np.intersect1d(np.flatnonzero(find_revisits(truth, rule)), queries)
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
