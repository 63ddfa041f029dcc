"""Points of a window keep their places in space when they are scaled, selected and anchored anew."""

import numpy as np
import pytest

from odometry import se3
from odometry.camera import StereoCamera, clamp_inverse_depth
from odometry.distortion import LensDistortion
from odometry.inverse_depth_points import FrameObservations, ObservationTable, Points, clamp_points

CAMERA = StereoCamera(fx=350.0, fy=350.0, cx=255.5, cy=111.5, baseline=0.5, width=512, height=224)
LENS = LensDistortion(CAMERA, np.zeros(3), np.eye(3))


def points(*ids, depth=0.1):
    count = len(ids)
    pixels = np.stack([100.0 + 10 * np.arange(count), np.full(count, 80.0)], axis=1)
    return Points(np.array(ids), np.zeros(count, np.int64), pixels, np.full(count, depth), np.ones(count))


def frames(*ids):
    return [FrameObservations(np.array(each), np.stack([each, each], axis=1).astype(float)) for each in ids]


def test_observations_are_sorted_by_point_and_then_by_frame():
    table = ObservationTable.from_frames(frames([1, 4], [1, 2, 4], [2, 4]))
    np.testing.assert_array_equal(table.ids, [1, 2, 4])
    np.testing.assert_array_equal(table.counts, [2, 2, 3])
    np.testing.assert_array_equal(table.frame, [0, 1, 1, 2, 0, 1, 2])
    np.testing.assert_array_equal(table.anchor, [0, 1, 0])
    np.testing.assert_array_equal(table.is_followed(), [False, True, False, True, False, True, True])
    np.testing.assert_array_equal(table.pixels[:, 0], np.repeat(table.ids, table.counts))


def test_unknown_points_are_selected_without_information_and_with_the_median_depth():
    known = points(2, 5, 7, depth=0.25)
    selected = known.select(np.array([5, 6, 9]))
    np.testing.assert_array_equal(selected.ids, [5, 6, 9])
    np.testing.assert_array_equal(selected.information, [1, 0, 0])
    np.testing.assert_allclose(selected.inverse_depth, 0.25)
    np.testing.assert_allclose(selected.anchor_pixel[0], known.anchor_pixel[1])


def test_without_any_point_the_median_depth_is_fifteen():
    empty = Points.empty()
    assert len(empty) == 0
    assert 1.0 / empty.median_inverse_depth == pytest.approx(15.0)
    assert 1.0 / empty.select(np.array([3])).inverse_depth[0] == pytest.approx(15.0)


def test_points_are_merged_in_order_and_the_later_ones_win():
    both = points(1, 2, 7).merge(points(2, 5, depth=0.5))
    np.testing.assert_array_equal(both.ids, [1, 2, 5, 7])
    np.testing.assert_allclose(both.inverse_depth, [0.1, 0.5, 0.5, 0.1])


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_scaling_there_and_back_changes_nothing(factor):
    before = points(1, 2, 3)
    larger = before.rescale(factor)
    np.testing.assert_allclose(1.0 / larger.inverse_depth, factor / before.inverse_depth)
    again = larger.rescale(1.0 / factor)
    np.testing.assert_allclose(again.inverse_depth, before.inverse_depth)
    np.testing.assert_allclose(again.information, before.information)


def test_a_new_anchor_leaves_the_point_where_it_is():
    poses = np.stack([np.eye(4), se3.exp(np.array([0.0, 0.03, 0.0, 0.1, 0.0, 1.0]))])
    old = points(1, 2, 3)
    moved = old.reanchor(ObservationTable.from_frames(frames([1, 2, 3])), poses, LENS)
    in_map = [
        se3.transform(T, LENS.rays(each.anchor_pixel) / each.inverse_depth[:, None])
        for T, each in ((poses[0], old), (poses[1], moved))
    ]
    np.testing.assert_allclose(in_map[1], in_map[0], atol=1e-9)
    np.testing.assert_array_equal(moved.frame, 0)


def test_inverse_depths_are_clamped_to_what_a_camera_can_see():
    clamped = clamp_inverse_depth(np.array([-1.0, 0.0, 0.1, 100.0]))
    assert (clamped > 0).all()
    assert clamped[2] == 0.1
    assert clamped[3] == pytest.approx(1.0 / 0.3)
    state = np.array([[3.0, -4.0, -1.0]])
    np.testing.assert_allclose(clamp_points(state)[0, :2], [3.0, -4.0])
    assert clamp_points(state)[0, 2] > 0
