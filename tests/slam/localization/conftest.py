"""A map of a part of the first lap of a small drive."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from slam.components import build_components
from slam.config import RunConfig, to_toml
from slam.datasets.formats.registry import open_dataset
from slam.localization.keyframe_map import SavedMap
from slam.map_database.database import MapDatabase, Session
from slam.map_database.session_writer import MapSessionRecorder
from slam.run_log import RunLog
from slam.system import Slam

MAPPED = range(0, 90, 2)  # frames of the drive that are in the map


@pytest.fixture(scope="session")
def map_path(circle_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the map lies; whoever changes the file takes a copy."""
    path = tmp_path_factory.mktemp("map") / "map.db"
    drive, config, rows, log = open_dataset(circle_drive), RunConfig(), MatrixRecorder(500), RunLog()
    slam = Slam(build_components(drive.camera, config, rows))
    source = {"source": str(circle_drive), "versions": {"revisit-slam": "0"}}
    session = Session(0, 0, "circle", drive.camera, to_toml(config), source)
    with MapDatabase.create(path) as store:
        with store.writing():
            store.add_session(session)
        recorder = MapSessionRecorder(store, session, config)
        recorder.restore(slam, rows, log)
        for number, frame in enumerate(MAPPED):
            result = slam.process(replace(drive[frame], index=number))
            log.add(result, {})
            recorder.add(result, result.stage_ms)
        recorder.write_checkpoint()
        late, optimized = slam.finish(config.robust)
        recorder.finish(late, optimized, True)
    return path


@pytest.fixture(scope="session")
def saved(map_path: Path) -> Iterator[SavedMap]:
    """The map, open."""
    with MapDatabase.open(map_path) as store:
        yield SavedMap.open(store)


@pytest.fixture
def damaged(map_path: Path, tmp_path: Path) -> Path:
    """A copy of the map, to be damaged."""
    path = tmp_path / "map.db"
    path.write_bytes(map_path.read_bytes())
    return path


@pytest.fixture(scope="session")
def truth(circle_drive: Path) -> np.ndarray:
    """T_world_camera (N, 4, 4) of all frames of the drive, metres."""
    poses = open_dataset(circle_drive).ground_truth
    assert poses is not None
    return poses
