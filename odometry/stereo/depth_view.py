"""A depth image as the second view of a stereo pair: disparities are read, not matched.

The noise of a depth that is triangulated, by structured light or by a pair inside the camera, grows with the square of
the depth: it is a constant noise of the disparity that a pair with the camera's nominal baseline would show
(Khoshelham and Elberink, Accuracy and Resolution of Kinect Depth Data, Sensors 2012). So a depth z is the disparity
f b / z, and everything that a stereo odometry knows about its pair holds for it. Inverse depth, and so disparity, of a
plane is linear in the pixel: a line through a small window reads it between the pixels and averages its noise.
docs/decisions/depth_cameras.md has the figures.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from odometry.stereo.second_view import Pair, SecondViewNoise

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Depths = NDArray[np.float32]
Mask = NDArray[np.bool_]

_FOCAL_LENGTH_PX = 525.0  # of the colour image of common depth cameras, 640 pixels wide


@dataclass(frozen=True)
class DepthViewConfig:
    """Reading of disparities in a depth image.

    The noise of a depth is one in metres, so that of its disparity grows with the resolution of the image: both numbers
    are those of a focal length of 525 pixels.

    Attributes:
        radius_px: of the square window, pixels.
        min_known_share: smallest share of the window's pixels whose depth is known.
        max_residual_px: largest root mean square distance of the window's disparities from a plane, pixels; larger
            ones are edges between surfaces, where the nearest depth is that of one or of the other.
        disparity_weight: noise of a track in the colour image over that of a disparity that was read.
    """

    radius_px: int = 2
    min_known_share: float = 0.6
    max_residual_px: float = 0.7
    disparity_weight: float = 10.0


class DepthView:
    """The depth image of a depth camera, registered to the left image (a SecondView)."""

    def __init__(self, camera: StereoCamera, config: DepthViewConfig | None = None) -> None:
        self._camera, self._config = camera, config or DepthViewConfig()
        self._resolution = camera.fx / _FOCAL_LENGTH_PX
        self.noise = SecondViewNoise(1, self._config.disparity_weight / self._resolution)

    def check(self, left: Image, second: NDArray[Any], shape: tuple[int, int]) -> None:
        """Check that the left image is (H, W) uint8 and the depth image (H, W) float32."""
        for name, image, kind in (("left", left, np.uint8), ("depth", second, np.float32)):
            if image.shape != shape or image.dtype != kind:
                raise ValueError(
                    f"expected the {name} image to be {shape} {np.dtype(kind).name} as the camera says, "
                    f"got {image.shape} {image.dtype}"
                )

    def prepare(self, left: Image, second: NDArray[Any]) -> NDArray[Any]:
        """Return the depth image as it is."""
        return second

    def find(self, pair: Pair, pixels: Array) -> Array:
        """Places (N, 2) in the right image of the pair that the camera stands for; NaN where there is no depth."""
        disparity = self.read(pair[1], pixels)
        return np.where(
            np.isfinite(disparity)[:, None], np.column_stack([pixels[:, 0] - disparity, pixels[:, 1]]), np.nan
        )

    def follow(self, pair: Pair, pixels: Array, guess: Array) -> Array:
        """Return the same as `find`: nothing is searched."""
        return self.find(pair, pixels)

    def are_usable(self, places: Array) -> Mask:
        """All points: one without a depth still measures rotation."""
        return np.ones(len(places), dtype=bool)

    def is_swapped(self, pair: Pair, detect: Callable[[Image], Array]) -> bool:
        """Never: a depth image is no image."""
        return False

    def read(self, depth: Depths, pixels: Array) -> Array:
        """Disparity (N,), pixels, at pixels (N, 2) of a depth image (H, W), metres; NaN at holes and edges."""
        config = self._config
        count = int(np.ceil(config.min_known_share * (2 * config.radius_px + 1) ** 2))
        scale = self._camera.fx * self._camera.baseline
        max_residual_px = config.max_residual_px * self._resolution
        pixels = np.asarray(pixels, dtype=np.float64)
        return np.asarray(_read(depth, pixels, scale, config.radius_px, count, max_residual_px))


@njit(cache=True)
def _read(depth: Depths, pixels: Array, scale: float, radius: int, min_count: int, max_residual: float) -> Array:
    """Disparity (N,) of the plane through the disparities around each pixel (N, 2); NaN where there is none."""
    disparity = np.full(len(pixels), np.nan)
    height, width = depth.shape
    for i in range(len(pixels)):
        if not (np.isfinite(pixels[i, 0]) and np.isfinite(pixels[i, 1])):
            continue
        column, row = round(pixels[i, 0]), round(pixels[i, 1])
        # Sums over the window, with the offsets from the pixel as the columns of the plane's equations.
        n, sx, sy, sxx, sxy, syy, sd, sxd, syd, sdd = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for v in range(max(row - radius, 0), min(row + radius + 1, height)):
            for u in range(max(column - radius, 0), min(column + radius + 1, width)):
                z = depth[v, u]
                if z > 0.0 and np.isfinite(z):
                    x, y, d = u - pixels[i, 0], v - pixels[i, 1], scale / z
                    n += 1
                    sx, sy, sd = sx + x, sy + y, sd + d
                    sxx, sxy, syy = sxx + x * x, sxy + x * y, syy + y * y
                    sxd, syd, sdd = sxd + x * d, syd + y * d, sdd + d * d
        if n < min_count:
            continue
        mx, my, md = sx / n, sy / n, sd / n
        cxx, cxy, cyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
        cxd, cyd = sxd / n - mx * md, syd / n - my * md
        determinant = cxx * cyy - cxy * cxy
        if determinant <= 1e-6:  # all pixels on one line
            continue
        ax, ay = (cyy * cxd - cxy * cyd) / determinant, (cxx * cyd - cxy * cxd) / determinant
        variance = sdd / n - md * md - ax * cxd - ay * cyd
        value = md - ax * mx - ay * my
        if variance <= max_residual * max_residual and value > 0.0:
            disparity[i] = value
    return disparity
