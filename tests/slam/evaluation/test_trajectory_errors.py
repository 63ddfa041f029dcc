"""Trajectory errors agree with hand calculation, with evo and with a plain loop over the KITTI rule."""

import copy
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PosePath3D
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from slam.errors import DataError
from slam.evaluation.trajectory_errors import (
    SegmentRule,
    absolute_trajectory_error,
    end_error,
    kitti_errors,
    path_length,
    trajectory_errors,
    umeyama,
    unknown_errors,
)
from slam.io.trajectory_files import read_kitti

seeds = st.integers(0, 10_000)


def straight(count: int, step: float = 1.0) -> np.ndarray:
    """Poses (count, 4, 4) every `step` metres ahead."""
    poses = np.repeat(np.eye(4)[None], count, axis=0)
    poses[:, 2, 3] = step * np.arange(count)
    return poses


def walk(seed: int, count: int, step: float = 1.0) -> np.ndarray:
    """A winding drive (count, 4, 4) in space."""
    rng = np.random.default_rng(seed)
    poses = [np.eye(4)]
    for turn in rng.normal(scale=0.02, size=(count - 1, 3)):
        poses.append(poses[-1] @ se3.exp(np.concatenate([turn, [0.0, 0.0, step]])))
    return np.array(poses)


def noisy(poses: np.ndarray, seed: int, sigma: float = 1e-3) -> np.ndarray:
    """The same motions (N, 4, 4), each with an error, so that the trajectory drifts."""
    rng = np.random.default_rng(seed)
    motions = se3.inverse(poses[:-1]) @ poses[1:]
    drifted = [poses[0]]
    for motion, error in zip(motions, rng.normal(scale=sigma, size=(len(motions), 6)), strict=True):
        drifted.append(drifted[-1] @ motion @ se3.exp(error))
    return np.array(drifted)


def devkit(estimate: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """The KITTI rule, frame by frame: t_rel [%] and r_rel [deg / 100 m]."""
    distances = [0.0]
    for a, b in pairwise(truth):
        distances.append(distances[-1] + float(np.linalg.norm(b[:3, 3] - a[:3, 3])))
    translations, rotations = [], []
    for first in range(0, len(truth), 10):
        for length in range(100, 900, 100):
            last = next((k for k in range(first, len(truth)) if distances[k] > distances[first] + length), None)
            if last is None:
                continue
            true = np.linalg.inv(truth[first]) @ truth[last]
            error = np.linalg.inv(np.linalg.inv(estimate[first]) @ estimate[last]) @ true
            translations.append(np.linalg.norm(error[:3, 3]) / length)
            rotations.append(se3.angle(error) / length)
    return 100 * float(np.mean(translations)), 100 * float(np.degrees(np.mean(rotations)))


def evo_ate(estimate: np.ndarray, truth: np.ndarray, scale: bool) -> float:
    reference = PosePath3D(poses_se3=list(truth))
    aligned = copy.deepcopy(PosePath3D(poses_se3=list(estimate)))
    aligned.align(reference, correct_scale=scale)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, aligned))
    return float(ape.get_statistic(metrics.StatisticsType.rmse))


