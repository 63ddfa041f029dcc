"""Relative poses from landmarks: right, honest about their error, and refused where there is none."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from odometry import se3
from odometry.camera import StereoCamera
from place_recognition.image_processing.local_features import FeatureExtractor, LocalFeatures
from place_recognition.image_processing.matching import mutual_matches
from slam.loop_closing.loop_closer import FrameLandmarks, LoopCloser, LoopCloserConfig, LoopClosure, Rejection
from slam.loop_closing.relative_pose import UNIT_SCALE, RelativePoseConfig, estimate_relative_scale, relative_pose

CAMERA = StereoCamera(fx=700.0, fy=700.0, cx=600.0, cy=180.0, baseline=0.54, width=1200, height=370)
UNBIASED = RelativePoseConfig(
    systematic_rad=0.0,
    systematic_rad_per_m=0.0,
    systematic_m=0.0,
    systematic_m_per_m=0.0,
    systematic_disparity_px=0.0,
)
MOTION = se3.exp(np.array([0.02, -0.08, 0.01, 0.4, -0.1, 1.2]))


@dataclass
class World:
    """Points with descriptors, and stereo cameras that see them with half a pixel of noise.

    The first pixel of an image is the number of its view; its features and disparities are looked up by that.
    """

    points: np.ndarray
    descriptors: np.ndarray
    rng: np.random.Generator
    noise: float = 0.5
    has_metric_scale: bool = True

    def __post_init__(self) -> None:
        self.views: list[tuple[LocalFeatures, np.ndarray]] = []

    def look(self, T_world_camera: np.ndarray) -> np.ndarray:
        """Add a view; answer with its image."""
        pixels = CAMERA.project(se3.transform(se3.inverse(T_world_camera), self.points))
        size = np.array([CAMERA.width, CAMERA.width, CAMERA.height])
        seen = np.flatnonzero(((pixels > 0) & (pixels < size)).all(axis=1))
        seen = self.rng.permutation(seen)
        disparity = pixels[seen, 0] - pixels[seen, 1] + self.rng.normal(0, self.noise, len(seen))
        where = pixels[seen][:, [0, 2]] + self.rng.normal(0, self.noise, (len(seen), 2))
        described = self.descriptors[seen] + 0.02 * self.rng.normal(size=(len(seen), 64))
        described /= np.linalg.norm(described, axis=1, keepdims=True)
        ones = np.ones(len(seen), np.float32)
        features = LocalFeatures(where.astype(np.float32), ones, ones, described.astype(np.float32))
        self.views.append((features, disparity))
        return np.full((CAMERA.height, CAMERA.width), len(self.views) - 1, np.uint8)

    def extract(self, image: np.ndarray, mask: np.ndarray | None = None) -> LocalFeatures:
        return self.views[image[0, 0]][0]

    def disparity(self, left: np.ndarray, right: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        return self.views[left[0, 0]][1][: len(pixels)]


@dataclass
class Depth:
    """Disparities by a function, as a visual odometry gives them."""

    disparity: Callable[..., np.ndarray]
    has_metric_scale: bool = True


def world(seed: int = 0, count: int = 600) -> World:
    rng = np.random.default_rng(seed)
    points = rng.uniform([-15, -4, 4], [15, 2, 40], (count, 3))
    return World(points, rng.normal(size=(count, 64)), rng)


def add_image(
    closer: LoopCloser, extractor: FeatureExtractor, index: int, left: np.ndarray, right: np.ndarray | None
) -> FrameLandmarks:
    landmarks = closer.extract_landmarks(index, extractor.extract(left), left, right)
    closer.add_frame(index, landmarks)
    return landmarks


def closer_over(scene: World, poses: list[np.ndarray], config: LoopCloserConfig | None = None) -> LoopCloser:
    closer = LoopCloser(CAMERA, scene, config)
    for index, pose in enumerate(poses):
        image = scene.look(pose)
        add_image(closer, scene, index, image, image)
    return closer


def test_a_loop_is_closed_with_the_right_pose() -> None:
    answer = closer_over(world(), [np.eye(4), MOTION]).verify(1, 0)
    assert isinstance(answer, LoopClosure)
    error = se3.log(se3.inverse(MOTION) @ answer.T_match_query)
    assert np.abs(error[:3]).max() < 1e-3
    assert np.abs(error[3:]).max() < 0.03
    assert (answer.query, answer.match) == (1, 0)
    assert 100 < answer.inliers <= answer.matches


def test_errors_of_the_relative_pose_agree_with_its_covariance() -> None:
    nees = []
    for seed in range(25):
        config = LoopCloserConfig(relative_pose=UNBIASED)
        answer = closer_over(world(seed, 400), [np.eye(4), MOTION], config).verify(1, 0)
        assert isinstance(answer, LoopClosure)
        error = se3.log(se3.inverse(MOTION) @ answer.T_match_query)
        nees.append(error @ np.linalg.solve(answer.covariance, error))
    assert 3.0 < np.mean(nees) < 12.0


def test_more_noise_makes_a_larger_covariance() -> None:
    quiet, loud = world(), world()
    loud.noise = 1.0
    config = LoopCloserConfig(relative_pose=UNBIASED)
    one, two = (closer_over(w, [np.eye(4), MOTION], config).verify(1, 0) for w in (quiet, loud))
    assert isinstance(one, LoopClosure)
    assert isinstance(two, LoopClosure)
    assert np.trace(two.covariance[3:, 3:]) > 2.0 * np.trace(one.covariance[3:, 3:])


def test_a_disparity_bias_stays_within_the_covariance() -> None:
    scene = world()
    closer = LoopCloser(CAMERA, Depth(lambda *view: scene.disparity(*view) + 0.4))
    for index, pose in enumerate([np.eye(4), MOTION]):
        image = scene.look(pose)
        add_image(closer, scene, index, image, image)
    answer = closer.verify(1, 0)
    assert isinstance(answer, LoopClosure)
    error = se3.log(se3.inverse(MOTION) @ answer.T_match_query)
    assert error @ np.linalg.solve(answer.covariance, error) < 12.0


def test_half_of_the_matches_may_be_wrong() -> None:
    rng, points = np.random.default_rng(2), world().points
    points_query = se3.transform(se3.inverse(MOTION), points)
    visible = np.flatnonzero(points_query[:, 2] > 3)
    points_query[visible[::2]] = rng.uniform([-15, -4, 4], [15, 2, 40], (len(visible[::2]), 3))
    answer = relative_pose(CAMERA, points[visible], points_query[visible], RelativePoseConfig())
    assert answer is not None
    np.testing.assert_allclose(answer.T_a_b, MOTION, atol=0.02)
    assert answer.inliers[1::2].all()
    assert answer.inliers[::2].mean() < 0.05


@pytest.mark.parametrize("depth_m", [0.0, 1e-4, -1e-4, -5.0, 0.02])
def test_a_wrong_match_that_the_pose_puts_into_the_image_plane_costs_nothing_else(depth_m: float) -> None:
    """Its noise has no bound there: the covariance of its pixels could not be inverted, and the whole run ended."""
    rng, points = np.random.default_rng(3), world().points
    points_query = se3.transform(se3.inverse(MOTION), points)
    visible = points_query[:, 2] > 3
    wrong = se3.transform(MOTION, np.array([[60.0, 20.0, depth_m], [-3.0, 1.0, depth_m], [0.0, 0.0, depth_m]]))
    points_match = np.concatenate([points[visible], wrong])
    points_query = np.concatenate([points_query[visible], rng.uniform([-9, -4, 8], [9, 2, 40], (3, 3))])
    answer = relative_pose(CAMERA, points_match, points_query, RelativePoseConfig())
    assert answer is not None
    np.testing.assert_allclose(answer.T_a_b, MOTION, atol=0.02)
    assert answer.inliers[:-3].all()
    assert not answer.inliers[-3:].any()


def test_landmarks_that_determine_no_pose_have_none() -> None:
    points = np.tile([[1.0, 0.5, 8.0]], (40, 1))  # one landmark, forty times
    assert relative_pose(CAMERA, points, points, RelativePoseConfig()) is None


@pytest.mark.parametrize("seed", range(8))
def test_landmarks_near_infinity_do_not_throw_the_pose_off(seed: int) -> None:
    rng, T_match_query = np.random.default_rng(seed), se3.exp(np.array([0.0, 0.012, 0.0, 0.02, 0.04, 0.05]))
    sky = CAMERA.triangulate(rng.uniform([50, 20], [1150, 180], (50, 2)), np.full(50, 1e-3))
    points = np.concatenate([rng.uniform([-15, -4, 6], [15, 2, 45], (100, 3)), sky])
    points_match, points_query = (
        measured(rng, se3.transform(se3.inverse(T), points)) for T in (np.eye(4), T_match_query)
    )
    answer = relative_pose(CAMERA, points_match, points_query, RelativePoseConfig())
    assert answer is not None
    assert answer.inliers.sum() > 80
    np.testing.assert_allclose(answer.T_a_b[:3, 3], T_match_query[:3, 3], atol=0.05)


def measured(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    """Points (N, 3) as two cameras see them: what is far away comes out anywhere from hundreds of metres on."""
    left, right, row = CAMERA.project(points).T + rng.normal(0, 0.15, (3, len(points)))
    return CAMERA.triangulate(np.stack([left, row], axis=1), np.abs(left - right))


def test_images_of_different_places_are_rejected() -> None:
    here, there = world(0), world(1)
    image = there.look(np.eye(4))
    closer = closer_over(here, [np.eye(4)])
    here.views.append(there.views[0])
    add_image(closer, here, 1, image + 1, image)
    answer = closer.verify(1, 0)
    assert isinstance(answer, Rejection)
    assert "landmarks match, expected at least 20" in answer.reason


def test_matches_without_a_common_motion_are_rejected() -> None:
    scene = world()
    closer = closer_over(scene, [np.eye(4)])
    scene.points = np.random.default_rng(9).permutation(scene.points)
    image = scene.look(np.eye(4))
    add_image(closer, scene, 1, image, image)
    answer = closer.verify(1, 0)
    assert isinstance(answer, Rejection)
    assert answer.matches > 100
    assert "relative pose" in answer.reason


def test_landmarks_in_one_corner_are_rejected() -> None:
    scene = world(count=3000)
    pixels = CAMERA.project(scene.points)
    corner = (pixels[:, 0] < 250) & (pixels[:, 2] < 150)
    scene.points, scene.descriptors = scene.points[corner], scene.descriptors[corner]
    answer = closer_over(scene, [np.eye(4), se3.exp(np.array([0, 0, 0, 0.1, 0, 0]))]).verify(1, 0)
    assert isinstance(answer, Rejection)
    assert "cells" in answer.reason
    assert len(answer.pixels_query) == len(answer.pixels_match) == answer.inliers > 0
    np.testing.assert_array_less(answer.pixels_match, [[250, 150]] * answer.inliers)


def test_landmarks_come_back_in_the_camera_frame() -> None:
    scene = world()
    scene.noise = 0.0
    image = scene.look(MOTION)
    landmarks = add_image(LoopCloser(CAMERA, scene), scene, 7, image, image)
    seen = CAMERA.project(landmarks.points.astype(np.float64))
    np.testing.assert_allclose(seen[:, [0, 2]], landmarks.pixels, atol=1e-2)
    assert landmarks.points.dtype == landmarks.pixels.dtype == np.float32
    assert landmarks.descriptors.dtype == np.float16
    assert landmarks.grey.shape == (len(landmarks),)


def test_features_without_disparity_are_no_landmarks() -> None:
    scene = world()
    image = scene.look(np.eye(4))

    def every_other(left: np.ndarray, right: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        return np.where(np.arange(len(pixels)) % 2, np.nan, scene.disparity(left, right, pixels))

    closer = LoopCloser(CAMERA, Depth(every_other))
    assert len(add_image(closer, scene, 0, image, image)) == (len(scene.views[0][1]) + 1) // 2


def test_an_image_without_features_is_rejected_not_an_error() -> None:
    scene = world()
    scene.points = np.zeros((0, 3))
    answer = closer_over(scene, [np.eye(4), np.eye(4)]).verify(1, 0)
    assert isinstance(answer, Rejection)
    assert answer.reason == "0 landmarks match, expected at least 20"


def test_the_same_images_give_the_same_bits() -> None:
    one, two = (closer_over(world(), [np.eye(4), MOTION]) for _ in range(2))
    cv2.setRNGSeed(99)
    first, second = one.verify(1, 0), two.verify(1, 0)
    assert isinstance(first, LoopClosure)
    assert isinstance(second, LoopClosure)
    assert first.T_match_query.tobytes() == second.T_match_query.tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()


def test_the_error_for_a_frame_that_was_not_added_names_it() -> None:
    with pytest.raises(ValueError, match="expected a frame that was added, got 4"):
        closer_over(world(), [np.eye(4)]).verify(4, 0)


def test_matches_are_mutual_and_distinct() -> None:
    a = np.array([[1, 0, 0], [0, 1, 0], [0.6, 0.8, 0]], np.float32)
    b = np.array([[0, 1, 0], [1, 0, 0], [0, 0.1, 0.995]], np.float32)
    assert mutual_matches(a, b, 0.8).tolist() == [[0, 1], [1, 0]]
    twins = np.array([[1, 0, 0], [1, 0, 0]], np.float32)
    assert mutual_matches(a, twins, 0.8).shape == (0, 2)


@dataclass
class Sift:
    """OpenCV's SIFT, as an extractor."""

    count: int = 1500

    def extract(self, image: np.ndarray, mask: np.ndarray | None = None) -> LocalFeatures:
        points, descriptors = cv2.SIFT_create(nfeatures=self.count).detectAndCompute(image, None)
        response = np.array([p.response for p in points], np.float32)
        order = np.argsort(-response, kind="stable")
        descriptors = descriptors[order] / np.linalg.norm(descriptors[order], axis=1, keepdims=True)
        pixels = np.array([p.pt for p in points], np.float32)[order]
        return LocalFeatures(pixels, np.ones(len(order), np.float32), response[order], descriptors)


