"""The depth of a frame is that of its colour image, pixel by pixel, in metres; what cannot be used costs a remark."""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from odometry import se3
from odometry.camera import StereoCamera
from slam.datasets.camera_toml import CAMERA_TOML, read_camera_toml
from slam.datasets.dataset import Dataset, DatasetSpec
from slam.datasets.depth_units import describe_scale, to_metres
from slam.datasets.formats.registry import open_dataset, open_for_odometry, open_images
from slam.datasets.rectification import DEPTH_CAMERA_BASELINE_M, NOMINAL_BASELINE_M, Rectification, rectify_parallel
from slam.datasets.time_sync import associate_with_nearest
from slam.errors import DataError
from slam.io.trajectory_files import write_tum

from ..layouts import RATE, Taken, camera_toml, taken, write_folders, write_tum_rgbd, write_video
from ..rig import SIZE, all_rays, wall_depth

HOLE = (slice(100, 110), slice(200, 210))  # pixels of the raw depth without a measurement


@pytest.fixture(scope="module")
def bent() -> Taken:
    return taken("radtan", 5)


@pytest.fixture(scope="module")
def ideal() -> Taken:
    return taken("ideal", 5)


def raw_depths(drive: Taken) -> list[np.ndarray]:
    """True depth of each raw image of the left camera, metres, 0 in the hole."""
    depths = [wall_depth(all_rays(drive.rig.left), T) for T in drive.poses]
    for depth in depths:
        depth[HOLE] = 0.0
    return depths


def write_depth(root: Path, drive: Taken, scale: float = 5000.0, late_s: float = 0.002) -> Path:
    """Depth images and their list in the layout of TUM RGB-D, taken a little later than the colour images."""
    (root / "depth").mkdir(parents=True, exist_ok=True)
    lines = ["# depth maps", "# timestamp filename"]
    for time, depth in zip(drive.times + late_s, raw_depths(drive), strict=True):
        cv2.imwrite(str(root / f"depth/{time:.6f}.png"), np.rint(depth * scale).astype(np.uint16))
        lines.append(f"{time:.6f} depth/{time:.6f}.png")
    (root / "depth.txt").write_text("\n".join(lines) + "\n")
    return root


def write_rgbd(root: Path, drive: Taken, scale: float = 5000.0, **more: object) -> Path:
    write_depth(write_tum_rgbd(root, drive), drive, scale)
    (root / CAMERA_TOML).write_text(camera_toml(drive.rig, pair=False, **more))
    return root


def depth_of(drive: Dataset, index: int = 3) -> np.ndarray:
    depth = drive[index].depth
    assert depth is not None
    assert depth.dtype == np.float32
    assert depth.shape == drive[index].left.shape
    return depth


