"""A correction is shown with the frame whose loop makes it, and others only now and then."""

from types import SimpleNamespace

import numpy as np
import pytest

from odometry.motion import Motion
from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from place_recognition.recognizer import Belief
from slam.datasets.dataset import Frame
from slam.loop_closing.loop_closer import LoopClosure
from slam.pipeline.visualization import RunVisualizer
from slam.pose_graph.online_loop_selection import LoopDecision
from slam.system import FrameResult, LoopCandidate
from slam.viewer.viewer import LoopView, NullViewer

IMAGE = np.zeros((4, 6), np.uint8)
STEP = np.eye(4)
STEP[2, 3] = 1.0


class Loops(NullViewer):
    """Remembers with which frames a loop came with the corrected trajectory."""

    def __init__(self) -> None:
        self.corrected: list[int] = []

    def show_loop(self, view: LoopView, poses: np.ndarray) -> None:
        if len(poses):
            self.corrected.append(view.query)


class Frames(list[Frame]):
    """Frames of a recording, as far as the viewer needs it."""

    def read_left(self, index: int) -> np.ndarray:
        return self[index].left


def result(index: int, sideways_m: float, is_used: bool) -> FrameResult:
    """A frame that closes a loop; it stands beside where its motion of one metre would bring it."""
    pose = np.eye(4)
    pose[[0, 2], 3] = sideways_m, index
    motion = Motion(STEP, np.eye(6), False, "")
    closure = LoopClosure(index, 0, np.eye(4), np.eye(6), inliers=40, matches=60)
    decision = LoopDecision(True, is_used, 0.5, "drift explains it")
    candidates = (LoopCandidate(Belief(index, 0, 9.0, True), closure, decision),)
    return FrameResult(Frame(index, 0.1 * index, IMAGE, IMAGE), motion, pose, pose, None, False, candidates, {})


def shown(sideways_m: list[float], is_used: bool = True) -> list[int]:
    viewer, graph = Loops(), SimpleNamespace(poses=lambda: np.eye(4)[None])
    slam = SimpleNamespace(components=SimpleNamespace(graph=graph))
    dataset = Frames(Frame(index, 0.1 * index, IMAGE, IMAGE) for index in range(len(sideways_m)))
    visualizer = RunVisualizer(slam, viewer, dataset, MatrixRecorder(10))
    for index, offset in enumerate(sideways_m):
        visualizer.show(result(index, offset, is_used))
    return viewer.corrected


def test_without_a_jump_every_tenth_loop_comes_with_the_trajectory():
    assert shown([0.0] * 25) == [0, 10, 20]


@pytest.mark.parametrize(("jump_m", "more"), [(0.4, []), (0.6, [4])])
def test_a_jump_that_is_seen_comes_with_the_trajectory_at_once(jump_m: float, more: list[int]):
    assert shown([0.0] * 4 + [jump_m] * 5) == [0, *more]


def test_a_loop_that_is_not_used_corrects_nothing():
    assert shown([0.0] * 4 + [5.0] * 5, is_used=False) == []
