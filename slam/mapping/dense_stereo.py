"""Dense depth of a stereo pair by semi-global matching, on images rectified with the estimated calibration.

Hirschmüller, Stereo Processing by Semiglobal Matching and Mutual Information, PAMI 2008. A depth has to pass three
checks: uniqueness on its row, consistency from right to left, and a minimum size of its patch of similar depth. There
is no check for texture (docs/decisions/dense_map.md).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from odometry.klt_tracking import level_pair
from odometry.stereo.stereo_self_calibration import Calibration
from slam.datasets.dataset import Frame

Image = NDArray[np.uint8]
Depths = NDArray[np.float32]

_MATCHING_WIDTH_PX = 620  # about: at twice that width matching takes six times as long and gains 0.02 m at 25 m
_NUM_DISPARITIES = 64  # searched at that width: from 3 m on with KITTI's pair
_BLOCK_SIZE_PX = 3
# Penalties of a disparity step of one pixel and of a larger one, as OpenCV recommends them for one channel.
_P1, _P2 = 8 * _BLOCK_SIZE_PX**2, 32 * _BLOCK_SIZE_PX**2
_UNIQUENESS_PERCENT = 10  # by which the best match must be better than any other
_MIN_SPECKLE_PX = 100  # size of a patch of similar depth
_DISPARITY_SCALE = 16.0  # OpenCV's disparities are in sixteenths of a pixel


@dataclass(frozen=True)
class DepthImage:
    """Depth and colour of one frame.

    Attributes:
        depth: depth along the axis of the left camera, (H, W), metres; 0 where unknown.
        color: rectified left image, (H, W, 3) uint8, red first; three equal values where it is grey.
        camera: ideal rectified camera of this image size.
    """

    depth: Depths
    color: Image
    camera: StereoCamera


class DenseStereo:
    """Computes dense depth with one camera pair, whose calibration error is corrected (a DenseDepth)."""

    def __init__(self, calibration: Calibration, max_depth_m: float) -> None:
        self._max_depth = max_depth_m
        self._scale = max(1, round(calibration.camera.width / _MATCHING_WIDTH_PX))
        self.camera = downscale_camera(calibration.camera, self._scale)
        self._left, self._right = self._rectification_maps(calibration)
        self._matcher = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=_NUM_DISPARITIES,
            blockSize=_BLOCK_SIZE_PX,
            P1=_P1,
            P2=_P2,
            disp12MaxDiff=1,
            preFilterCap=31,
            uniquenessRatio=_UNIQUENESS_PERCENT,
            speckleWindowSize=_MIN_SPECKLE_PX,
            speckleRange=1,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )

    def depth_of(self, frame: Frame) -> DepthImage:
        """Return the depth of a frame, which has a right image."""
        assert frame.right is not None
        return self.compute_depth(frame.left, frame.right, frame.color)

    def compute_depth(self, left: Image, right: Image, color: Image | None = None) -> DepthImage:
        """Return the depth of a pair of images, (H, W) uint8, of the calibrated size; the left one also in colour."""
        picture = None if color is None else self._rectify(color, self._left)
        left, right = self._rectify(left, self._left), self._rectify(level_pair(left, right), self._right)
        disparity = self._matcher.compute(left, right).astype(np.float32) / np.float32(_DISPARITY_SCALE)
        min_disparity = self.camera.fx * self.camera.baseline / self._max_depth
        known = (disparity >= min_disparity) & self._inside
        depth = np.zeros_like(disparity)
        np.divide(np.float32(self.camera.fx * self.camera.baseline), disparity, out=depth, where=known)
        return DepthImage(depth, as_color(left) if picture is None else picture, self.camera)

    def _rectification_maps(self, calibration: Calibration) -> tuple[Depths, Depths]:
        """Return the pixels (H, W, 2) of the downscaled left and right images that each rectified pixel comes from."""
        height, width, s = self.camera.height, self.camera.width, self._scale
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=2).reshape(-1, 2)
        centre = (s - 1) / 2  # of the first s by s pixels
        seen = calibration.unrectify(np.asarray(s * pixels + centre, dtype=np.float64))
        left, right = (((side - centre) / s).reshape(height, width, 2) for side in seen)
        low, high = np.zeros(2), np.array([width - 1, height - 1])
        self._inside = ((left >= low) & (left <= high) & (right[..., 1:] >= 0) & (right[..., 1:] <= height - 1)).all(2)
        return left.astype(np.float32), right.astype(np.float32)

    def _rectify(self, image: Image, sources: Depths) -> Image:
        size, s = (self.camera.width, self.camera.height), self._scale
        small = cv2.resize(image[: s * size[1], : s * size[0]], size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.remap(small, sources, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def as_color(grey: Image) -> Image:
    """A grey image (H, W) with three equal channels (H, W, 3)."""
    return np.repeat(grey[:, :, None], 3, axis=2)


def downscale_camera(camera: StereoCamera, s: int) -> StereoCamera:
    """Return the camera of an image whose pixels are means of s by s pixels of the original."""
    centre = (s - 1) / 2
    cx, cy = (camera.cx - centre) / s, (camera.cy - centre) / s
    return StereoCamera(camera.fx / s, camera.fy / s, cx, cy, camera.baseline, camera.width // s, camera.height // s)