def rays_of(camera: StereoCamera) -> np.ndarray:
    """Direction (H, W, 3) of each pixel of a pinhole camera."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.dstack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)])


def assert_true(depth: np.ndarray, camera: StereoCamera, T: np.ndarray) -> None:
    """Depth is that of the walls: nothing between both sides of an edge, the edge itself within a pixel, and a hole."""
    truth = wall_depth(rays_of(camera), T)
    has = np.isfinite(depth)
    assert 0.98 < has.mean() < 0.999  # the hole, and perhaps a border
    near = [np.abs(depth - np.roll(truth, shift, axis=(0, 1))) for shift in ((0, 0), (0, 1), (0, -1))]
    assert np.min(near, axis=0)[has].max() < 0.05  # of 6 m between the walls: half a pixel of their slant
    assert (near[0][has] > 1.0).mean() < 0.003


def test_depth_of_tum_rgbd_is_undistorted_with_its_image(tmp_path: Path, bent: Taken) -> None:
    folder = write_rgbd(tmp_path / "room", bent, 4000.0, depth_scale=4000)  # 13 m are beyond 16 bits at 5000
    drive = open_for_odometry(DatasetSpec(folder), mono=False)
    assert (drive.has_depth, drive.has_right, len(drive), drive.remarks) == (True, False, 5, ())
    assert drive.camera.baseline == DEPTH_CAMERA_BASELINE_M
    for index in range(5):
        assert_true(depth_of(drive, index), drive.camera, bent.poses[index])


def test_the_nearest_pixel_is_that_of_the_map_of_the_image(bent: Taken) -> None:
    rectification = rectify_parallel(bent.rig.left, SIZE)
    column = np.tile(np.arange(SIZE[0], dtype=np.float32), (SIZE[1], 1))
    nearest = rectification.rectify_depth(column)
    smooth = rectification.left((column / 2).astype(np.uint8)).astype(float) * 2
    assert np.isfinite(nearest).mean() > 0.99
    off = (nearest - smooth)[np.isfinite(nearest)]
    assert abs(off.mean()) < 0.75  # 8 bits round to two columns; the pixel to the upper left would be 1 off
    rays = rays_of(rectification.camera)
    exact = cv2.projectPoints(
        rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), bent.rig.left.K, np.array(bent.rig.left.coefficients)
    )[0][:, 0, 0].reshape(nearest.shape)
    assert np.nanmax(np.abs(nearest - exact)) < 0.55  # half a pixel, and the grid of 1/32 pixel


def test_depth_along_the_axis_of_a_turned_camera(ideal: Taken) -> None:
    T_camera_view = se3.pose(Rotation.from_euler("yx", [4, -3], degrees=True).as_matrix(), np.zeros(3))
    camera = rectify_parallel(ideal.rig.left, SIZE).camera
    still = rectify_parallel(ideal.rig.left, SIZE).left
    turned = Rectification(camera, still, still, T_camera_view)
    points_view = rays_of(camera) * 5.0
    along_raw_axis = (points_view @ T_camera_view[2, :3]).astype(np.float32)
    np.testing.assert_allclose(turned.rectify_depth(along_raw_axis), 5.0, rtol=1e-5)


def test_mono_and_places_open_no_depth_image(tmp_path: Path, ideal: Taken, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_rgbd(tmp_path / "room", ideal)
    opened: list[str] = []
    read = cv2.imread
    monkeypatch.setattr(cv2, "imread", lambda path, flags: opened.append(path) or read(path, flags))
    mono, images = open_for_odometry(DatasetSpec(folder), mono=True), open_images(DatasetSpec(folder))
    assert not mono.has_depth
    assert mono[0].depth is None
    assert mono.camera.baseline == NOMINAL_BASELINE_M
    assert (len(images), images[0].shape) == (5, (240, 320))
    assert opened
    assert not any("depth" in Path(path).parent.name for path in opened)
    assert depth_of(open_dataset(folder)).size  # the control: these are seen by the test
    assert any("depth" in Path(path).parent.name for path in opened)


def test_images_without_depth_are_left_out_and_counted(tmp_path: Path, ideal: Taken) -> None:
    folder = write_rgbd(tmp_path / "room", ideal)
    lines = (folder / "depth.txt").read_text().splitlines()
    (folder / lines[3].split()[1]).unlink()
    (folder / "depth.txt").write_text("\n".join(lines[:3] + lines[4:]) + "\n")
    drive = open_dataset(folder)
    assert drive.remarks == ("1 images without a depth image within 0.0325 s are left out",)
    np.testing.assert_array_equal(drive.timestamps, np.delete(ideal.times, 1))
    assert_true(depth_of(drive, 1), drive.camera, ideal.poses[2])
    assert drive.ground_truth is not None
    assert len(drive.ground_truth) == 4


def test_free_running_cameras_lose_no_image() -> None:
    colour = np.arange(100) / 30.0
    depth = np.arange(101) / 30.3 - 0.01  # slides through a whole frame
    pairs = associate_with_nearest(depth, colour, 0.65 / 30.0)
    assert len(pairs) == 100
    assert np.abs(depth[pairs[:, 1]] - colour).max() < 0.5 / 30.0 + 1e-3
    assert (np.diff(pairs, axis=0) >= 0).all()
    assert len(associate_with_nearest(depth + 7, colour, 0.02)) == 0
    assert len(associate_with_nearest(np.empty(0), colour, 1.0)) == 0


def eight_bits(folder: Path) -> None:
    for file in folder.glob("depth/*.png"):
        cv2.imwrite(str(file), (cv2.imread(str(file), -1) >> 8).astype(np.uint8))


def colour_as_depth(folder: Path) -> None:
    (folder / "depth.txt").write_text((folder / "rgb.txt").read_text())


def smaller(folder: Path) -> None:
    for file in folder.glob("depth/*.png"):
        cv2.imwrite(str(file), cv2.imread(str(file), -1)[::2, ::2])


def without_folder(folder: Path) -> None:
    (folder / "depth").rename(folder / "elsewhere")


def empty_list(folder: Path) -> None:
    (folder / "depth.txt").write_text("# depth maps\n")


def of_another_time(folder: Path) -> None:
    lines = [line.split() for line in (folder / "depth.txt").read_text().splitlines()[2:]]
    (folder / "depth.txt").write_text("".join(f"{float(time) + 100:.6f} {name}\n" for time, name in lines))


def cut(folder: Path) -> None:
    for file in folder.glob("depth/*.png"):
        file.write_bytes(file.read_bytes()[:40])


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (eight_bits, "expected depth of 16 bits or floats, found uint8"),
        (colour_as_depth, "expected one depth in each pixel, found a colour image; are colour and depth swapped?"),
        (smaller, "expected depth of 320 x 240 pixels, found 160 x 120: it is not registered to the colour"),
        (without_folder, "5 of 5 listed images are missing"),
        (empty_list, "depth.txt: expected lines of 2 cells, found none"),
        (of_another_time, "expected depth within 0.0325 s of colour images, found none"),
        (cut, "expected a depth image, found a file that cannot be read; copy it again"),
    ],
)
def test_depth_that_cannot_be_used_leaves_one_camera(
    tmp_path: Path, ideal: Taken, damage: Callable[[Path], None], words: str
) -> None:
    folder = write_rgbd(tmp_path / "room", ideal)
    damage(folder)
    drive = open_dataset(folder)
    assert (drive.has_depth, len(drive), drive[2].depth, drive.camera.baseline) == (False, 5, None, NOMINAL_BASELINE_M)
    (remark,) = drive.remarks
    assert words in remark
    assert remark.endswith("the depth is not used")
    assert "\n" not in remark
    assert open_for_odometry(DatasetSpec(folder), mono=True).remarks == ()
    with pytest.raises(
        DataError, match=r"found left ones only \(.*the depth is not used\); use one camera with --mono"
    ):
        open_for_odometry(DatasetSpec(folder), mono=False)


def test_a_damaged_depth_image_in_the_middle_is_named_when_it_is_read(tmp_path: Path, ideal: Taken) -> None:
    folder = write_rgbd(tmp_path / "room", ideal)
    drive = open_dataset(folder)
    file = sorted(folder.glob("depth/*.png"))[1]
    file.write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(DataError, match=f"{file}: expected a depth image, found a file that cannot be read"):
        drive[1]
    assert_true(depth_of(drive, 2), drive.camera, ideal.poses[2])


@pytest.mark.parametrize("depth_first", [True, False])
def test_associations_of_orb_slam_are_read(tmp_path: Path, ideal: Taken, depth_first: bool) -> None:
    folder = write_rgbd(tmp_path / "room", ideal)
    rows = []
    for colour, depth in zip(
        *[(folder / f"{n}.txt").read_text().splitlines()[-5:] for n in ("rgb", "depth")], strict=True
    ):
        rows.append(f"{depth} {colour}" if depth_first else f"{colour} {depth}")
    for name in ("rgb.txt", "depth.txt"):
        (folder / name).unlink()
    (folder / "associations.txt").write_text("\n".join(rows) + "\n")
    drive = open_dataset(folder)
    assert (drive.has_depth, len(drive), drive.remarks) == (True, 5, ())
    np.testing.assert_allclose(drive.timestamps, ideal.times, atol=1e-6)
    assert_true(depth_of(drive, 2), drive.camera, ideal.poses[2])


def test_openloris_has_millimetres_in_aligned_depth(tmp_path: Path, ideal: Taken) -> None:
    folder = write_rgbd(tmp_path / "home1-1", ideal, scale=1000.0)
    (folder / "rgb").rename(folder / "color")
    (folder / "color.txt").write_text((folder / "rgb.txt").read_text().replace("rgb/", "color/"))
    (folder / "rgb.txt").unlink()
    unaligned = open_dataset(folder)
    assert not unaligned.has_depth
    assert any("depth.txt is not registered to the colour: the depth is not used" in r for r in unaligned.remarks)
    (folder / "depth").rename(folder / "aligned_depth")
    (folder / "aligned_depth.txt").write_text((folder / "depth.txt").read_text().replace("depth/", "aligned_depth/"))
    drive = open_dataset(folder)
    assert drive.has_depth
    assert_true(depth_of(drive, 2), drive.camera, ideal.poses[2])


def write_icl_nuim(root: Path, count: int = 5) -> tuple[Path, np.ndarray]:
    """A sequence of noise in the layout of ICL-NUIM, and its poses in ICL-NUIM's own axes, y up, of images 1, 2, ..."""
    rng = np.random.default_rng(4)
    for name in ("rgb", "depth"):
        (root / name).mkdir(parents=True)
    for k in range(count):
        cv2.imwrite(str(root / f"rgb/{k}.png"), rng.integers(0, 255, (480, 640, 3), dtype=np.uint8))
        cv2.imwrite(str(root / f"depth/{k}.png"), np.full((480, 640), 10000 + k, np.uint16))
    (root / "associations.txt").write_text("".join(f"{k} depth/{k}.png {k} rgb/{k}.png\n" for k in range(count)))
    step = se3.pose(Rotation.from_rotvec([0.02, -0.03, 0.01]).as_matrix(), np.array([0.02, 0.03, 0.05]))
    poses = [se3.pose(Rotation.from_rotvec([0.1, 0.2, -0.1]).as_matrix(), np.array([0.3, 1.2, -2.25]))]
    for _ in range(count - 2):
        poses.append(poses[-1] @ step)
    write_tum(root / "livingRoom0.gt.freiburg", np.arange(1.0, count), np.array(poses))
    return root, np.array(poses)


