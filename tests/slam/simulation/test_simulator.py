import json

import cv2
import numpy as np
import pykitti
import pytest

from slam.errors import OutputError
from slam.simulation import SimulationConfig, simulate

SMALL = SimulationConfig(width=320, height=96, max_frames=4, length_m=200, depth=True)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return simulate(SMALL, tmp_path_factory.mktemp("drives") / "a")


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def same_files(a, b):
    # Archives carry their hour of birth; what is in them is compared by content.
    a, b = files(a), files(b)
    return {k: v for k, v in a.items() if not k.endswith("npz")} == {
        k: v for k, v in b.items() if not k.endswith("npz")
    }


def test_the_folder_is_readable_as_kitti(drive):
    data = pykitti.odometry(str(drive), "00")
    assert len(data.poses) == len(data.timestamps) == 4
    np.testing.assert_allclose(data.poses[0], np.eye(4), atol=1e-12)
    assert np.array(data.get_gray(3)[0]).shape == (96, 320)
    assert data.calib.b_gray == pytest.approx(0.54)


def test_pose_lines_have_twelve_numbers_and_no_trailing_space(drive):
    for line in (drive / "poses" / "00.txt").read_text().splitlines():
        assert line == line.rstrip()
        assert len(line.split()) == 12


def test_the_manifest_has_the_whole_configuration(drive):
    assert SimulationConfig(**json.loads((drive / "drive.json").read_text())["config"]) == SMALL


def test_depth_is_stored_in_256ths_of_a_metre(drive):
    depth = cv2.imread(str(drive / "sequences/00/depth/000000.png"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16
    row = depth[-1, 100:200] / 256.0
    # The bottom row sees the road from 1.65 m above it (or something on it).
    expected = 1.65 * SMALL.camera.fy / (95 - SMALL.camera.cy)
    assert np.median(row) == pytest.approx(expected, rel=0.15)


def test_equal_configurations_give_equal_bits(drive, tmp_path):
    assert same_files(drive, simulate(SMALL, tmp_path / "b"))


def test_another_seed_gives_another_drive(drive, tmp_path):
    config = SimulationConfig(
        **{**json.loads((drive / "drive.json").read_text())["config"], "seed": 5, "max_frames": 1}
    )
    other = simulate(config, tmp_path / "c")
    name = "sequences/00/image_0/000000.png"
    assert (drive / name).read_bytes() != (other / name).read_bytes()


def test_an_existing_drive_is_not_rendered_again(drive):
    before = {p: p.stat().st_mtime_ns for p in drive.rglob("*")}
    calls = []
    assert simulate(SMALL, drive, lambda done, total: calls.append(done)) == drive
    assert calls == []
    assert {p: p.stat().st_mtime_ns for p in drive.rglob("*")} == before


def test_a_folder_with_something_else_is_refused_and_left_alone(tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(OutputError, match="found something else; remove it or name another folder"):
        simulate(SMALL, tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_an_interrupted_simulation_leaves_nothing_behind(tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(SMALL, tmp_path / "d", stop)
    assert list(tmp_path.iterdir()) == []


def test_progress_counts_to_the_end(tmp_path):
    calls = []
    config = SimulationConfig(width=64, height=32, max_frames=3, length_m=200)
    simulate(config, tmp_path / "e", lambda done, total: calls.append((done, total)))
    assert calls == [(1, 3), (2, 3), (3, 3)]
