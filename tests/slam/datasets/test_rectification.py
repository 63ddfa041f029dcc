"""Any two cameras become an ideal pair: what is seen where is known from OpenCV's own projection."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from slam.datasets.distortion_models import CameraModel
from slam.datasets.rectification import IdentityMap, Rectification, rectify_pair, rectify_parallel
from slam.diagnostics.sensor_checks import match_displacements

from .rig import IDEAL, RIGS, SIZE, Rig, Walls, seen_at, turned

DISTORTED = [name for name in RIGS if name != "ideal"]


def rectified(rig: Rig) -> Rectification:
    return rectify_pair(rig.left, rig.right, rig.T_left_right, SIZE)


def read_at(maps: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Where each pixel (H, W, 2) is read, of OpenCV's packed maps."""
    return np.dstack(cv2.convertMaps(*maps, cv2.CV_32FC1))


@pytest.mark.parametrize("name", DISTORTED)
def test_a_point_of_the_ideal_pair_is_read_where_the_real_cameras_see_it(name: str) -> None:
    rig, ideal = RIGS[name], rectified(RIGS[name])
    pixels = np.stack(np.meshgrid(np.arange(0, SIZE[0], 13), np.arange(0, SIZE[1], 11)), axis=-1).reshape(-1, 2)
    disparity = 4.0 * np.random.default_rng(0).integers(1, 8, len(pixels))
    points = se3.transform(ideal.T_camera_view, ideal.camera.triangulate(pixels, disparity))
    left = read_at(ideal.left.maps)[pixels[:, 1], pixels[:, 0]]
    np.testing.assert_allclose(left, seen_at(rig.left, points), atol=0.05)
    inside = pixels[:, 0] >= disparity
    others = (pixels[:, 0] - disparity)[inside].astype(int)
    right = read_at(ideal.right.maps)[pixels[inside, 1], others]
    expected = seen_at(rig.right, se3.transform(se3.inverse(rig.T_left_right), points[inside]))
    np.testing.assert_allclose(right, expected, atol=0.05)


@pytest.mark.parametrize("name", DISTORTED)
def test_the_ideal_pair_shows_nothing_that_a_camera_has_not_seen(name: str) -> None:
    ideal = rectified(RIGS[name])
    for view in (ideal.left, ideal.right):
        places = read_at(view.maps)
        assert places.min() > -0.1
        assert (places.max(axis=(0, 1)) < np.array(SIZE) - 0.9).all()
    assert ideal.camera.width / ideal.camera.fx > 0.7  # a good part of the view is left


@pytest.mark.parametrize("name", RIGS)
def test_matches_of_rectified_images_lie_in_common_rows(name: str) -> None:
    rig, ideal = RIGS[name], rectified(RIGS[name])
    left, right = Walls().pair(rig, np.eye(4))
    moved = match_displacements(ideal.left(left), ideal.right(right))
    assert len(moved) > 50
    assert np.median(np.abs(moved[:, 1])) < 0.3
    # walls 6 and 12 m ahead, a little to each side of it where the pair was turned
    depth = ideal.camera.fx * ideal.camera.baseline / moved[:, 0]
    assert 5.0 < np.percentile(depth, 10) < np.percentile(depth, 90) < 14.0


def test_matches_of_unrectified_images_do_not_lie_in_common_rows() -> None:
    left, right = Walls().pair(RIGS["radtan"], np.eye(4))
    assert np.median(np.abs(match_displacements(left, right)[:, 1])) > 2.0


def test_an_ideal_pair_is_left_as_it_is() -> None:
    ideal = rectified(IDEAL)
    assert isinstance(ideal.left, IdentityMap)
    assert (ideal.camera.fx, ideal.camera.cx, ideal.camera.cy, ideal.camera.baseline) == (260.0, 160.0, 118.0, 0.3)
    image = Walls().image(IDEAL.left, np.eye(4))
    assert ideal.left(image) is image


@pytest.mark.parametrize("name", DISTORTED)
def test_the_axes_are_those_of_opencv_up_to_a_turn_about_the_baseline(name: str) -> None:
    rig = RIGS[name]
    T_right_left = se3.inverse(rig.T_left_right)
    D = np.zeros(5)
    R, t = T_right_left[:3, :3].copy(), T_right_left[:3, 3:].copy()
    R_view_left = cv2.stereoRectify(rig.left.K, D, rig.right.K, D, SIZE, R, t)[0]
    mine = rectified(rig).T_camera_view[:3, :3]
    np.testing.assert_allclose(mine[:, 0], R_view_left[0], atol=1e-9)
    assert mine[:, 2] @ R_view_left[2] > np.cos(np.radians(1.0))