def test_icl_nuim_has_y_down_in_camera_and_poses(tmp_path: Path) -> None:
    folder, poses = write_icl_nuim(tmp_path / "living_room_traj0_frei_png")
    drive = open_for_odometry(DatasetSpec(folder), mono=False)
    assert drive.ground_truth is not None
    np.testing.assert_allclose(drive.timestamps, np.arange(1, 5) / 30)  # image 0 has no pose
    np.testing.assert_allclose(depth_of(drive, 0), 10001 / 5000)
    assert "counts the images: 30 in a second are assumed" in drive.remarks[0]
    # The data set's own camera, with fy = -480, sees points of the world in the pixels in which ours sees its mirror.
    K_up = np.array([[481.2, 0, 319.5], [0, -480.0, 239.5], [0, 0, 1]])
    X_first = np.random.default_rng(1).uniform([-1, -1, 2], [1, 1, 4], (20, 3))  # in the first camera, y up
    X_world = X_first @ poses[0, :3, :3].T + poses[0, :3, 3]
    for T_up, T in zip(poses, drive.ground_truth, strict=True):
        seen = (X_world - T_up[:3, 3]) @ T_up[:3, :3] @ K_up.T
        X_down = X_first * [1, -1, 1]
        ours = (X_down - T[:3, 3]) @ T[:3, :3] @ drive.camera.K.T
        np.testing.assert_allclose(ours[:, :2] / ours[:, 2:], seen[:, :2] / seen[:, 2:], atol=1e-3)


