"""The comparison with peers: one scorer for all, programs as processes of their own, a vocabulary for ORB-SLAM3."""

import importlib
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from odometry import se3
from slam.errors import DataError
from slam.evaluation.trajectory_errors import SegmentRule
from slam.io.trajectory_files import write_kitti

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
scores = importlib.import_module("peer_scores")
programs = importlib.import_module("peer_programs")
peers = importlib.import_module("peers")
vocabulary = importlib.import_module("orb_vocabulary")
klt = importlib.import_module("klt_odometry")
orb_slam3 = importlib.import_module("orb_slam3")
places = importlib.import_module("places")

FRAMES = 15
# Follows the contract of the programs; stands still.
STILL = "import sys; open(sys.argv[5] + '/odometry.txt', 'w').write('1 0 0 0 0 1 0 0 0 0 1 0\\n' * {lines})"


def ahead(count: int, step_m: float) -> np.ndarray:
    """Poses (count, 4, 4) along the camera's axis."""
    poses = np.repeat(np.eye(4)[None], count, axis=0)
    poses[:, 2, 3] = step_m * np.arange(count)
    return poses


@pytest.fixture(scope="module")
def kitti(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 14 m, small images of noise."""
    root = tmp_path_factory.mktemp("kitti")
    folder, rng = root / "sequences" / "04", np.random.default_rng(0)
    for side in ("image_0", "image_1"):
        (folder / side).mkdir(parents=True)
        for index in range(FRAMES):
            cv2.imwrite(str(folder / side / f"{index:06d}.png"), rng.integers(0, 255, (40, 60), np.uint8))
    (folder / "calib.txt").write_text("P0: 50 0 30 0 0 50 20 0 0 0 1 0\nP1: 50 0 30 -25 0 50 20 0 0 0 1 0\n")
    (folder / "times.txt").write_text("".join(f"{0.1 * index:.1f}\n" for index in range(FRAMES)))
    (root / "poses").mkdir()
    write_kitti(root / "poses" / "04.txt", ahead(FRAMES, 1.0))
    return root


def still(lines: int) -> "programs.Program":
    return programs.Program("still", (sys.executable, "-c", STILL.format(lines=lines)))


def test_a_perfect_trajectory_has_no_error_wherever_it_begins() -> None:
    truth = ahead(60, 0.5) @ se3.exp(np.array([0.1, 0.2, 0.3, 0.0, 0.0, 0.0]))
    moved = se3.exp(np.array([0.3, -0.2, 0.1, 5.0, 6.0, 7.0])) @ truth
    found = scores.score_poses(scores.Estimate(moved, moved), truth)
    assert tuple(found) == scores.TRUTH_COLUMNS
    assert list(found.values()) == pytest.approx([0.0] * 6, abs=1e-5)


def test_one_per_cent_too_long_is_drift_but_no_error_after_scaling() -> None:
    found = scores.score_poses(scores.Estimate(ahead(60, 0.505)), ahead(60, 0.5))
    assert (found["t_rel %"], found["end %"]) == pytest.approx((1.0, 1.0), rel=0.06)
    assert found["Sim(3) m"] == pytest.approx(0.0, abs=1e-9)
    assert found["ATE m"] == pytest.approx(0.005 * np.std(np.arange(60)), rel=1e-9)
    assert found["closed m"] is None


def test_scaling_is_of_the_trajectory_after_loop_closing() -> None:
    truth = ahead(60, 0.5)
    bent = truth.copy()
    bent[:, 0, 3] = 3 * np.sin(np.arange(60) / 5)
    found = scores.score_poses(scores.Estimate(bent, truth), truth)
    assert found["ATE m"] > 0.5
    assert min(found["t_rel %"], found["end %"]) > 1.0  # drift is measured before
    assert found["closed m"] == pytest.approx(0.0, abs=1e-9)
    assert found["Sim(3) m"] == pytest.approx(0.0, abs=1e-9)


def test_only_a_drive_that_is_shorter_than_kittis_segments_has_shorter_ones() -> None:
    assert scores.segment_rule(100.0) == SegmentRule()
    assert scores.segment_rule(99.9).lengths_m == (10, 20, 30, 40, 50, 60, 70, 80)
    assert scores.segment_rule(99.9).step_frames == 1


def test_measured_pairs_measure_the_motion_between_two_frames() -> None:
    pair = scores.MeasuredPair(1, 4, np.array([0.0, 0.0, 3.0]), 5.0)
    found = scores.score_pairs(scores.Estimate(ahead(5, 1.0), ahead(5, 2.0)), [pair, pair])
    assert found == pytest.approx({"pairs m": 0.0, "closed m": 3.0, "pairs deg": 5.0, "closed deg": 5.0})
    assert scores.score_pairs(scores.Estimate(ahead(5, 1.0)), [pair])["closed m"] is None


def test_a_loop_is_true_where_its_frames_are_near_each_other() -> None:
    assert scores.count_loops([(9, 1), (12, 2), (30, 2)], ahead(31, 1.0)) == scores.Loops(3, 2, 1)
    assert scores.count_loops([(9, 1)], None) == scores.Loops(1, None, None)


def test_a_spread_that_rounds_to_nothing_is_not_shown() -> None:
    assert scores.describe_spread([1.0, 1.2, 1.4], 1) == "1.2 ±0.2"
    assert scores.describe_spread([1.0, 1.001], 2) == "1.00"
    assert scores.describe_spread([1.0, None], 2) == "-"


def test_measured_pairs_are_read_past_comments_and_damage_is_named(tmp_path: Path) -> None:
    table = tmp_path / "pairs.csv"
    table.write_text("# metres\na,b,inliers,x,y,z,rotation_deg\n0,3,99,1,2,3,4\n")
    (pair,) = scores.read_pairs(table)
    assert (pair.a, pair.b, pair.position_m.tolist(), pair.rotation_deg) == (0, 3, [1, 2, 3], 4)
    table.write_text("a,b,x,y,z\n0,3,1,2,3\n")
    with pytest.raises(DataError, match=r"pairs.csv: expected numbers in the columns .*rotation_deg"):
        scores.read_pairs(table)


def test_a_program_gets_the_drive_with_its_calibration_and_truth(kitti: Path, tmp_path: Path) -> None:
    drives = peers.open_drives(*peers.find_drive(f"{kitti}:04"), tmp_path / "drive")
    assert (drives.whole.frames, drives.start.frames) == (FRAMES, peers.START_FRAMES)
    left, right, calibration, times, out = map(Path, drives.start.arguments(tmp_path / "out"))
    assert [len(list(side.iterdir())) for side in (left, right)] == [10, 10]
    drive = klt.StereoDrive(left, right, calibration, times, out)
    P_left, P_right = drive.read_projections()
    assert P_left[:, :3].tolist() == [[50, 0, 30], [0, 50, 20], [0, 0, 1]]
    assert P_right[0, 3] == pytest.approx(-25)
    assert drive.read_times() == pytest.approx(0.1 * np.arange(10))
    assert np.array_equal(next(drive.read_pairs())[1], cv2.imread(str(right / "000000.png"), cv2.IMREAD_GRAYSCALE))


def test_a_row_has_all_columns_and_what_cannot_run_is_a_line(kitti: Path, tmp_path: Path) -> None:
    drives = peers.open_drives(kitti, None, tmp_path / "drive")
    found, remark = peers.measure(still(FRAMES), drives, tmp_path / "runs")
    assert set(found) == {*scores.TRUTH_COLUMNS, *scores.LOOP_COLUMNS, *scores.COST_COLUMNS}
    assert found["end %"] == pytest.approx(100.0)
    assert remark == ""
    absent = programs.Missing("absent", "not given")
    table, remarks = peers.compare([still(FRAMES), absent], drives, 2, tmp_path / "compared")
    assert table.row_count == 2
    assert remarks == ["absent: not given"]


def test_a_missing_line_is_an_error_that_names_the_file(kitti: Path, tmp_path: Path) -> None:
    drives = peers.open_drives(kitti, None, tmp_path / "drive")
    table, (remark,) = peers.compare([still(FRAMES - 1)], drives, 1, tmp_path / "runs")
    assert table.row_count == 1
    assert "odometry.txt: expected 15 poses, found 14" in remark


def test_a_program_that_fails_says_why_by_its_last_line(tmp_path: Path) -> None:
    with pytest.raises(programs.PeerError, match="ended with 3: no licence"):
        programs.run_measured([sys.executable, "-c", "print('no licence\\n'); raise SystemExit(3)"], tmp_path / "out")
    with pytest.raises(programs.PeerError, match="No such file"):
        programs.run_measured([str(tmp_path / "nothing")], tmp_path / "out")


def test_the_cost_is_that_of_the_program_and_not_of_this_process(tmp_path: Path) -> None:
    small = programs.run_measured([sys.executable, "-S", "-c", ""], tmp_path / "small")
    large = programs.run_measured([sys.executable, "-S", "-c", "b'x' * 200_000_000"], tmp_path / "large")
    assert small.peak_mb < 50  # this process has imported far more
    assert large.peak_mb > small.peak_mb + 150
    assert small.cpu_s > 0
    asleep = programs.run_measured([sys.executable, "-S", "-c", "import time; time.sleep(0.5)"], tmp_path / "asleep")
    assert asleep.wall_s >= 0.5 > asleep.cpu_s


def test_loops_come_from_the_table_or_from_what_was_printed(tmp_path: Path) -> None:
    drive = programs.PeerDrive(tmp_path, "drive", 31, ahead(31, 1.0))
    write_kitti(tmp_path / "odometry.txt", ahead(31, 1.0))
    (tmp_path / "log.txt").write_text("*Loop detected\nother\n*Loop detected\n")
    assert programs.Program("a", ()).read(drive, tmp_path).loops == scores.Loops()
    assert programs.Program("a", (), loop_lines=("*Loop",)).read(drive, tmp_path).loops == scores.Loops(2)
    (tmp_path / "loops.csv").write_text("query,match\n9,1\n30,2\n")
    assert programs.Program("a", ()).read(drive, tmp_path).loops == scores.Loops(2, 1, 1)


@pytest.fixture(scope="module")
def described() -> list[np.ndarray]:
    """Descriptors of 12 images: one that all of them have, and noisy copies of 300 others."""
    rng = np.random.default_rng(0)
    prototypes = rng.integers(0, 256, (300, 32)).astype(np.uint8)
    flips = [np.packbits(rng.random((100, 256)) < 0.02, axis=1) for _ in range(12)]
    images = [prototypes[rng.integers(0, 300, 100)] ^ flip for flip in flips]
    return [np.concatenate([image, np.full((20, 32), 7, np.uint8)]) for image in images]


def descend(tree: "vocabulary.VocabularyTree", descriptor: np.ndarray) -> int:
    """Node id of the word of a descriptor, as DBoW2 finds it."""
    node = 0
    while node == 0 or not tree.is_word[node - 1]:
        children = np.flatnonzero(tree.parents == node)
        node = int(children[vocabulary.distances(descriptor[None], tree.descriptors[children])[0].argmin()]) + 1
    return node


def test_the_vocabulary_is_a_tree_whose_words_are_rare_or_not(described: list[np.ndarray]) -> None:
    tree = vocabulary.train(described)
    ids = np.arange(1, len(tree.parents) + 1)
    assert np.all(tree.parents < ids)
    assert np.bincount(tree.parents).max() <= vocabulary.BRANCHES
    assert np.array_equal(~tree.is_word, np.isin(ids, tree.parents))
    assert tree.weights[descend(tree, described[0][-1]) - 1] == 0.0  # the descriptor that every image has
    assert np.all(tree.weights[~tree.is_word] == 0)
    assert tree.weights.max() <= np.log(12) + 1e-12
    seen = [{descend(tree, descriptor) for descriptor in image} for image in described]
    rare = next(word for word in sorted(set.union(*seen)) if sum(word in image for image in seen) == 1)
    assert tree.weights[rare - 1] > 1.0


def test_equal_descriptors_end_in_one_word(described: list[np.ndarray]) -> None:
    tree = vocabulary.train([np.full((50, 32), 3, np.uint8)] * 4)
    assert tree.is_word.tolist() == [True]


def test_hamming_distances_count_bits() -> None:
    a, b = np.random.default_rng(1).integers(0, 256, (2, 6, 32)).astype(np.uint8)
    expected = (np.unpackbits(a, axis=1)[:, None] != np.unpackbits(b, axis=1)[None]).sum(axis=2)
    assert np.array_equal(vocabulary.distances(a, b), expected)


def test_the_text_of_a_vocabulary_has_a_line_for_each_node_and_no_line_after(
    described: list[np.ndarray], tmp_path: Path
) -> None:
    tree = vocabulary.train(described)
    vocabulary.write_text(tmp_path / "words.txt", tree)
    header, *lines = (tmp_path / "words.txt").read_text().split("\n")
    assert header == "10 6 0 0"
    rows = np.array([line.split() for line in lines], np.float64)
    assert np.array_equal(rows[:, 0], tree.parents)
    assert np.array_equal(rows[:, 1], tree.is_word)
    assert np.array_equal(rows[:, 2:34], tree.descriptors)
    assert rows[:, 34] == pytest.approx(tree.weights, rel=1e-7)


def test_pnp_finds_the_motion_of_the_camera() -> None:
    rng, K = np.random.default_rng(2), np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]])
    points = np.column_stack([rng.uniform(-8, 8, 200), rng.uniform(-2, 2, 200), rng.uniform(5, 40, 200)])
    T = se3.exp(np.array([0.01, 0.03, -0.01, 0.1, 0.0, 1.0]))
    seen = (points - T[:3, 3]) @ T[:3, :3]
    pixels = seen @ K.T
    found = klt.solve_motion(points, pixels[:, :2] / pixels[:, 2:], K)
    assert found == pytest.approx(T, abs=1e-5)
    assert klt.solve_motion(points[:5], pixels[:5, :2] / pixels[:5, 2:], K) is None


def test_a_shift_of_the_image_is_a_depth() -> None:
    noise = cv2.GaussianBlur(np.random.default_rng(3).normal(size=(120, 300)).astype(np.float32), (0, 0), 2.0)
    left = cv2.normalize(noise, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    right = np.roll(left, -8, axis=1)
    K = np.array([[100.0, 0, 150], [0, 100, 60], [0, 0, 1]])
    pixels, points = klt.triangulate(left, right, K, 40.0)
    assert len(points) > 30
    assert np.median(points[:, 2]) == pytest.approx(5.0, rel=0.01)
    projected = points @ K.T
    assert projected[:, :2] / projected[:, 2:] == pytest.approx(pixels, abs=1e-3)


def test_frames_that_orb_slam3_lost_have_the_pose_before_them(tmp_path: Path) -> None:
    rotation = Rotation.from_rotvec([0.1, -0.4, 0.2])
    x, y, z, w = rotation.as_quat()
    (tmp_path / "final.tum").write_text(f"0.0 1 2 3 {x} {y} {z} {w}\n0.2 4 5 6 0 0 0 1\n")
    found = orb_slam3.read_final(tmp_path / "final.tum", np.array([0.0, 0.1, 0.2]))
    assert found[1] is None
    assert found[0][:3, :3] == pytest.approx(rotation.as_matrix(), abs=1e-9)
    filled = orb_slam3.fill([None, *found])
    assert [pose[:3, 3].tolist() for pose in filled] == [[0, 0, 0], [1, 2, 3], [1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize("flagged", [20, 21, 22])
def test_the_odometry_of_orb_slam3_does_not_jump_where_a_loop_moves_its_map(flagged: int) -> None:
    tracked, final = ahead(40, 1.0), list(ahead(40, 1.0))
    tracked[20:, 0, 3] += 5.0  # the map is moved before frame 20, and that is said then or a little later
    frames = [orb_slam3.TrackedFrame(pose, index == flagged, 1.0) for index, pose in enumerate(tracked)]
    assert np.array(orb_slam3.chain(frames, final)) == pytest.approx(np.array(final))


def test_the_odometry_of_orb_slam3_is_as_tracked_far_from_a_change() -> None:
    tracked, final = ahead(40, 1.1), list(ahead(40, 1.0))
    frames = [orb_slam3.TrackedFrame(pose, index == 20, 1.0) for index, pose in enumerate(tracked)]
    found = np.array(orb_slam3.chain(frames, final))
    assert found[14] == pytest.approx(tracked[14])
    assert found[-1, 2, 3] - found[25, 2, 3] == pytest.approx(1.1 * 14)
    unchanged = [orb_slam3.TrackedFrame(pose, False, 1.0) for pose in tracked]
    assert np.array(orb_slam3.chain(unchanged, final)) == pytest.approx(tracked)


def test_the_output_of_ibow_lcd_is_read_as_beliefs(tmp_path: Path) -> None:
    file = tmp_path / "loops.txt"
    file.write_text("0\t2\t0\t0\n30\t0\t4\t25\n31\t1\t5\t9\n")
    nothing, loop, other = places.read_ibow_lcd(file)
    assert (nothing.match, other.match) == (None, None)
    assert (loop.query, loop.match, loop.score, loop.accepted) == (30, 4, 25.0, True)
    file.write_text("3 0 4\n")
    with pytest.raises(DataError, match="found none for 3"):
        places.read_ibow_lcd(file)