def test_images_of_one_camera_are_undistorted() -> None:
    lens = RIGS["radtan"].left
    alone = rectify_parallel(lens, SIZE)
    image = alone.left(Walls().image(lens, np.eye(4)))
    straight = CameraModel(alone.camera.fx, alone.camera.fy, alone.camera.cx, alone.camera.cy)
    expected = Walls().image(straight, np.eye(4))
    assert np.corrcoef(image.ravel(), expected.ravel())[0, 1] > 0.99
    assert np.corrcoef(image[:, 1:].ravel(), expected[:, :-1].ravel())[0, 1] < 0.97  # a pixel aside is worse


@pytest.mark.parametrize(
    ("T_left_right", "message"),
    [
        (turned((0, 0, 0), (-0.3, 0, 0)), "expected the right camera to the right of the left one"),
        (turned((0, 0, 0), (0, 0.3, 0)), "expected the right camera to the right"),
        (turned((0, 0, 0), (0, 0, 0)), "expected the right camera to the right"),
        (turned((0, 60, 0), (0.3, 0, 0)), "more than 45 degrees between them"),
    ],
)
def test_cameras_that_cannot_form_a_pair_are_refused(T_left_right: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        rectify_pair(IDEAL.left, IDEAL.right, T_left_right, SIZE)


@pytest.mark.parametrize(
    ("model", "coefficients"), [("radtan", (-3.0, 0.0, 0.0, 0.0)), ("equidistant", (-1.0, 0.0, 0.0, 0.0))]
)
def test_a_lens_that_folds_over_is_refused(model: str, coefficients: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=f"expected {model} coefficients that"):
        rectify_parallel(CameraModel(100.0, 100.0, 160.0, 120.0, model, coefficients), SIZE)


numbers = st.floats(-0.3, 0.3)


@settings(max_examples=60, deadline=None)
@given(
    model=st.sampled_from(["radtan", "equidistant"]),
    coefficients=st.tuples(numbers, numbers, numbers, numbers),
    focal=st.floats(30.0, 2000.0),
)
def test_any_distortion_is_undone_or_refused(model: str, coefficients: tuple[float, ...], focal: float) -> None:
    lens = CameraModel(focal, focal, 160.0, 120.0, model, coefficients)
    try:
        alone = rectify_parallel(lens, SIZE)
    except ValueError:
        return
    view = np.array([[3.0, 5.0], [160.0, 120.0], [310.0, 230.0]])
    rays = np.hstack([(view - [alone.camera.cx, alone.camera.cy]) / alone.camera.fx, np.ones((3, 1))])
    if isinstance(alone.left, IdentityMap):
        return
    places = read_at(alone.left.maps)[view[:, 1].astype(int), view[:, 0].astype(int)]
    np.testing.assert_allclose(places, seen_at(lens, rays), atol=0.1)


@pytest.mark.parametrize("name", RIGS)
def test_unprojected_pixels_project_back_to_themselves(name: str) -> None:
    model = RIGS[name].left
    pixels = np.random.default_rng(2).uniform([60.0, 40.0], [260.0, 200.0], (50, 2))
    rays = model.unproject(pixels)
    np.testing.assert_array_equal(rays[:, 2], 1.0)
    np.testing.assert_allclose(seen_at(model, rays), pixels, atol=0.02)


@settings(max_examples=40, deadline=None)
@given(
    rotation=st.tuples(*[st.floats(-8.0, 8.0)] * 3),
    offset=st.tuples(st.floats(0.05, 2.0), st.floats(-0.03, 0.03), st.floats(-0.03, 0.03)),
)
def test_rectified_points_lie_in_one_row_with_the_disparity_of_their_depth(
    rotation: tuple[float, float, float], offset: tuple[float, float, float]
) -> None:
    T_left_right = turned(rotation, offset)
    ideal = rectify_pair(IDEAL.left, IDEAL.right, T_left_right, SIZE)
    points_view = np.random.default_rng(0).uniform([-2, -1.5, 4], [2, 1.5, 30], (40, 3))
    points_left = se3.transform(ideal.T_camera_view, points_view)
    # The same rotation, seen from the right camera: both rectified cameras have the axes of the left view.
    T_left_rightview = ideal.T_camera_view.copy()
    T_left_rightview[:3, 3] = T_left_right[:3, 3]
    left = ideal.camera.project(points_view)
    in_right = se3.transform(se3.inverse(T_left_rightview), points_left)
    u_right = ideal.camera.fx * in_right[:, 0] / in_right[:, 2] + ideal.camera.cx
    v_right = ideal.camera.fy * in_right[:, 1] / in_right[:, 2] + ideal.camera.cy
    np.testing.assert_allclose(v_right, left[:, 2], atol=1e-6)
    np.testing.assert_allclose(
        left[:, 0] - u_right, ideal.camera.fx * ideal.camera.baseline / points_view[:, 2], atol=1e-6
    )


def test_the_pose_of_a_rectified_camera_is_a_rotation() -> None:
    for name in RIGS:
        T = rectified(RIGS[name]).T_camera_view
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_array_equal(T[:3, 3], 0.0)
