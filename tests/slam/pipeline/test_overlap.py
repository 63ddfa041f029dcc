"""The odometry of a frame overlaps all else about the frame before it: the same bits, and checkpoints of one moment."""

import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from slam.components import build_components
from slam.config import RunConfig
from slam.datasets.dataset import Dataset, Frame
from slam.datasets.formats.kitti import open_kitti
from slam.map_database.checkpoint import serialize
from slam.map_database.resume import system_state
from slam.map_database.session_writer import NullSessionRecorder
from slam.pipeline.pipeline import process_dataset
from slam.pipeline.result_files import PipelineResult
from slam.pipeline.run_warnings import RunWarnings
from slam.system import FrameResult, Slam
from slam.viewer.viewer import NullViewer

FRAMES, INTERVAL = 36, 7
CONFIG = RunConfig()


@dataclass
class Beginning:
    """The first frames of a drive."""

    drive: Dataset

    def __len__(self) -> int:
        return FRAMES

    def __getitem__(self, index: int) -> Frame:
        return self.drive[index]

    def __iter__(self) -> Iterator[Frame]:
        return (self.drive[index] for index in range(FRAMES))

    def __getattr__(self, name: str) -> Any:
        every = getattr(self.drive, name)
        return every[:FRAMES] if name in ("timestamps", "ground_truth") else every


@dataclass
class States(NullSessionRecorder):
    """Takes the state of all parts every few frames, or at the last one only; busy for a while with each frame."""

    interval: int = INTERVAL
    busy_s: float = 0.0
    states: dict[int, Any] = field(default_factory=dict)
    _done: int = 0

    def restore(self, slam: Slam, matrix: Any, run_log: Any) -> int:
        self._slam, self._matrix = slam, matrix
        return 0

    def announce_checkpoint(self) -> bool:
        return (self._done + 1) % self.interval == 0

    def add(self, result: FrameResult, stage_ms: dict[str, float]) -> None:
        time.sleep(self.busy_s)
        self._done += 1
        if self._done % self.interval == 0:
            self.write_checkpoint()

    def write_checkpoint(self) -> None:
        structure, arrays = serialize(system_state(self._slam.components, self._matrix))
        self.states[self._done] = repr(structure), [(array.dtype, array.shape, array.tobytes()) for array in arrays]


@pytest.fixture(scope="module")
def drive(circle_drive: Path) -> Beginning:
    return Beginning(open_kitti(circle_drive))


@pytest.fixture(scope="module")
def one_by_one(drive: Beginning) -> tuple[list[FrameResult], States]:
    """Each frame to its end before the next one begins."""
    slam, recorder, results = Slam(build_components(drive.camera, CONFIG)), States(), []
    recorder.restore(slam, NoRows(), None)
    for frame in drive:
        results.append(slam.process(frame))
        recorder.add(results[-1], {})
    recorder.write_checkpoint()
    return results, recorder


class NoRows:
    def state(self) -> None:
        return None


def run(drive: Beginning, recorder: States, monkeypatch: pytest.MonkeyPatch) -> PipelineResult:
    monkeypatch.setattr("slam.pipeline.pipeline.MatrixRecorder.state", lambda _self: None)
    quiet = Console(quiet=True)
    return process_dataset(drive, CONFIG, NullViewer(), RunWarnings(quiet, Path()), recorder)


@pytest.mark.parametrize("busy_s", [0.0, 0.05], ids=["odometry is slower", "all else is slower"])
def test_a_run_and_its_checkpoints_have_the_bits_of_one_frame_after_the_other(
    drive: Beginning,
    one_by_one: tuple[list[FrameResult], States],
    busy_s: float,
    monkeypatch: pytest.MonkeyPatch,
):
    results, expected = one_by_one
    recorder = States(busy_s=busy_s)
    found = run(drive, recorder, monkeypatch).run_log
    np.testing.assert_array_equal(found.odometry, [result.T_world_camera_odometry for result in results])
    np.testing.assert_array_equal(found.online, [result.T_world_camera for result in results])
    beliefs = [candidate.belief for result in results for candidate in result.candidates]
    assert [candidate.belief for candidate in found.candidates][: len(beliefs)] == beliefs
    assert recorder.states.keys() == expected.states.keys() == {*range(INTERVAL, FRAMES, INTERVAL), FRAMES}
    for done, (structure, arrays) in expected.states.items():
        assert recorder.states[done][0] == structure
        assert recorder.states[done][1] == arrays, f"checkpoint after {done} frames"


def test_odometry_runs_ahead_except_where_a_checkpoint_comes(drive: Beginning, monkeypatch: pytest.MonkeyPatch):
    events: list[tuple[str, int]] = []
    track, update = Slam._track, Slam.update

    def note_track(self: Slam, frame: Frame) -> Any:
        events.append(("odometry", frame.index))
        return track(self, frame)

    def note_update(self: Slam, measured: Any) -> FrameResult:
        time.sleep(0.05)  # the other thread has begun by now, if it may
        events.append(("all else", measured.frame.index))
        return update(self, measured)

    monkeypatch.setattr("slam.pipeline.pipeline.warm_up", lambda *_: None)
    monkeypatch.setattr(Slam, "_track", note_track)
    monkeypatch.setattr(Slam, "update", note_update)
    run(drive, States(), monkeypatch)
    ahead = [index for index in range(FRAMES - 1)
             if events.index(("odometry", index + 1)) < events.index(("all else", index))]  # fmt: skip
    assert ahead == [index for index in range(FRAMES - 1) if (index + 1) % INTERVAL]


def test_an_interrupted_run_stops_with_all_parts_at_the_same_frame(
    drive: Beginning, one_by_one: tuple[list[FrameResult], States], monkeypatch: pytest.MonkeyPatch
):
    class Interrupted(States):
        def add(self, result: FrameResult, stage_ms: dict[str, float]) -> None:
            if result.frame.index == INTERVAL - 2:
                signal.raise_signal(signal.SIGINT)
            super().add(result, stage_ms)

    recorder = Interrupted(interval=10**6)
    result = run(drive, recorder, monkeypatch)
    assert result.interrupted
    assert list(recorder.states) == [INTERVAL]  # the frame whose odometry was under way is the last one
    assert recorder.states[INTERVAL] == one_by_one[1].states[INTERVAL]


def test_an_error_of_the_odometry_comes_at_its_frame(drive: Beginning, monkeypatch: pytest.MonkeyPatch):
    track, seen = Slam._track, []

    def fail(self: Slam, frame: Frame) -> Any:
        if frame.index == 9:
            raise ZeroDivisionError("a bug")
        return track(self, frame)

    class Seen(States):
        def add(self, result: FrameResult, stage_ms: dict[str, float]) -> None:
            seen.append(result.frame.index)

    monkeypatch.setattr(Slam, "_track", fail)
    with pytest.raises(ZeroDivisionError, match="a bug"):
        run(drive, Seen(), monkeypatch)
    assert seen == list(range(9))
