"""The key frames of a saved map: their poses and landmarks, and 2D-3D matches of an image with them.

The local map of a key frame are the landmarks of the key frames around it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.image_processing.matching import mutual_matches
from slam.errors import DataError
from slam.localization.absolute_pose import MapMatches
from slam.loop_closing.loop_closer import FrameLandmarks
from slam.map_database.database import MapDatabase

Array = NDArray[np.float64]

_MAX_DESCRIPTOR_VALUE = 1.01  # of a descriptor of unit length, with room for rounding


@dataclass(frozen=True)
class SavedMap:
    """The key frames of a map and their poses. Landmarks are read when they are needed.

    Attributes:
        store: map database.
        camera: camera of its images.
        key_frames: (F,) numbers of the images whose landmarks make the map, increasing.
        poses: T_world_camera (N, 4, 4) of all images.
        units: (N,) unit of length of each image, as a multiple of that of its frame of reference.
        session: (N,) session of each image; images of one session are consistent with one another.
        map_id: (N,) frame of reference of each image.
        descriptor_size: number of values of a descriptor.
    """

    store: MapDatabase
    camera: StereoCamera
    key_frames: NDArray[np.int64]
    poses: Array
    units: Array
    session: NDArray[np.int64]
    map_id: NDArray[np.int64]
    descriptor_size: int

    @classmethod
    def open(cls, store: MapDatabase) -> Self:
        """Read all but the landmarks.

        Raises:
            DataError: the map is damaged, has no key frame, or has sessions with different cameras.
        """
        sessions = store.sessions()
        key_frames = np.array(store.key_frames(), np.int64)
        if not sessions or len(key_frames) == 0:
            raise DataError(f"{store.path}: expected a map with key frames, found none; run again")
        if len({session.camera for session in sessions}) > 1:
            raise DataError(f"{store.path}: expected one camera in all sessions, found several; give another map")
        poses, units = store.poses(), store.units()
        firsts = [session.first_image for session in sessions]
        session = np.searchsorted(firsts, np.arange(len(poses)), side="right") - 1
        if not np.isfinite(poses).all() or key_frames[-1] >= len(poses):
            raise DataError(f"{store.path}: expected a finite pose of each image, found others; revisit check MAP")
        map_id = np.array([one.map_id for one in sessions])[session]
        return cls(
            store=store,
            camera=sessions[0].camera,
            key_frames=key_frames,
            poses=poses,
            units=units,
            session=session,
            map_id=map_id,
            descriptor_size=_descriptor_size(store, key_frames),
        )

    def landmarks(self, image: int) -> FrameLandmarks:
        """Landmarks of an image, in its camera's frame and its own unit.

        Raises:
            DataError: the map is damaged.
        """
        landmarks = self.store.landmarks(int(image))  # SQLite does not take NumPy integers
        arrays = (landmarks.pixels, landmarks.points, landmarks.descriptors)
        is_sound = all(np.isfinite(array).all() for array in arrays)
        is_sound &= np.abs(landmarks.descriptors).max(initial=0) < _MAX_DESCRIPTOR_VALUE
        if not is_sound or (len(landmarks) and landmarks.descriptors.shape[1] != self.descriptor_size):
            raise DataError(
                f"{self.store.path}: expected finite landmarks of one kind, found others in image {image}; run again"
            )
        return landmarks

    def pose_between(self, base: int, other: int) -> Array:
        """T_base_other (4, 4) of two images with one frame of reference, in its unit."""
        return se3.inverse(self.poses[base]) @ self.poses[other]

    def neighbors(self, place: int, offsets: Sequence[int]) -> NDArray[np.int64]:
        """Images of the key frames at offsets from one of them, in key frames, of the same session."""
        there = np.unique(np.clip(place + np.array(offsets), 0, len(self.key_frames) - 1))
        images = self.key_frames[there]
        return images[self.session[images] == self.session[self.key_frames[place]]]


def _descriptor_size(store: MapDatabase, images: NDArray[np.int64]) -> int:
    for image in images.tolist():
        landmarks = store.landmarks(image)
        if len(landmarks):
            return landmarks.descriptors.shape[1]
    raise DataError(f"{store.path}: expected landmarks, found none in any key frame; run again")


@dataclass(frozen=True)
class LocalMapConfig:
    """Settings of the matching of an image with the landmarks of key frames.

    Attributes:
        ratio: maximum ratio of nearest to second nearest descriptor distance.
        sigma_px: standard deviation of a landmark's pixel and of its disparity, pixels.
    """

    ratio: float = 0.8
    sigma_px: float = 0.5


def match_local_map(
    saved: SavedMap, base: int, images: Iterable[int], features: LocalFeatures, config: LocalMapConfig
) -> MapMatches:
    """Match the features of an image with the landmarks of some key frames, in the frame of image `base`."""
    parts = [_match(saved, base, image, features, config) for image in images]
    return MapMatches(
        np.concatenate([part.pixels for part in parts]),
        np.concatenate([part.points_base for part in parts]),
        np.concatenate([part.noise_base for part in parts]),
        np.concatenate([part.features for part in parts]),
    )


def _match(saved: SavedMap, base: int, image: int, features: LocalFeatures, config: LocalMapConfig) -> MapMatches:
    landmarks = saved.landmarks(image)
    pairs = mutual_matches(features.descriptors, landmarks.descriptors.astype(np.float32), config.ratio)
    points_there = landmarks.points[pairs[:, 1]].astype(np.float64)
    T_base_there, unit = saved.pose_between(base, image), saved.units[image]
    R = T_base_there[:3, :3]
    noise = unit**2 * _point_noise(saved.camera, points_there, config.sigma_px)
    return MapMatches(
        features.pixels[pairs[:, 0]].astype(np.float64),
        se3.transform(T_base_there, unit * points_there),
        R @ noise @ R.T,
        pairs[:, 0].astype(np.int64),
    )


def _point_noise(camera: StereoCamera, points: Array, sigma_px: float) -> Array:
    """Covariance (K, 3, 3) of triangulated points (K, 3): pixel noise across the ray, disparity noise along it."""
    depth = points[:, 2]
    across = np.stack([depth / camera.fx * sigma_px, depth / camera.fy * sigma_px, np.zeros_like(depth)], axis=1)
    along = points * (depth / (camera.fx * camera.baseline) * sigma_px)[:, None]
    return np.einsum("ki,ij->kij", across**2, np.eye(3)) + along[:, :, None] * along[:, None, :]
