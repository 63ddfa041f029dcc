import cv2
import numpy as np
import pytest

from odometry.camera import StereoCamera
from place_recognition.evaluation.similarity_matrix import SimilarityMatrix
from slam.errors import OutputError
from slam.viewer import rerun_archetypes
from slam.viewer.rerun_viewer import RerunViewer
from slam.viewer.viewer import FrameView, LoopView, NullViewer

from ..report import fabricate

chunk = pytest.importorskip("rerun.chunk", reason="this rerun cannot read recordings back")

CAMERA = StereoCamera(120.0, 120.0, 79.5, 29.5, 0.5, 160, 60)
FRAMES = 160
ALWAYS = {
    "/world", "/world/camera", "/world/camera/image", "/world/camera/image/tracks", "/world/odometry",
    "/world/corrected", "/world/landmarks", "/world/map_before", "/world/map_after", "/world/loops/accepted",
    "/world/loops/rejected", "/places/matrix", "/loop/query", "/loop/match", "/plots/inliers", "/plots/score",
}  # fmt: skip


def frame_view(record, index, rng):
    pixels = rng.uniform([0, 0], [160, 60], (50, 2))
    return FrameView(
        index, float(record.timestamps[index]), rng.integers(0, 255, (60, 160)).astype(np.uint8),
        record.odometry[index], record.online[index], pixels, pixels + 1.0, rng.random(50) < 0.8, False,
        rng.normal(size=(40, 3)) if index % 5 == 0 else None, {"read": 1.5, "verify / prove": float("nan")},
        0.5 if index else float("-inf"), index % 7 == 0,
    )  # fmt: skip


def drive(viewer, record, seed=1):
    rng = np.random.default_rng(seed)
    rows = {row.query: row for row in record.loops if row.accepted}
    for index in range(len(record.timestamps)):
        viewer.show_frame(frame_view(record, index, rng))
        if index in rows:
            image, pixels = np.full((60, 160), 90, np.uint8), rng.uniform(0, 60, (12, 2))
            row = rows[index]
            closed = LoopView(index, row.match, image, image, pixels, pixels, row.in_graph, row.reason)
            viewer.show_loop(closed, record.corrected[: index + 1])
    viewer.show_matrix(SimilarityMatrix(rng.random((len(rows), len(rows)), np.float32)))
    viewer.finish(record)
    viewer.close()


def recorded(tmp_path, record, truth):
    path = tmp_path / "recording.rrd"
    drive(RerunViewer(path, CAMERA, truth), record)
    return list(chunk.RrdReader(path).stream())


@pytest.fixture(scope="module")
def chunks(tmp_path_factory):
    record = fabricate.record(FRAMES)
    return recorded(tmp_path_factory.mktemp("rrd"), record, record.ground_truth)


def rows(chunks, path):
    return sum(piece.num_rows for piece in chunks if piece.entity_path == path)


def test_the_recording_reads_back_with_all_its_entities(chunks):
    stages = {"/plots/stages/read", "/plots/error/corrected", "/world/ground_truth"}
    assert {piece.entity_path for piece in chunks} >= ALWAYS | stages


def test_the_camera_has_one_pose_for_each_frame(chunks):
    assert rows(chunks, "/world/camera") == FRAMES


def test_the_timelines_are_frame_and_time(chunks):
    names = {name for piece in chunks for name in piece.timeline_names}
    assert names == {"frame", "time"}


def test_errors_are_known_for_each_frame(chunks):
    assert rows(chunks, "/plots/error/odometry") == FRAMES + 1  # and how the curve looks


def lines_at(chunks, path, frame):
    """Positions (N, 3) of the lines that are logged under a path and its parts at one frame."""
    found = []
    for piece in chunks:
        if piece.entity_path.startswith(path) and not piece.is_static:
            rows_ = piece.to_record_batch().to_pylist()
            strips = next((name for name in rows_[0] if name.endswith("strips")), None)
            found += [row[strips] for row in rows_ if strips and row["frame"] == frame and row[strips]]
    return np.array([point for strips in found for strip in strips for point in strip])


def test_the_corrected_trajectory_appears_at_the_frame_that_closes_the_first_loop(chunks):
    record = fabricate.record(FRAMES)
    closing = next(row.query for row in record.loops if row.in_graph)
    before = lines_at(chunks, "/world/corrected", closing - 1)
    np.testing.assert_allclose(before[-1], record.online[closing - 1, :3, 3], atol=1e-4)
    after = lines_at(chunks, "/world/corrected/part_000", closing)
    np.testing.assert_allclose(after[: closing + 1], record.corrected[: closing + 1, :3, 3], atol=1e-4)
    np.testing.assert_allclose(
        lines_at(chunks, "/world/odometry", closing)[-1], record.odometry[closing, :3, 3], atol=1e-4
    )


def test_without_ground_truth_none_is_shown(tmp_path):
    record = fabricate.without_truth(fabricate.record(30))
    paths = {piece.entity_path for piece in recorded(tmp_path, record, None)}
    assert "/world/ground_truth" not in paths
    assert "/world/odometry" in paths


def test_a_drive_twice_as_long_makes_a_file_about_twice_as_large(tmp_path):
    sizes = []
    for frames in (150, 300):
        record = fabricate.without_loops(fabricate.record(frames))
        path = tmp_path / f"{frames}.rrd"
        drive(RerunViewer(path, CAMERA, record.ground_truth), record)
        sizes.append(path.stat().st_size)
    assert sizes[1] < 2.3 * sizes[0]


def test_a_recording_that_cannot_be_written_names_the_file(tmp_path):
    with pytest.raises(OutputError, match=r"nowhere/r\.rrd: cannot write the recording"):
        RerunViewer(tmp_path / "nowhere" / "r.rrd", CAMERA)


def test_the_null_viewer_does_nothing():
    record = fabricate.record(20)
    before = record.online.copy()
    drive(NullViewer(), record)
    np.testing.assert_array_equal(record.online, before)


def test_a_loop_without_poses_leaves_the_lines_as_they_are(tmp_path):
    viewer = RerunViewer(tmp_path / "r.rrd", CAMERA)
    record = fabricate.record(FRAMES)
    for index in range(3):
        viewer.show_frame(frame_view(record, index, np.random.default_rng(index)))
    nothing = np.empty((0, 2))
    viewer.show_loop(LoopView(2, 0, None, None, nothing, nothing, True, "x"), np.empty((0, 4, 4)))
    viewer.close()
    chunks = list(chunk.RrdReader(tmp_path / "r.rrd").stream())
    assert rows(chunks, "/world/corrected") == 3
    assert rows(chunks, "/world/loops/accepted") == 0
    assert rows(chunks, "/loop/log") == 1


@pytest.mark.parametrize("size", [1, 30, 501, 1300])
def test_a_revisit_shows_in_the_matrix_however_many_images_share_a_cell(size):
    values = np.full((size, size), np.nan, np.float32)
    rows_, columns = np.tril_indices(size, -1)
    values[rows_, columns] = 1.0
    values[size - 1, size // 3] = 50.0
    data = (
        rerun_archetypes.render_matrix(SimilarityMatrix(values)).blob.as_arrow_array().to_numpy(zero_copy_only=False)[0]
    )
    image = cv2.imdecode(np.asarray(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image.shape[0] == image.shape[1] <= 500
    if size > 1:
        fold = -(-size // image.shape[0])
        assert image[(size - 1) // fold, size // 3 // fold] == image.max() > 0
