"""Any camera at any rate: one camera and a depth camera on the same walk, from 160 x 120 to 4K, wide angle and tele.

A camera goes ahead, is covered, turns on the spot and goes on. Whatever the camera, there is one finite motion for each
image, and what was not measured is said.
"""

import cv2
import numpy as np
import pytest

from odometry import MonoOdometry, se3
from odometry.camera import StereoCamera
from odometry.stereo.rgbd_odometry import RgbdOdometry

SPEED = np.array([0.02, 0.04, -0.01, 0.3, -0.1, 4.0])  # of the walk ahead, a second
TURN = np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])


def make_camera(width, height, fx):
    return StereoCamera(fx, fx, (width - 1) / 2, (height - 1) / 2, 0.5, width, height)


class Enlarged:
    """A camera of many pixels, whose images are those of a smaller one, enlarged: four times as fast."""

    def __init__(self, world, factor):
        self._world, small = world, world.camera
        self._size = factor * small.width, factor * small.height
        self.camera = make_camera(*self._size, factor * small.fx)

    def frame(self, T, seed):
        image, depth = self._world.frame(T, seed=seed)
        return (
            cv2.resize(image, self._size, interpolation=cv2.INTER_CUBIC),
            cv2.resize(depth, self._size, interpolation=cv2.INTER_NEAREST),
        )


# Width, height and focal length in pixels, enlargement, images per second, and the share that must be measured of the
# images that are not covered. At 5 Hz the camera goes 0.8 m from one image to the next.
CAMERAS = {
    "160 x 120": (160, 120, 110.0, 1, 10.0, 0.7),
    "4K": (960, 540, 700.0, 4, 10.0, 0.7),
    "5 Hz": (512, 224, 350.0, 1, 5.0, 0.5),
    "60 Hz": (256, 192, 175.0, 1, 60.0, 0.5),
    "wide angle, 127 degrees": (512, 256, 128.0, 1, 10.0, 0.7),
    "tele, 15 degrees": (512, 256, 2000.0, 1, 10.0, 0.5),
}


def walk(rate_hz):
    """Poses (N, 4, 4): ahead for 0.75 s and eight images at least, a turn, and on."""
    count = max(8, round(0.75 * rate_hz))
    poses = [np.eye(4)]
    for step in [SPEED] * count + [TURN] * 5 + [SPEED] * 5:
        poses.append(poses[-1] @ se3.exp(step / rate_hz))
    return np.array(poses)


@pytest.mark.parametrize("sensor", ["mono", "depth"])
@pytest.mark.parametrize("name", CAMERAS)
def test_there_is_a_motion_for_each_image_and_what_was_not_measured_is_said(world, name, sensor):
    width, height, fx, factor, rate_hz, share = CAMERAS[name]
    seen = type(world)(make_camera(width, height, fx), seed=3)
    scene = seen if factor == 1 else Enlarged(seen, factor)
    poses = walk(rate_hz)
    frames = [scene.frame(T, seed=k) for k, T in enumerate(poses)]
    covered = (len(frames) // 2, len(frames) // 2 + 1)
    for k in covered:
        frames[k] = np.zeros_like(frames[k][0]), np.full_like(frames[k][1], np.nan)
    odometry = MonoOdometry(scene.camera) if sensor == "mono" else RgbdOdometry(scene.camera)
    motions = []
    for k, (image, depth) in enumerate(frames):
        given = (image,) if sensor == "mono" else (image, depth)
        motions.append(odometry.track(*given, timestamp=k / rate_hz))
    for motion in motions:
        assert np.isfinite(motion.T_previous_current).all()
        assert np.linalg.eigvalsh(motion.covariance).min() > 0
        assert motion.predicted == bool(motion.reason)
    assert all(motions[k].predicted for k in covered)
    measured = [not m.predicted for k, m in enumerate(motions) if k not in covered]
    assert np.mean(measured) >= share
    errors = [
        se3.angle(se3.inverse(m.T_previous_current) @ se3.inverse(before) @ now)
        for m, before, now in zip(motions[1:], poses[:-1], poses[1:], strict=True)
        if not m.predicted
    ]
    assert np.median(errors) < 2e-3
