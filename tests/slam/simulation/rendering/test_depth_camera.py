import numpy as np
import pytest

from slam.simulation.rendering.depth_camera import (
    BASELINE_M,
    DEPTH_SCALE,
    FOCAL_PX,
    MAX_DEPTH_M,
    MIN_DEPTH_M,
    SIGMA_PER_M2,
    encode_depth,
    measure_depth,
)
from slam.simulation.scenario.room_config import RoomConfig

CAMERA = RoomConfig(width=160, height=120).camera
SHAPE = (120, 160)
ALL = np.ones(SHAPE, bool)


def measure(depth, returns=ALL, seed=0):
    return measure_depth(np.asarray(depth, np.float32), returns, CAMERA, np.random.default_rng(seed))


@pytest.mark.parametrize("z", [0.8, 1.5, 3.0])
def test_noise_grows_with_the_square_of_the_distance(z: float):
    measured = measure(np.full(SHAPE, z))
    step = z * z / (BASELINE_M * FOCAL_PX) / 8  # metres for an eighth of a pixel of disparity
    expected = np.hypot(SIGMA_PER_M2 * z * z, step / np.sqrt(12))
    assert measured.std() == pytest.approx(expected, rel=0.08)
    assert measured.mean() == pytest.approx(z, abs=expected / 10)


def test_disparity_comes_in_eighths_of_a_pixel():
    steps = 8 * BASELINE_M * FOCAL_PX / measure(np.full(SHAPE, 2.0))
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)
    assert len(np.unique(np.rint(steps))) > 3


def test_what_is_too_near_or_too_far_has_no_depth():
    assert not measure(np.full(SHAPE, 0.95 * MIN_DEPTH_M)).any()
    assert not measure(np.full(SHAPE, 1.1 * MAX_DEPTH_M)).any()
    assert not measure(np.full(SHAPE, np.inf)).any()
    assert measure(np.full(SHAPE, 1.1 * MIN_DEPTH_M)).all()


def test_what_returns_no_infrared_light_has_no_depth():
    returns = ALL.copy()
    returns[40:60, 50:90] = False
    measured = measure(np.full(SHAPE, 2.0), returns)
    assert not measured[40:60, 50:90].any()
    assert measured[returns].all()


def test_the_shadow_of_a_near_thing_is_on_its_left():
    depth = np.full(SHAPE, 3.0)
    depth[:, 70:100] = 1.0
    holes = np.flatnonzero(measure(depth)[60] == 0)
    # The projector, 75 mm to the right, sees the near thing shifted by the difference of the disparities.
    shift = BASELINE_M * CAMERA.fx * (1 / 1.0 - 1 / 3.0)
    left, right = holes[holes < 85], holes[holes >= 85]
    assert len(left) == pytest.approx(shift, abs=2.5)
    assert left.max() in (69, 70)
    assert len(right) <= 2  # the edge alone


def test_surfaces_at_grazing_angles_have_no_depth():
    # A floor 0.4 m below a level camera: at z metres the ray meets it at an angle with the tangent 0.4 / z.
    camera = RoomConfig().camera
    row = np.arange(480) - camera.cy
    with np.errstate(divide="ignore"):
        depth = np.where(row > 0, 0.4 * camera.fy / row, np.inf)
    image = np.repeat(depth[:, None], 640, axis=1).astype(np.float32)
    measured = measure_depth(image, np.ones(image.shape, bool), camera, np.random.default_rng(0))[:, 320]
    farthest = depth[np.flatnonzero(measured).min()]
    assert 0.4 / np.hypot(0.4, farthest) == pytest.approx(0.17, abs=0.01)
    assert farthest < MAX_DEPTH_M


def test_depth_is_stored_in_5000ths_of_a_metre():
    stored = encode_depth(np.array([[1.0, 0.0, np.inf, 2.00009, 20.0]], np.float32))
    assert stored.dtype == np.uint16
    assert stored.tolist() == [[int(DEPTH_SCALE), 0, 0, 10000, 0]]
