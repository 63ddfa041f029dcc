"""Map of one camera: the reference frames, their landmarks, and the unit of length."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry.camera import PinholeCamera
from odometry.distortion import LensDistortion
from odometry.inverse_depth_points import FrameObservations
from odometry.mono.ground_plane_scale import GroundPlaneScale, NullScaleCorrection, ScaleCorrection
from odometry.mono.local_map import LocalMap, MapFrame
from odometry.mono.mono_bundle_adjustment import MonoBundle
from odometry.mono.mono_config import MonoOdometryConfig
from odometry.mono.mono_frontend import MonoFrontEnd, MonoTracks
from odometry.mono.mono_tracking import PosedTracks
from odometry.mono.motion_stereo import PosedImage

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_FEW_KNOWN = 0.2  # share of all tracks with known depth, below which landmarks of the bundle are looked for again
# Parallax between two frames of a full bundle, in those at which an image becomes a reference frame, from which on both
# stay. In a turn each image becomes one, and twelve of them have no baseline that could hold depths and rotation.
_MIN_SPACING = 3.0
_MAX_DEPTH_CHANGE = 5.0  # of the median depth from one map to the next: units cannot run to zero or infinity


class MonoMap:
    """The bundle of the last reference frames, their images, and the local map of earlier ones.

    Attributes:
        bundle: frames, points and lens.
    """

    def __init__(self, camera: PinholeCamera, config: MonoOdometryConfig, front_end: MonoFrontEnd) -> None:
        self._camera, self._config, self._front_end = camera, config, front_end
        self.bundle = MonoBundle(LensDistortion.unknown(camera, config.lens), config.bundle, config.lens)
        self._local_map = LocalMap(config.tracking)
        self._images: list[Image] = []  # of the bundle's frames
        self._scale_correction: ScaleCorrection = (
            GroundPlaneScale(config.camera_height_m, config.ground_plane)
            if config.camera_height_m
            else NullScaleCorrection()
        )

    @property
    def median_depth(self) -> float:
        """Median depth of the points, in the map's unit."""
        return 1.0 / self.bundle.points.median_inverse_depth

    def posed_images(self) -> list[PosedImage]:
        """Images of the bundle with their poses, oldest first."""
        return [PosedImage(*shot) for shot in zip(self._images, self.bundle.poses, strict=True)]

    def begin(self, tracks: MonoTracks, T_first_second: Array, distance: float | None) -> MonoTracks:
        """Begin a new map with two images; return the second one's points, outliers left out and new ones added.

        Args:
            tracks: points of the second image, with their pixels in the first as reference.
            T_first_second: (4, 4), in units of the distance between the two.
            distance: distance between the two in the unit of the map before; None if the median depth is to stay.
        """
        before = self.bundle.points.median_inverse_depth
        agree = self.bundle.initialize(
            FrameObservations(tracks.ids, tracks.reference_pixels),
            FrameObservations(tracks.ids, tracks.pixels),
            T_first_second,
        )
        self._images = [tracks.reference_image, tracks.image]
        self._local_map.forget()
        by_depth = self.bundle.points.median_inverse_depth / before
        by_distance = by_depth if distance is None else distance / self._initial_distance()
        self.bundle.rescale(float(np.clip(by_distance, by_depth / _MAX_DEPTH_CHANGE, by_depth * _MAX_DEPTH_CHANGE)))
        self.bundle.rescale(self._scale_correction.update(self.bundle.visible()))
        return self._renew(tracks.select(agree))

    def _initial_distance(self) -> float:
        """Distance between the first two frames of a map, in its unit."""
        return max(float(np.linalg.norm(self.bundle.poses[1, :3, 3] - self.bundle.poses[0, :3, 3])), 1e-9)

    def recognize(self, image: Image) -> tuple[PosedTracks, Array] | None:
        """Find the view that an image shows: its points, which the bundle takes over, and T_view_camera (4, 4)."""
        found = self._local_map.recognize(image, self.bundle.lens, self._views())
        if found is None:
            return None
        frame, T = found
        if frame.number not in self.bundle.numbers:
            if self.bundle.is_full:
                self._archive(0)
            self.bundle.revisit(frame)
            self._images.insert(0, frame.image)
        # More points than are there: what is seen from here is a reference frame at once.
        tracks = MonoTracks(frame.image, frame.ids, frame.pixels, frame.pixels, frame.image, 10 * len(frame.ids))
        return PosedTracks(tracks, frame.T_map_camera), T

    def is_far_from_reference(self, tracks: MonoTracks, T_map_camera: Array) -> bool:
        """Whether an image at (4, 4) has enough parallax to the last reference frame, or shows too little of it."""
        if len(tracks) < self._config.min_tracked_ratio * tracks.reference_count:
            return True
        lens, R = self.bundle.lens, T_map_camera[:3, :3].T @ self.bundle.poses[-1][:3, :3]
        turned = lens.pixels(lens.rays(tracks.reference_pixels) @ R.T)
        parallax = tracks.pixels - turned  # what turning does not explain
        return float(np.nanmedian(np.linalg.norm(parallax, axis=1))) > self._config.reference_parallax_px

    def add(self, tracks: MonoTracks, T_map_camera: Array, adjust: bool) -> MonoTracks:
        """Add an image at (4, 4) to the bundle, with landmarks of the local map and new corners."""
        leaving = self._choose_leaving(T_map_camera) if self.bundle.is_full else None
        if leaving == 0:
            self._archive(0)
        known = self.bundle.points.select(tracks.ids).is_sure(self.bundle.noise_px)
        has_few = known.sum() < _FEW_KNOWN * self._config.tracking.max_corners
        mask, window = self._front_end.mask, self._views() if has_few else []
        found = self._local_map.find(tracks.image, T_map_camera, tracks.ids, self.bundle.lens, mask, window)
        if leaving:  # after the search: else the newest frame would be found, and drive out the oldest
            self._archive(leaving)
        if found is not None:
            tracks = tracks.merge(found.ids, found.pixels)
            if found.frame.number not in self.bundle.numbers:
                self.bundle.revisit(found.frame)
                self._images.insert(0, found.frame.image)
        if self.bundle.is_full:
            self._archive(1)
        self._images.append(tracks.image)
        seen = FrameObservations(tracks.ids, tracks.pixels)
        if adjust:
            agree = self.bundle.add(seen, T_map_camera)
            self._rescale(self._scale_correction.update(self.bundle.visible()))
            tracks = tracks.select(agree)
        else:
            self.bundle.add_turned(seen, T_map_camera)
        return self._renew(tracks)

    def _views(self) -> list[MapFrame]:
        """The bundle's own frames with their landmarks."""
        return [self.bundle.landmarks_of(k, self._images[k]) for k in range(len(self._images) - 1)]

    def _archive(self, place: int) -> None:
        """Move a frame of the bundle to the local map; the newest one only with a view of its own."""
        T_map_staying = self.bundle.poses[-2] if place == len(self.bundle.poses) - 1 else None
        self._local_map.keep(self.bundle.landmarks_of(place, self._images[place]), T_map_staying)
        self.bundle.remove(place)
        del self._images[place]

    def _rescale(self, factor: float) -> None:
        """Make the map larger by a factor around the newest frame."""
        self._local_map.rescale(factor, self.bundle.poses[-1, :3, 3])
        self.bundle.rescale(factor)

    def _choose_leaving(self, T_map_camera: Array) -> int:
        """Frame of a full bundle that makes room for a camera at (4, 4).

        The oldest one; but the newest one where the camera has moved little since the one before that. While it turns
        the frames with the parallax stay, and all depths with them.
        """
        moved = float(np.linalg.norm(T_map_camera[:3, 3] - self.bundle.poses[-2, :3, 3]))
        parallax_px = self._camera.fx * moved * self.bundle.points.median_inverse_depth
        min_parallax_px = _MIN_SPACING * self._config.reference_parallax_px
        return len(self.bundle.poses) - 1 if parallax_px < min_parallax_px else 0

    def _renew(self, tracks: MonoTracks) -> MonoTracks:
        """Add new corners to the newest frame of the bundle."""
        renewed = self._front_end.observe(tracks.image, tracks)
        self.bundle.replace_newest(FrameObservations(renewed.ids, renewed.pixels))
        return renewed

    def state(self) -> dict[str, Any]:
        """Frames, landmarks and images, for a checkpoint."""
        return {
            "bundle": self.bundle.state(),
            "images": list(self._images),
            "local_map": self._local_map.state(),
            "scale_correction": self._scale_correction.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self.bundle.restore(state["bundle"])
        self._images = list(state["images"])
        self._local_map.restore(state["local_map"])
        self._scale_correction.restore(state["scale_correction"])
