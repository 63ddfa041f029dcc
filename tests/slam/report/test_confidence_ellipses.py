"""Ellipses hold what they should, in the frame of the picture."""

from dataclasses import replace

import numpy as np
import pytest

from odometry import se3
from slam.evaluation.trajectory_errors import Similarity
from slam.report.interactive_map import draw_interactive_map
from slam.report.style import render_png
from slam.report.trajectory_figure import confidence_ellipses, draw_before_after

from . import fabricate

STILL = Similarity(np.eye(3), np.zeros(3), 1.0)


def covariances(count: int, variances: tuple[float, float, float] = (4.0, 1.0, 9.0)) -> np.ndarray:
    return np.tile(np.diag([1e-6, 1e-6, 1e-6, *variances]), (count, 1, 1))


def test_an_ellipse_holds_95_percent_of_positions() -> None:
    rng, T = np.random.default_rng(0), se3.exp(np.array([0.1, 0.7, -0.2, 5.0, 0.0, 3.0]))
    A = rng.normal(size=(6, 6))
    poses = np.array([np.eye(4), T])
    (outline,) = confidence_ellipses(poses, np.tile(A @ A.T * 1e-2, (2, 1, 1)), STILL)
    moves = rng.multivariate_normal(np.zeros(6), A @ A.T * 1e-2, 4000)[:, 3:]
    plan = (T[:3, 3] + moves @ T[:3, :3].T)[:, [0, 2]]
    centre = outline[:-1].mean(axis=0)
    shape = np.linalg.inv((outline[:-1] - centre).T @ (outline[:-1] - centre) * 2 / (len(outline) - 1))
    inside = np.einsum("ni,ij,nj->n", plan - centre, shape, plan - centre) <= 1.0
    assert inside.mean() == pytest.approx(0.95, abs=0.015)


def test_ellipses_turn_and_grow_with_the_alignment() -> None:
    poses = fabricate.circle(30)
    turned = Similarity(se3.exp(np.array([0, 0.5, 0, 0, 0, 0]))[:3, :3], np.array([3.0, 0.0, 1.0]), 2.0)
    plain, moved = (confidence_ellipses(poses, covariances(30), aligned) for aligned in (STILL, turned))
    points = np.insert(plain.reshape(-1, 2), 1, 0.0, axis=1)
    size = np.linalg.norm(moved - moved[:, :1], axis=2).max(axis=1)
    np.testing.assert_allclose(size, 2 * np.linalg.norm(plain - plain[:, :1], axis=2).max(axis=1), rtol=1e-2)
    np.testing.assert_allclose(
        moved[:, :-1].mean(axis=1),
        turned.apply(points)[:, [0, 2]].reshape(moved.shape)[:, :-1].mean(axis=1),
        atol=1e-9,
    )


@pytest.mark.parametrize("frames", [1, 2, 7, 200])
def test_every_drive_gets_some_and_not_too_many(frames: int) -> None:
    outlines = confidence_ellipses(fabricate.circle(frames), covariances(frames), STILL)
    assert 1 <= len(outlines) <= 24
    assert np.isfinite(outlines).all()


def test_the_maps_of_the_page_have_them_in_one_element_and_the_picture_has_none() -> None:
    whole = fabricate.record()
    sure = replace(whole, odometry_covariances=covariances(200), corrected_covariances=covariances(200, (0.1,) * 3))
    assert render_png(draw_before_after(sure)) == render_png(draw_before_after(whole))
    (ax,) = draw_interactive_map(sure, "odometry").axes
    (plain,) = draw_interactive_map(whole, "odometry").axes
    (ellipses,) = [lines for lines in ax.collections if lines.get_gid() == "inside-ellipses"]
    assert [len(path.vertices) for path in ellipses.get_paths()] == [48] * 24
    assert ax.get_xlim() == plain.get_xlim()