def test_a_given_rate_replaces_that_of_counted_images(tmp_path: Path) -> None:
    folder, _ = write_icl_nuim(tmp_path / "traj0")
    np.testing.assert_allclose(open_dataset(DatasetSpec(folder, fps=10.0)).timestamps, np.arange(1, 5) / 10)


def write_custom(root: Path, drive: Taken, suffix: str = ".png", **more: object) -> Path:
    """Folders rgb and depth, and a camera.toml that names the second."""
    for name in ("rgb", "depth"):
        (root / name).mkdir(parents=True)
    for k, (depth, pair) in enumerate(zip(raw_depths(drive), drive.pairs, strict=True)):
        cv2.imwrite(str(root / f"rgb/{k}.png"), pair[0])
        file = root / f"depth/{k}{suffix}"
        if suffix == ".npy":
            np.save(file, depth.astype(np.float32))
        else:
            cv2.imwrite(str(file), np.rint(depth * 1000).astype(np.uint16) if suffix == ".png" else np.float32(depth))
    (root / CAMERA_TOML).write_text(camera_toml(drive.rig, pair=False, fps=RATE, depth="depth", **more))
    return root


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".npy", ".pfm"])
def test_a_custom_camera_names_its_depth(tmp_path: Path, ideal: Taken, suffix: str) -> None:
    drive = open_for_odometry(DatasetSpec(write_custom(tmp_path / "mine", ideal, suffix)), mono=False)
    assert (drive.has_depth, len(drive), drive.remarks) == (True, 5, ())
    assert_true(depth_of(drive, 4), drive.camera, ideal.poses[4])