@settings(max_examples=25, deadline=None)
@given(seed=seeds, scale=st.floats(0.1, 10.0))
def test_alignment_finds_the_similarity_that_was_applied(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    points, T = rng.normal(size=(20, 3)), se3.exp(rng.normal(size=6))
    fit = umeyama(points, scale * points @ T[:3, :3].T + T[:3, 3], "sim3")
    np.testing.assert_allclose(fit.R, T[:3, :3], atol=1e-9)
    np.testing.assert_allclose(fit.t, T[:3, 3], atol=1e-9)
    assert fit.scale == pytest.approx(scale)


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_alignment_is_a_rotation_even_of_mirrored_points(seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(10, 3))
    fit = umeyama(points, points * [-1.0, 1.0, 1.0])
    assert np.linalg.det(fit.R) == pytest.approx(1.0)
    assert fit.scale == 1.0


@settings(max_examples=15, deadline=None)
@given(seed=seeds, alignment=st.sampled_from(["se3", "sim3"]))
def test_ate_is_that_of_evo(seed: int, alignment: str) -> None:
    truth = walk(seed, 100)
    estimate = se3.exp(np.array([0.3, 1.0, -0.2, 5.0, -3.0, 2.0])) @ noisy(truth, seed, 1e-2)
    expected = evo_ate(estimate, truth, scale=alignment == "sim3")
    assert absolute_trajectory_error(estimate, truth, alignment) == pytest.approx(expected, rel=1e-9)
    assert trajectory_errors(estimate, truth, alignment).ate_m == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_kitti_rule_agrees_with_a_plain_loop(seed: int) -> None:
    truth = walk(seed, 1000, step=1.1)
    estimate = noisy(truth, seed)
    found = kitti_errors(estimate, truth)
    expected = devkit(estimate, truth)
    assert (found.t_rel_percent, found.r_rel_deg_per_100m) == pytest.approx(expected, rel=1e-6)


def test_the_kitti_rule_agrees_on_a_real_drive(test_data: Path) -> None:
    truth = read_kitti(test_data / "kitti_poses" / "07.txt")
    estimate = noisy(truth, seed=0)
    found = kitti_errors(estimate, truth)
    # Ground truth of seven digits leaves rotations not quite orthonormal: the two kinds of inverse differ.
    assert (found.t_rel_percent, found.r_rel_deg_per_100m) == pytest.approx(devkit(estimate, truth), rel=1e-3)


def test_ate_of_a_real_drive_is_evos(test_data: Path) -> None:
    truth = read_kitti(test_data / "kitti_poses" / "07.txt")
    estimate = noisy(truth, seed=0)
    assert absolute_trajectory_error(estimate, truth) == pytest.approx(evo_ate(estimate, truth, False), rel=1e-9)


def test_a_perfect_trajectory_has_no_error() -> None:
    truth = walk(3, 400)
    errors = trajectory_errors(se3.exp(np.array([0.1, 2.0, 0.3, 1.0, 2.0, 3.0])) @ truth, truth)
    for value in (errors.ate_m, errors.t_rel_percent, errors.end_error_m, errors.end_error_percent):
        assert value == pytest.approx(0.0, abs=1e-9)
    assert errors.r_rel_deg_per_100m == pytest.approx(0.0, abs=1e-9)
    assert errors.reasons == {}


def test_one_per_cent_too_long_is_one_per_cent_t_rel() -> None:
    truth = straight(20_001, step=0.05)
    found = kitti_errors(1.01 * (truth - np.eye(4)) + np.eye(4), truth)
    assert found.t_rel_percent == pytest.approx(1.0, rel=1e-3)
    assert found.r_rel_deg_per_100m == pytest.approx(0.0, abs=1e-6)


def test_a_degree_too_much_every_hundred_metres_is_one() -> None:
    step = se3.exp(np.array([0.0, np.radians(0.01) / 2, 0.0, 0.0, 0.0, 0.5]))
    estimate = np.array([np.linalg.matrix_power(step, k) for k in range(400)])
    assert kitti_errors(estimate, straight(400, 0.5)).r_rel_deg_per_100m == pytest.approx(1.0, rel=1e-2)


def test_a_segment_needs_a_longer_path_than_its_length() -> None:
    assert kitti_errors(straight(101), straight(101)) is None
    assert kitti_errors(straight(102), straight(102)) is not None


def test_segments_of_a_tenth_measure_a_model_of_the_drive_alike() -> None:
    truth = walk(4, 600)
    estimate = noisy(truth, seed=4)
    whole, models = kitti_errors(estimate, truth), (estimate.copy(), truth.copy())
    for model in models:
        model[:, :3, 3] *= 0.1
    found = kitti_errors(*models, SegmentRule((10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0)))
    assert found.t_rel_percent == pytest.approx(whole.t_rel_percent, rel=1e-9)
    assert found.r_rel_deg_per_100m == pytest.approx(10 * whole.r_rel_deg_per_100m, rel=1e-9)
    every_frame = kitti_errors(estimate, truth, SegmentRule((100.0,), step_frames=1))
    assert every_frame.t_rel_percent != kitti_errors(estimate, truth, SegmentRule((100.0,))).t_rel_percent


def test_a_short_drive_says_why_it_has_no_t_rel() -> None:
    errors = trajectory_errors(straight(50), straight(50))
    assert (errors.t_rel_percent, errors.r_rel_deg_per_100m) == (None, None)
    assert errors.reasons["t_rel_percent"] == "the drive is 49.0 m long, segments need 100 m"


def test_end_error_compares_last_positions_from_equal_starts() -> None:
    estimate, truth = straight(11, 1.3), straight(11)
    turned = se3.exp(np.array([0.0, 1.0, 0.0, 9.0, 9.0, 9.0])) @ estimate
    assert end_error(turned, truth) == pytest.approx(3.0)
    errors = trajectory_errors(turned, truth)
    assert (errors.end_error_m, errors.end_error_percent) == (pytest.approx(3.0), pytest.approx(30.0))


def test_one_camera_is_evaluated_after_scaling() -> None:
    truth = walk(5, 300)
    estimate = truth.copy()
    estimate[:, :3, 3] *= 0.2
    errors = trajectory_errors(estimate, truth, "sim3")
    assert errors.ate_alignment == "sim3"
    assert (errors.ate_m, errors.t_rel_percent, errors.end_error_m) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_a_camera_that_stands_has_errors_but_no_percentage() -> None:
    errors = trajectory_errors(straight(5, 0.1), straight(5, 0.0))
    assert errors.end_error_m == pytest.approx(0.4)
    assert errors.end_error_percent is None
    assert "does not move" in errors.reasons["end_error_percent"]


@pytest.mark.parametrize("alignment", ["se3", "sim3"])
def test_a_single_pose_is_aligned_perfectly(alignment: str) -> None:
    assert absolute_trajectory_error(walk(0, 9)[8:], straight(1), alignment) == pytest.approx(0.0, abs=1e-12)


def test_the_path_length_is_the_sum_of_the_steps() -> None:
    assert path_length(straight(11, 0.5)) == pytest.approx(5.0)
    assert path_length(straight(1)) == 0.0


@pytest.mark.parametrize("function", [absolute_trajectory_error, trajectory_errors])
def test_trajectories_of_different_lengths_are_refused(function: object) -> None:
    with pytest.raises(DataError, match="each of 5 true ones, found 4; compare"):
        function(straight(4), straight(5))


def test_metrics_have_the_documented_names() -> None:
    names = [
        "ate_m",
        "ate_alignment",
        "t_rel_percent",
        "r_rel_deg_per_100m",
        "end_error_m",
        "end_error_percent",
    ]
    assert list(trajectory_errors(straight(3), straight(3)).as_metrics()) == names


def test_unknown_errors_all_have_the_reason() -> None:
    errors = unknown_errors("there is no ground truth")
    assert set(errors.as_metrics().values()) == {None}
    assert errors.reasons == dict.fromkeys(errors.as_metrics(), "there is no ground truth")


def moved(poses: np.ndarray, T: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """The same trajectory in another world frame and another unit."""
    out = T @ poses
    out[:, :3, 3] *= scale
    return out


@settings(max_examples=30, deadline=None)
@given(seed=seeds, scale=st.floats(0.1, 10.0))
def test_no_error_depends_on_the_world_frame_of_the_estimate(seed: int, scale: float) -> None:
    """Nor, with sim3, on its unit."""
    truth, T = walk(seed, 150), se3.exp(np.random.default_rng(seed).normal(size=6))
    estimate = walk(seed, 150) @ se3.exp(np.array([0.0, 0.01, 0.0, 0.1, 0.0, 0.0]))
    estimate[:, 0, 3] += np.linspace(0.0, 3.0, 150)
    for alignment, other in (("se3", moved(estimate, T)), ("sim3", moved(estimate, T, scale))):
        expected = trajectory_errors(estimate, truth, alignment).as_metrics()
        found = trajectory_errors(other, truth, alignment).as_metrics()
        assert found.pop("ate_alignment") == expected.pop("ate_alignment") == alignment
        assert found == pytest.approx(expected, rel=1e-5, abs=1e-7)


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_a_free_scale_never_makes_the_ate_larger(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = walk(seed, 60)
    estimate = moved(truth, np.eye(4), rng.uniform(0.5, 2.0))
    estimate[:, :3, 3] += rng.normal(size=(60, 3))
    rigid, similar = (absolute_trajectory_error(estimate, truth, alignment) for alignment in ("se3", "sim3"))
    assert similar <= rigid + 1e-9


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_no_small_motion_improves_the_alignment(seed: int) -> None:
    """The alignment is a minimum: finite steps in all six directions make the squared error larger."""
    rng = np.random.default_rng(seed)
    source, target = rng.normal(size=(2, 20, 3))
    fit = umeyama(source, target)
    aligned = fit.apply(source)
    best = ((aligned - target) ** 2).sum()
    for direction in np.concatenate([np.eye(6), -np.eye(6)]):
        other = se3.transform(se3.exp(1e-3 * direction), aligned)
        assert ((other - target) ** 2).sum() > best


@pytest.mark.parametrize("scale", [0.9, 0.97, 1.05])
def test_t_rel_of_a_straight_drive_is_its_error_of_scale(scale: float) -> None:
    truth = straight(900)
    errors = kitti_errors(moved(truth, np.eye(4), scale), truth)
    assert errors is not None
    # A segment ends at the first frame beyond its length, here one metre later.
    assert errors.t_rel_percent == pytest.approx(100.0 * abs(scale - 1.0), rel=0.011)
    assert errors.r_rel_deg_per_100m == pytest.approx(0.0, abs=1e-9)


def test_the_rotation_error_has_no_rounding_noise_at_small_angles() -> None:
    """Ground truth of seven digits, as KITTI's: arccos of the trace would give 0.06 degrees."""
    truth = walk(3, 300)
    rounded = truth.astype(np.float32).astype(np.float64)
    errors = kitti_errors(rounded, truth)
    assert errors is not None
    assert errors.r_rel_deg_per_100m < 1e-4


@given(seed=seeds, count=st.integers(2, 40))
def test_path_length_is_additive_and_has_the_unit_of_the_poses(seed: int, count: int) -> None:
    poses, cut = walk(seed, count + 1), count // 2
    assert path_length(poses) == pytest.approx(path_length(poses[: cut + 1]) + path_length(poses[cut:]))
    assert path_length(moved(poses, np.eye(4), 3.0)) == pytest.approx(3.0 * path_length(poses))
    assert path_length(poses) >= np.linalg.norm(poses[-1, :3, 3] - poses[0, :3, 3]) - 1e-9
