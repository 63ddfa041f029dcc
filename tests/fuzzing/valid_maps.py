"""Small valid map databases, and a reader that reads all of one."""

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from odometry.camera import StereoCamera
from odometry.motion import Motion
from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from place_recognition.recognizer import Belief
from slam.config import RunConfig, to_toml
from slam.errors import DataError
from slam.frame_record import FrameRecord, LoopRecord
from slam.loop_closing.loop_closer import FrameLandmarks, LoopClosure, Rejection
from slam.map_database.database import Checkpoint, LoopOutcome, MapDatabase, OptimizedSession, Session

FRAMES = 3


@cache
def map_stores() -> list[bytes]:
    """A drive of three frames that has ended, with its checkpoint."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.db"
        with MapDatabase.create(path) as store, store.writing():
            camera = StereoCamera(700.0, 700.0, 100.0, 50.0, 0.5, 200, 100)
            store.add_session(Session(0, 0, "drive", camera, to_toml(RunConfig()), {"recording": {"path": "drive"}}))
            for image in range(FRAMES):
                store.add_frame(_frame(image), 0)
            for number, candidate in enumerate(_candidates()):
                store.add_loop(number, candidate)
            store.set_checkpoint(0, Checkpoint(FRAMES, {"similarity_matrix": _rows().state()}))
            poses = np.tile(np.eye(4), (FRAMES, 1, 1))
            outcomes = {1: LoopOutcome(True, 1.0, 0.5, "kept")}
            store.finish(0, OptimizedSession(np.arange(FRAMES), poses, np.ones(FRAMES), outcomes), ended=True)
        return [path.read_bytes()]


def read_map(path: Path) -> None:
    """Read everything that a map holds, and put its parts together."""
    with MapDatabase.open(path) as store:
        for session in store.sessions():
            checkpoint = store.checkpoint(session.number)
            if checkpoint is not None:
                with store.reading():
                    MatrixRecorder().restore(checkpoint.state["similarity_matrix"])
        for frame in store.frames():
            if frame.landmarks.points.shape != (len(frame.landmarks), 3):
                raise DataError("landmarks without a place")
        list(store.loops())
        store.poses(), store.steps(), store.key_frames()


def _frame(image: int) -> FrameRecord:
    rng = np.random.default_rng(image)
    landmarks = FrameLandmarks(
        rng.random((4, 2)).astype(np.float32), rng.random((4, 3)).astype(np.float32),
        rng.integers(0, 255, 4).astype(np.uint8), rng.random((4, 8)).astype(np.float16),
    )  # fmt: skip
    motion = Motion(np.eye(4), 1e-4 * np.eye(6), False, "", inliers=np.ones(5, bool), residual_px=0.3)
    return FrameRecord(image, 0.1 * image, motion, np.eye(4), np.eye(4), landmarks, True, {"odometry": 1.0})


def _candidates() -> list[LoopRecord]:
    closure = LoopClosure(2, 0, np.eye(4), 1e-4 * np.eye(6), 30, 40)
    return [
        LoopRecord(1, Belief(1, None, 0.0, accepted=False), None),
        LoopRecord(2, Belief(2, 0, 9.0, accepted=True, inliers=20), closure),
        LoopRecord(None, Belief(2, 1, 8.0, accepted=True), Rejection("3 landmarks match", 3)),
    ]


def _rows() -> MatrixRecorder:
    rows = MatrixRecorder()
    rows.add(2, np.array([0, 1]), np.array([0.5, 0.25]))
    return rows
