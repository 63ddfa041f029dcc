"""Add an odometry of your own: a class with `track`, `disparity` and a few properties, and nothing to inherit from.

    python examples/own_odometry.py [--out runs/examples]

It measures each motion by optical flow and PnP on the stereo depth of the frame before. The chain around it is that of
every run: landmarks, place recognition, loops, pose graph. Prints the error of its trajectory before and after.
"""

from dataclasses import replace

import cv2
import numpy as np
from street import arguments, street

from odometry.motion import Motion
from odometry.stereo.stereo_matching import match_disparity
from slam.components import build_components
from slam.config import RunConfig
from slam.datasets.formats.registry import open_dataset
from slam.evaluation.trajectory_errors import trajectory_errors
from slam.loop_closing.loop_closer import LoopCloser
from slam.system import Slam


class FlowAndPnp:
    """Tracks corners from frame to frame and solves PnP on their stereo depth (a VisualOdometry)."""

    has_metric_scale = True  # a pair measures metres; False for one camera
    calibration = None  # it learns no calibration error

    def __init__(self, camera):
        """Make an odometry that has seen nothing."""
        self._camera, self._before = camera, None

    def track(self, frame):
        """Return the motion since the previous frame; always finite, and flagged where it is a guess."""
        before, self._before = self._before, (frame.left.copy(), frame.right.copy())
        T = np.eye(4) if before is None else self._measure(before, frame.left)
        covariance = np.diag(np.repeat([2e-3, 3e-2], 3) ** 2)  # of the right perturbation, rotation first (rad, m)
        if T is None:
            return Motion(np.eye(4), 100.0 * covariance, True, "too few corners agree on one motion")
        return Motion(T, covariance, False, "")

    def _measure(self, before, left):
        corners = cv2.goodFeaturesToTrack(before[0], 800, 0.01, 10)
        found, status, _ = cv2.calcOpticalFlowPyrLK(before[0], left, corners, None)
        pixels = corners.reshape(-1, 2).astype(np.float64)
        points = self._camera.triangulate(pixels, match_disparity(*before, pixels))
        good = (status.ravel() == 1) & np.isfinite(points).all(axis=1)
        camera, K = self._camera, np.eye(3)
        K[0], K[1] = (camera.fx, 0.0, camera.cx), (0.0, camera.fy, camera.cy)
        solved, r, t, inliers = cv2.solvePnPRansac(points[good], found.reshape(-1, 2)[good], K, None)
        if not solved or inliers is None or len(inliers) < 30:
            return None
        T_current_previous = np.eye(4)
        T_current_previous[:3, :3], T_current_previous[:3, 3] = cv2.Rodrigues(r)[0], t.ravel()
        return np.linalg.inv(T_current_previous)

    def disparity(self, left, right, pixels):
        """Return the disparity (N,) at pixels (N, 2) of the frame tracked last, for the landmarks; NaN if unknown."""
        return match_disparity(left, right, pixels)

    def array_bytes(self):
        """Return the memory of all arrays held, bytes."""
        return 0 if self._before is None else sum(image.nbytes for image in self._before)

    # `state` and `restore`, for checkpoints, are needed where runs are resumed: see slam/system.py.


given = arguments(__doc__).parse_args()
drive, config = open_dataset(street(given)), RunConfig()
components = build_components(drive.camera, config)
own = FlowAndPnp(drive.camera)
closer = LoopCloser(drive.camera, own, config.loop_closing)
slam = Slam(replace(components, odometry=own, loop_closer=closer))
results = [slam.process(frame) for frame in drive]
_, optimized = slam.finish(config.robust)
before = trajectory_errors(np.array([result.T_world_camera_odometry for result in results]), drive.ground_truth)
after = trajectory_errors(optimized.poses, drive.ground_truth)
print(f"odometry ATE {before.ate_m:.2f} m, corrected ATE {after.ate_m:.2f} m, {optimized.kept.sum()} loops")