def test_fewer_depth_images_need_numbers_or_times(tmp_path: Path, ideal: Taken) -> None:
    folder = write_custom(tmp_path / "mine", ideal)
    (folder / "depth" / "1.png").unlink()
    drive = open_dataset(folder)
    assert drive.remarks[:1] == ("depth: depth images belong to the colour images of their numbers",)
    assert len(drive) == 4
    assert_true(depth_of(drive, 1), drive.camera, ideal.poses[2])
    (folder / "depth" / "0.png").rename(folder / "depth" / "x.png")
    with pytest.raises(DataError, match="expected 5 depth images as there are colour images, found 4"):
        open_dataset(folder)
    (folder / "depth" / "times.txt").write_text("0.1\n0.15\n0.2\n0.0\n".replace("0.0\n", "0.25\n"))
    assert len(open_dataset(folder)) == 3


def test_names_and_keys_of_depth_are_checked(tmp_path: Path, ideal: Taken) -> None:
    folder = write_custom(tmp_path / "mine", ideal)
    (folder / "depth").rename(tmp_path / "range")
    with pytest.raises(DataError, match="expected a folder of depth images called depth, found none; check depth"):
        open_dataset(folder)
    assert len(open_dataset(DatasetSpec(folder, left_only=True))) == 5
    (tmp_path / "range").rename(folder / "depth")
    for key, meant in (("DepthMapFactor", "depth_scale"), ("depth_folder", "depth"), ("depth_scal", "depth_scale")):
        (folder / CAMERA_TOML).write_text(camera_toml(ideal.rig, pair=False, **{key: 5000}))
        with pytest.raises(DataError, match=f"found '{key}' .did you mean {meant}.."):
            read_camera_toml(folder / CAMERA_TOML)
    for wrong, words in ((-1, "expected depth_scale above 0"), (True, "expected a number depth_scale")):
        (folder / CAMERA_TOML).write_text(camera_toml(ideal.rig, pair=False) + f"depth_scale = {str(wrong).lower()}\n")
        with pytest.raises(DataError, match=words):
            read_camera_toml(folder / CAMERA_TOML)


def test_a_pair_needs_no_depth(tmp_path: Path, ideal: Taken) -> None:
    folder = write_folders(tmp_path / "mine", ideal, fps=RATE, depth="depth")
    write_depth(folder, ideal)
    drive = open_dataset(folder)
    assert (drive.has_right, drive.has_depth) == (True, False)
    assert drive.remarks == ("there is a pair of cameras and depth: the depth is not used",)


def test_a_pair_without_a_baseline_has_its_depth(tmp_path: Path, ideal: Taken) -> None:
    """As a simulated drive in KITTI's layout with its true depth."""
    folder = write_custom(tmp_path / "mine", ideal)
    (folder / "rgb").rename(folder / "image_0")
    shutil.copytree(folder / "image_0", folder / "image_1")
    drive = open_dataset(folder)
    assert (drive.has_right, drive.has_depth, drive.remarks) == (False, True, ())


@pytest.mark.parametrize(("scale", "likely"), [(5.0, "depth_scale = 1000"), (3_000_000.0, "depth_scale = 1000")])
def test_an_impossible_scale_is_said_with_a_likely_one(tmp_path: Path, ideal: Taken, scale: float, likely: str) -> None:
    drive = open_dataset(write_custom(tmp_path / "mine", ideal, depth_scale=scale))
    (remark,) = drive.remarks
    assert "the median depth is" in remark
    assert f"give {likely} in camera.toml, now it is {scale:g}" in remark
    assert open_dataset(write_custom(tmp_path / "good", ideal, depth_scale=1000.0)).remarks == ()