def tracked_disparity(left: np.ndarray, right: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Follow pixels into the right image with Lucas and Kanade; a stand-in for the odometry's matcher."""
    start = pixels.astype(np.float32).reshape(-1, 1, 2)
    found, ok, _ = cv2.calcOpticalFlowPyrLK(left, right, start, None, winSize=(15, 15), maxLevel=5)
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(right, left, found, None, winSize=(15, 15), maxLevel=5)
    shift = (start - found)[:, 0]
    good = (ok & ok_back)[:, 0].astype(bool) & (np.abs(back - start)[:, 0].max(axis=1) < 0.5)
    good &= (shift[:, 0] > 1.0) & (np.abs(shift[:, 1]) < 2.0)
    return np.where(good, shift[:, 0], np.nan)


def test_real_images_three_frames_apart_agree_with_ground_truth(test_data: Path) -> None:
    folder = test_data / "kitti_clips" / "sequences" / "05"
    rows = np.loadtxt(test_data / "kitti_clips" / "poses" / "05.txt").reshape(-1, 3, 4)
    lines = (line.split() for line in (folder / "calib.txt").read_text().splitlines())
    P = {words[0]: np.array(words[1:], float).reshape(3, 4) for words in lines if words}
    K, baseline = P["P0:"], -P["P1:"][0, 3] / P["P1:"][0, 0]
    images = [
        [cv2.imread(str(folder / side / f"{k:06d}.png"), cv2.IMREAD_GRAYSCALE) for side in ("image_0", "image_1")]
        for k in (0, 3, 20, 23)
    ]
    height, width = images[0][0].shape
    camera = StereoCamera(K[0, 0], K[1, 1], K[0, 2], K[1, 2], baseline, width, height)
    closer = LoopCloser(camera, Depth(tracked_disparity))
    for k, (left, right) in zip((0, 3, 20, 23), images, strict=True):
        add_image(closer, Sift(), k, left, right)
    poses = [se3.pose(row[:, :3], row[:, 3]) for row in rows]
    for match, query in ((0, 3), (20, 23)):
        answer = closer.verify(query, match)
        assert isinstance(answer, LoopClosure)
        error = se3.log(se3.inverse(answer.T_match_query) @ se3.inverse(poses[match]) @ poses[query])
        assert np.abs(error[:3]).max() < 5e-3
        assert np.abs(error[3:]).max() < 0.1
        assert error @ np.linalg.solve(answer.covariance, error) < 30.0


@pytest.mark.parametrize("scale", [0.6, 1.0, 1.7])
def test_a_loop_of_one_camera_measures_the_relative_scale(scale: float) -> None:
    """The query's depths are in a unit of its own: the loop is in that of the match, with the ratio of the two."""
    scene = world()

    def depths_in_own_unit(left: np.ndarray, right: np.ndarray | None, pixels: np.ndarray) -> np.ndarray:
        return scene.disparity(left, left, pixels) * (scale if left[0, 0] == 1 else 1.0)

    closer = LoopCloser(CAMERA, Depth(depths_in_own_unit, has_metric_scale=False))
    for index, pose in enumerate([np.eye(4), MOTION]):
        add_image(closer, scene, index, scene.look(pose), None)
    loop = closer.verify(1, 0)
    assert isinstance(loop, LoopClosure)
    np.testing.assert_allclose(se3.log(se3.inverse(MOTION) @ loop.T_match_query), 0, atol=0.05)
    assert abs(loop.scale.log - np.log(scale)) < 4 * loop.scale.sigma
    assert loop.scale.sigma < 0.05


def test_no_scale_is_measured_between_different_places() -> None:
    rng = np.random.default_rng(4)
    one, other = (rng.uniform([-10, -4, 4], [10, 2, 40], (4, 3)) for _ in range(2))
    assert estimate_relative_scale(CAMERA, one, other, RelativePoseConfig()) == UNIT_SCALE


def test_depths_from_little_parallax_close_a_loop_of_one_camera_and_are_weighted_by_their_noise() -> None:
    """A scene two units deep, seen with a baseline of a few hundredths: disparities of 200 px that err by 20 px."""
    scene = world()
    scene.points /= 10.0
    step = se3.exp(np.array([0.02, -0.08, 0.01, 0.04, -0.01, 0.12]))

    def depths_from_motion(left: np.ndarray, right: np.ndarray | None, pixels: np.ndarray) -> np.ndarray:
        disparity = scene.disparity(left, left, pixels)
        return disparity * np.exp(scene.rng.normal(0, 0.1, len(disparity)))

    closer = LoopCloser(CAMERA, Depth(depths_from_motion, has_metric_scale=False))
    for index, pose in enumerate([np.eye(4), step]):
        add_image(closer, scene, index, scene.look(pose), None)
    loop = closer.verify(1, 0)
    assert isinstance(loop, LoopClosure)
    error = se3.log(se3.inverse(step) @ loop.T_match_query)
    assert np.abs(error).max() < 0.03
    assert error @ np.linalg.solve(loop.covariance, error) < 30.0
    as_a_pair = LoopCloser(CAMERA, Depth(depths_from_motion))
    for index in range(2):
        as_a_pair.add_frame(index, closer._landmarks[index])
    assert as_a_pair.verify(1, 0).inliers < 0.5 * loop.inliers
