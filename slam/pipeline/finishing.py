"""The end of a session: late matches, final optimisation, and their record. What fails is left out, and said."""

import numpy as np

from slam.map_database.session_merging import SessionResult
from slam.map_database.session_writer import SessionRecorder
from slam.pipeline.run_warnings import RunWarnings
from slam.pose_graph.pose_graph import PoseGraph
from slam.pose_graph.robust.backends import OptimizationResult
from slam.run_log import RunLog, log_loops
from slam.system import Slam


def finish_session(
    slam: Slam, robust: str, run_log: RunLog, recorder: SessionRecorder, warnings: RunWarnings, ended: bool
) -> SessionResult:
    """Process late beliefs, optimise the trajectory and record the end of the session.

    Args:
        slam: the system after its last frame.
        robust: name of the robust back end.
        run_log: log to which the late candidates are added.
        recorder: recorder of the session.
        warnings: takes what fails.
        ended: False for a run that was interrupted and may be resumed.
    """
    is_recorded = warnings.attempt_to("last checkpoint of map.db", recorder.write_checkpoint)
    late = warnings.attempt("late answers of the recogniser", slam.verify_late_beliefs, lambda _reason: ())
    log_loops(late)
    run_log.add_loops(late)
    optimized = optimize(slam.components.graph, robust, warnings)
    if not is_recorded:
        return SessionResult(optimized)
    return warnings.attempt(
        "end of the session in map.db, which --resume writes later",
        lambda: recorder.finish(late, optimized, ended),
        lambda _reason: SessionResult(optimized),
    )


def optimize(graph: PoseGraph, robust: str, warnings: RunWarnings) -> OptimizationResult:
    """The result of the robust back end; where it fails, that of the graph while driving."""

    def solve() -> OptimizationResult:
        optimized = graph.optimize(robust)
        if not np.isfinite(optimized.poses).all():
            raise RuntimeError("the back end has found poses that are not finite")
        return optimized

    what = "final optimisation, in whose place the corrected trajectory is that of the last frame"
    return warnings.attempt(what, solve, lambda reason: online_result(graph, reason))


def online_result(graph: PoseGraph, reason: str) -> OptimizationResult:
    """The poses and decisions of the graph while driving, in place of a final optimisation that failed.

    Args:
        graph: graph of all frames.
        reason: reason why the optimisation failed.
    """
    kept = np.zeros(len(graph.loops), bool)
    for event in graph.loop_events:
        kept[event.loop] = event.used
    words = ("kept while driving" if used else "not used while driving" for used in kept)
    poses = graph.poses()
    return OptimizationResult(
        poses=poses,
        weights=kept.astype(np.float64),
        residuals=np.full(len(kept), np.nan),
        kept=kept,
        reasons=tuple(f"{each}; the final optimisation failed: {reason}" for each in words),
        error_initial=float("nan"),
        error_final=float("nan"),
        seconds=float("nan"),
        scales=np.ones(len(poses)),
    )
