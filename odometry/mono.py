"""Monocular visual odometry."""
from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.bundle import Bundle, BundleConfig, Placed, Seen, triangulate
from odometry.camera import PinholeCamera
from odometry.lens import Lens, LensConfig
from odometry.motion import Motion
from odometry.ticks import Ticks
from odometry.tracking import TrackingConfig, detect, follow, inside

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class MonoOdometryConfig:
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    bundle: BundleConfig = field(default_factory=BundleConfig)
    lens: LensConfig = field(default_factory=LensConfig)
    key_px: float = 4.0
    key_share: float = 0.8
    parallax: float = 0.02  # rad
    persistence: float = 9.0


class MonoOdometry:
    def __init__(self, camera: PinholeCamera, config: MonoOdometryConfig | None = None) -> None:
        self._camera, self._config = camera, config or MonoOdometryConfig()
        self.bundle = Bundle(Lens.unknown(camera, self._config.lens), self._config.bundle, self._config.lens)
        self._image: Image | None = None
        self._ids, self._pixels = np.zeros(0, np.int64), np.zeros((0, 2))
        self._key_pixels = np.zeros((0, 2))  # where the tracks were in the last key frame
        self._named = 0
        self._T = np.eye(4)  # T_window_previous
        self._velocity = np.zeros(6)
        self._first: Seen | None = None

    def track(self, image: Image, timestamp: float | None = None) -> Motion:
        if self._image is None:
            self._image = image.copy()
            self._detect(image)
            self._first = Seen(self._ids, self._pixels)
            return Motion(np.eye(4), 1e-12 * np.eye(6), False, "")
        if not len(self.bundle):
            motion = self._begin(image)
        else:
            motion = self._go_on(image)
        self._image = image.copy()
        return motion

    def _detect(self, image: Image) -> None:
        corners = detect(image, self._pixels, self._config.tracking)
        names = self._named + np.arange(len(corners))
        self._named += len(corners)
        self._ids = np.concatenate([self._ids, names])
        self._pixels = np.concatenate([self._pixels, corners])

    def _begin(self, image: Image) -> Motion:
        config = self._config
        found = follow((self._image, image), self._pixels, self._pixels, config.tracking.wider())
        kept = np.isfinite(found[:, 0])
        self._ids, self._pixels = self._ids[kept], found[kept]
        at = np.searchsorted(self._first.ids, self._ids)
        before = self._first.pixels[at]
        lens = self.bundle.lens
        a, b = lens.rays(before)[:, :2], lens.rays(self._pixels)[:, :2]
        f = self._camera.fx
        E, mask = cv2.findEssentialMat(a * f, b * f, np.diag([f, f, 1.0]), method=cv2.USAC_MAGSAC, prob=0.9999, threshold=0.7, maxIters=2000)
        n, R, t, good, _ = cv2.recoverPose(E, a * f, b * f, np.diag([f, f, 1.0]), distanceThresh=1e3, mask=mask)
        T_first_second = se3.inverse(se3.pose(R, t.ravel()))
        d, strength = triangulate(lens.rays(before), lens.rays(self._pixels), se3.inverse(T_first_second))
        ok = good.ravel() > 0
        unit = 15 * np.median(d[ok])
        T_first_second[:3, 3] *= unit
        seen = Seen(self._ids, self._pixels)
        agree = self.bundle.begin([Seen(self._ids, before), seen], T_first_second)
        p = self.bundle.points
        self.bundle.rescale(15 * np.median(p.depth[p.trust > 0]))
        self._ids, self._pixels = self._ids[agree], self._pixels[agree]
        self._T = self.bundle.poses[-1]
        self._velocity = se3.log(self._T)
        self._key(image)
        return Motion(self._T, np.eye(6) * 1e-4, False, "")

    def _key(self, image: Image) -> None:
        self._detect(image)
        self._key_pixels = self._pixels
        # the new corners join the last frame
        self.bundle._frames[-1] = Seen(self._ids, self._pixels)
        p = self.bundle.points
        at, known = p.find(self._ids)
        usual = float(np.median(p.depth[p.trust > 0]))
        new = ~known
        from odometry.bundle import Points
        k = len(self.bundle) - 1
        self.bundle.points = Points(
            np.concatenate([p.ids, self._ids[new]]), np.concatenate([p.frame, np.full(new.sum(), k)]),
            np.concatenate([p.place, self._pixels[new]]), np.concatenate([p.depth, np.full(new.sum(), usual)]),
            np.concatenate([p.trust, np.zeros(new.sum())]))

    def _go_on(self, image: Image) -> Motion:
        config, bundle = self._config, self.bundle
        guess = self._T @ se3.exp(self._velocity)
        points, trust = bundle.in_frame(self._ids, guess)
        ahead = bundle.lens.pixels(points[:, :3])
        visible = np.isfinite(ahead[:, 0]) & inside(ahead, image)
        ahead = np.where(visible[:, None], ahead, self._pixels)
        found = follow((self._image, image), self._pixels, ahead, config.tracking)
        kept = np.isfinite(found[:, 0])
        ids, pixels, keys, before = self._ids[kept], found[kept], self._key_pixels[kept], self._pixels[kept]
        placed = bundle.locate(ids, pixels, guess)
        good = placed.inliers
        self.placed = placed
        T_before = self._T
        self._ids, self._pixels, self._key_pixels = ids[good], pixels[good], keys[good]
        self._T = placed.T_window_frame
        flow = float(np.median(np.linalg.norm(self._pixels - self._key_pixels, axis=1)))
        if flow > config.key_px or good.sum() < config.key_share * len(self._key_pixels):
            full = len(bundle) >= config.bundle.frames
            agree = bundle.add(Seen(self._ids, self._pixels), self._T)
            if full:
                T_before = bundle._shifted @ T_before
            self._ids, self._pixels = self._ids[agree], self._pixels[agree]
            self._T = bundle.poses[-1]
            self._key(image)
        T = se3.inverse(T_before) @ self._T
        self._velocity = se3.log(T)
        return Motion(T, config.persistence * placed.covariance, False, "", before, pixels, good, placed.residual_px)
