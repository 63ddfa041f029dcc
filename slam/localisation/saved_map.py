"""The key frames of a map database, as localization needs them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from slam.errors import DataError
from slam.loop_closing import FrameLandmarks
from slam.map_store.store import MapDatabase

Array = NDArray[np.float64]

_UNIT = 1.01  # no number of a descriptor of unit length is larger, rounding allowed for


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
            DataError: the store is damaged, holds no key frame, or drives with different cameras.
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
            DataError: the store is damaged.
        """
        seen = self.store.landmarks(int(image))  # SQLite knows no integers of numpy
        arrays = (seen.pixels, seen.points, seen.descriptors)
        sound = all(np.isfinite(array).all() for array in arrays) and np.abs(seen.descriptors).max(initial=0) < _UNIT
        if not sound or (len(seen) and seen.descriptors.shape[1] != self.descriptor_size):
            raise DataError(
                f"{self.store.path}: expected finite landmarks of one kind, found others in image {image}; run again"
            )
        return seen

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
        seen = store.landmarks(image)
        if len(seen):
            return seen.descriptors.shape[1]
    raise DataError(f"{store.path}: expected landmarks, found none in any key frame; run again")