def test_a_scale_in_camera_toml_is_that_of_a_benchmark_too(tmp_path: Path, ideal: Taken) -> None:
    folder = write_depth(write_tum_rgbd(tmp_path / "rgbd_dataset_freiburg3_mine", ideal), ideal, scale=1000.0)
    (folder / CAMERA_TOML).write_text("depth_scale = 1000\n")
    drive = open_dataset(folder)
    assert drive.camera.fx == 535.4
    assert np.nanmedian(depth_of(drive, 0)) == pytest.approx(np.median(raw_depths(ideal)[0]), rel=0.01)


def test_settings_of_orb_slam_give_camera_and_scale(tmp_path: Path, ideal: Taken) -> None:
    folder = write_rgbd(tmp_path / "office", ideal, scale=1000.0)
    (folder / CAMERA_TOML).unlink()
    settings = '%YAML:1.0\nCamera.type: "PinHole"\nCamera.fx: 260.0\nCamera.fy: 260.0\nCamera.cx: 160.0\n'
    (folder / "office.yaml").write_text(f"{settings}Camera.cy: 118.0\nCamera.bf: 40.0\nDepthMapFactor: 1000.0\n")
    drive = open_dataset(folder)
    assert (drive.has_depth, drive.camera.baseline, drive.camera.fx) == (True, DEPTH_CAMERA_BASELINE_M, 260.0)
    assert_true(depth_of(drive), drive.camera, ideal.poses[3])
    (folder / "office.yaml").write_text(f"{settings}Camera.cy: 118.0\nDepthMapFactor: 0\n")
    with pytest.raises(DataError, match="expected DepthMapFactor above 0, found 0"):
        open_dataset(folder)


def test_colour_is_read_where_it_is_asked_for(tmp_path: Path, bent: Taken) -> None:
    folder = write_rgbd(tmp_path / "room", bent, 4000.0, depth_scale=4000)
    grey = open_dataset(folder)
    shown = grey.read_color(2)
    assert shown is not None
    left = grey[2].left
    np.testing.assert_array_equal(shown, np.dstack([left] * 3))  # colour files of grey values
    for file in (folder / "rgb").iterdir():
        image = cv2.imread(str(file))
        image[..., 1:] //= 2  # blue is the strongest
        cv2.imwrite(str(file), image)
    colour = open_dataset(folder).read_color(2)
    assert colour is not None
    assert (colour.shape, colour.dtype) == ((240, 320, 3), np.uint8)
    np.testing.assert_array_equal(colour[..., 2], left)  # RGB, in the pixels of the rectified image
    assert (colour[..., 0] < colour[..., 2]).mean() > 0.99
    for file in (folder / "rgb").iterdir():
        cv2.imwrite(str(file), cv2.imread(str(file), cv2.IMREAD_GRAYSCALE))
    assert open_dataset(folder).read_color(2) is None


def test_colour_of_a_video(tmp_path: Path, ideal: Taken) -> None:
    write_video(tmp_path / "left.avi", [left for left, _ in ideal.pairs])
    (tmp_path / CAMERA_TOML).write_text(camera_toml(ideal.rig, pair=False))
    drive = open_dataset(tmp_path)
    for index in (1, 2, 0):
        colour = drive.read_color(index)
        assert colour is not None
        assert np.abs(colour.mean(axis=2) - drive[index].left).mean() < 2


def test_values_become_metres_and_holes() -> None:
    whole = np.array([[0, 500, 65535, 1000]], np.uint16)
    np.testing.assert_array_equal(to_metres(whole, 1000.0), np.float32([[np.nan, 0.5, np.nan, 1.0]]))
    floats = np.array([[0.0, -1.0, np.nan, np.inf, 2.5]], np.float32)
    np.testing.assert_array_equal(to_metres(floats, 1.0), np.float32([[np.nan, np.nan, np.nan, np.nan, 2.5]]))
    assert describe_scale(2.0, 1000.0) == ""
    assert "depth_scale" in describe_scale(1e6, 1.0)
    for wrong in (np.zeros((4, 4, 3), np.uint16), np.zeros((4, 4), np.uint8), np.zeros((4, 4), complex)):
        with pytest.raises(ValueError, match="expected"):
            to_metres(wrong, 1000.0)
