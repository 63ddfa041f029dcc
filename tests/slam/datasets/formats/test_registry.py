"""A format is detected by its files, in a fixed order, and what a calibration file says is what is used."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from odometry import se3
from slam.datasets.camera_toml import parse_pose, read_camera_toml
from slam.datasets.dataset import DatasetSpec, contains_dataset, find_dataset, is_valid_fps
from slam.datasets.formats.image_sequence import natural_sort_key
from slam.datasets.formats.kitti_files import find_images, find_sequence, sequence_names
from slam.datasets.formats.place_datasets import parse_times
from slam.datasets.formats.recording import CameraStream, ImageSubset
from slam.datasets.formats.registry import FORMATS, detect_format
from slam.datasets.formats.timestamped_lists import ListFormat, read_timestamped_rows
from slam.errors import ConfigError, DataError

from ..rig import SIZE, turned

quick = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def touch(root: Path, *names: str) -> Path:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"")
    return root


FILES: dict[str, tuple[str, ...]] = {
    "bag": ("metadata.yaml", "drive.mcap"),
    "euroc": ("mav0/cam0/data.csv",),
    "tum-rgbd": ("rgb.txt",),
    "own-camera": ("camera.toml", "1.png"),
    "kitti": ("sequences/00/image_0/000000.png",),
    "kitti-raw": ("2011/2011_drive_1_sync/image_00/data/0000000000.png",),
    "malaga": ("Images_rectified/CAMERA1_1228.5_left.jpg",),
    "new-college": ("a/b/StereoImages__12.5-left.pnm",),
    "images": ("1.png", "2.png"),
}


@pytest.mark.parametrize("name", FILES)
def test_each_format_is_detected_by_its_files(tmp_path: Path, name: str) -> None:
    assert detect_format(DatasetSpec(touch(tmp_path, *FILES[name]))) == name


@pytest.mark.parametrize(("first", "second"), [("bag", "euroc"), ("euroc", "images"), ("tum-rgbd", "own-camera")])
def test_the_more_distinctive_of_two_matching_formats_is_used(tmp_path: Path, first: str, second: str) -> None:
    assert list(FORMATS).index(first) < list(FORMATS).index(second)
    assert detect_format(DatasetSpec(touch(tmp_path, *FILES[first], *FILES[second]))) == first


def test_a_requested_format_is_not_questioned(tmp_path: Path) -> None:
    assert detect_format(DatasetSpec(touch(tmp_path, *FILES["euroc"]), format="images")) == "images"


def test_the_error_for_an_unknown_dataset_lists_all_formats(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nor a recording of another format .*bag, euroc"):
        detect_format(DatasetSpec(touch(tmp_path, "thesis.txt")))


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf"), 1e9])
def test_an_impossible_frame_rate_is_refused(fps: float) -> None:
    assert not is_valid_fps(fps)
    with pytest.raises(ConfigError, match="expected images per second"):
        DatasetSpec(Path("x"), fps=fps)


def test_sequences_are_found_by_name_and_never_guessed(tmp_path: Path) -> None:
    def is_dataset(folder: Path) -> bool:
        return (folder / "mark").is_file()

    assert not contains_dataset(tmp_path, is_dataset)
    touch(tmp_path, "a/mark")
    assert find_dataset(tmp_path, None, is_dataset, "mark") == tmp_path / "a"
    touch(tmp_path, "b/mark")
    assert find_dataset(tmp_path, "b", is_dataset, "mark") == tmp_path / "b"
    with pytest.raises(DataError, match="expected one sequence, found a, b; choose one with --sequence"):
        find_dataset(tmp_path, None, is_dataset, "mark")
    with pytest.raises(DataError, match="expected one sequence c, found a, b"):
        find_dataset(tmp_path, "c", is_dataset, "mark")


def test_grey_pairs_come_before_colour_and_pairs_before_single_cameras(tmp_path: Path) -> None:
    names = [f"sequences/00/image_{camera}/00000{k}.png" for camera in (0, 2, 3) for k in range(2)]
    root = touch(tmp_path, *names)
    assert sequence_names(root) == ("00",)
    assert find_images(find_sequence(root, None)).cameras == (2, 3)  # the grey camera is alone
    touch(tmp_path, *(f"sequences/00/image_1/00000{k}.png" for k in range(2)))
    assert find_images(find_sequence(root, "00")).cameras == (0, 1)


@quick
@given(numbers=st.lists(st.integers(0, 10**6), min_size=2, max_size=12, unique=True))
def test_natural_order_is_the_order_of_the_numbers(numbers: list[int]) -> None:
    names = sorted((Path(f"image{number}.png") for number in numbers), key=natural_sort_key)
    assert names == [Path(f"image{number}.png") for number in sorted(numbers)]


def test_times_are_read_from_names_or_made_at_a_rate() -> None:
    files = [Path(f"CAMERA1_{t}_left.jpg") for t in ("12.25", "12.5", "13.75")]
    assert parse_times(files, 7.5).tolist() == [12.25, 12.5, 13.75]
    assert parse_times(list(reversed(files)), 2.0).tolist() == [0.0, 0.5, 1.0]
    assert parse_times([Path("a.jpg"), Path("b.jpg")], 4.0).tolist() == [0.0, 0.25]


@quick
@given(
    ticks=st.sampled_from([1.0, 1e3, 1e6, 1e9]),
    written=st.sampled_from([1.0, 1e3, 1e6, 1e9]),
    start=st.sampled_from([0, 1_400_000_000]),
    steps=st.lists(st.integers(20, 500), min_size=3, max_size=9),
)
def test_a_list_gives_seconds_whatever_its_unit(
    tmp_path: Path, ticks: float, written: float, start: int, steps: list[int]
) -> None:
    milliseconds = 1000 * start + np.cumsum(steps)
    lines = [f"{t * written / 1000:.3f}; {t}.5" for t in milliseconds]
    (tmp_path / "list").write_text("# comment\n\n" + "\n".join(lines) + "\n")
    rows = read_timestamped_rows(tmp_path / "list", ListFormat(r"\s*;\s*", ticks), 2)
    np.testing.assert_allclose(rows.values, np.stack([milliseconds / 1000, milliseconds + 0.5], axis=1), rtol=1e-9)
    assert bool(rows.remarks) == (ticks != written)


class Numbered:
    """Images whose value is their index."""

    def __len__(self) -> int:
        return 9

    def __getitem__(self, index: int) -> np.ndarray:
        return np.full((2, 2), index, np.uint8)

    def where(self, index: int) -> str:
        return f"image {index}"


@quick
@given(indices=st.lists(st.integers(0, 8), max_size=9, unique=True).map(sorted))
def test_a_subset_keeps_images_and_times_together(indices: list[int]) -> None:
    stream = CameraStream(Numbered(), np.arange(9) / 10)
    subset = stream.subset(np.array(indices, np.int64))
    assert [int(subset.images[k][0, 0]) for k in range(len(indices))] == indices
    assert [subset.images.where(k) for k in range(len(indices))] == [f"image {k}" for k in indices]
    np.testing.assert_array_equal(subset.timestamps, np.array(indices) / 10)


def test_a_subset_of_all_images_is_the_stream_itself() -> None:
    stream = CameraStream(Numbered(), np.arange(9) / 10)
    assert stream.subset(np.arange(9)) is stream
    assert isinstance(stream.subset(np.arange(8)).images, ImageSubset)


@quick
@given(angles=st.tuples(*[st.floats(-180, 180)] * 3), t=st.tuples(*[st.floats(-9, 9)] * 3))
def test_a_pose_is_read_as_rows_or_as_sixteen_numbers(
    angles: tuple[float, float, float], t: tuple[float, float, float]
) -> None:
    T = turned(angles, t)
    np.testing.assert_array_equal(parse_pose(T.tolist(), "T"), T)
    np.testing.assert_array_equal(parse_pose(T.ravel().tolist(), "T"), T)
    mirrored = T @ np.diag([-1.0, 1.0, 1.0, 1.0])
    with pytest.raises(ValueError, match="expected a rotation in T"):
        parse_pose(mirrored.tolist(), "T")


def test_a_camera_toml_gives_the_pair_that_it_describes(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    numbers = "fx = 260\nfy = 260\ncx = 160\ncy = 118\n"
    path.write_text(numbers + "baseline = 0.3\nfps = 12.5\nleft = 'a'\nground_truth = 'p.tum'\n")
    toml = read_camera_toml(path)
    assert (toml.is_pair, toml.fps, toml.left, toml.right, toml.ground_truth) == (
        True,
        12.5,
        "a",
        None,
        tmp_path / "p.tum",
    )
    assert toml.rectification(SIZE).camera.baseline == 0.3
    pose = turned((0.5, 1.0, -0.5), (0.2, 0.01, 0.0))
    path.write_text(f"{numbers}[right_camera]\n{numbers}T_left_right = {pose.tolist()}\n")
    camera = read_camera_toml(path).rectification(SIZE)
    assert camera.camera.baseline == pytest.approx(np.linalg.norm(pose[:3, 3]))
    np.testing.assert_allclose(se3.log(camera.T_camera_view)[3:], 0.0, atol=1e-12)
    path.write_text(numbers)
    assert not read_camera_toml(path).is_pair
