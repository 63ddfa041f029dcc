"""What a map store holds, as far as an image can be placed in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from slam.errors import DataError
from slam.loop_closing import FrameLandmarks
from slam.map_store.store import MapStore

Array = NDArray[np.float64]

_UNIT = 1.01  # no number of a descriptor of unit length is larger, rounding allowed for


@dataclass(frozen=True)
class SavedMap:
    """The key frames of a map, and where they stand. Landmarks are read when asked for.

    Attributes:
        store: that holds it.
        camera: of its images.
        key_frames: (F,) numbers of the images whose landmarks make the map, rising.
        poses: T_world_camera (N, 4, 4) of all images.
        units: (N,) of length of each image, in that of the world.
        session: (N,) drive of each image; its frames stand well to one another, whatever has drifted since.
        world: (N,) frame of reference of each image.
        numbers: in a descriptor.
    """

    store: MapStore
    camera: StereoCamera
    key_frames: NDArray[np.int64]
    poses: Array
    units: Array
    session: NDArray[np.int64]
    world: NDArray[np.int64]
    numbers: int

    @classmethod
    def open(cls, store: MapStore) -> Self:
        """Read all but the landmarks.

        Raises:
            DataError: the store is damaged, holds no key frame, or drives with different cameras.
        """
        sessions = store.sessions()
        key_frames = np.array(store.key_frames(), np.int64)
        if not sessions or len(key_frames) == 0:
            raise DataError(f"{store.path}: expected a map with key frames, found none; let a run write it")
        if len({session.camera for session in sessions}) > 1:
            raise DataError(f"{store.path}: expected drives with one camera, found several; give a map of one drive")
        poses, units = store.poses(), store.units()
        firsts = [session.first_image for session in sessions]
        session = np.searchsorted(firsts, np.arange(len(poses)), side="right") - 1
        if not np.isfinite(poses).all() or key_frames[-1] >= len(poses):
            raise DataError(f"{store.path}: expected a finite pose of each image, found others; revisit check MAP")
        world = np.array([one.world for one in sessions])[session]
        return cls(store, sessions[0].camera, key_frames, poses, units, session, world, _numbers(store, key_frames))

    def landmarks(self, image: int) -> FrameLandmarks:
        """What an image saw, in its camera's frame and its own unit.

        Raises:
            DataError: the store is damaged.
        """
        seen = self.store.landmarks(int(image))  # SQLite knows no integers of numpy
        arrays = (seen.pixels, seen.points, seen.descriptors)
        sound = all(np.isfinite(array).all() for array in arrays) and np.abs(seen.descriptors).max(initial=0) < _UNIT
        if not sound or (len(seen) and seen.descriptors.shape[1] != self.numbers):
            raise DataError(
                f"{self.store.path}: expected finite landmarks of one kind, found others in image {image}; run again"
            )
        return seen

    def pose_between(self, base: int, other: int) -> Array:
        """T_base_other (4, 4) of two images of one world, in its unit."""
        return se3.inverse(self.poses[base]) @ self.poses[other]

    def beside(self, place: int, offsets: Sequence[int]) -> NDArray[np.int64]:
        """Key frames at offsets from one of them, both counted in key frames, of the same drive."""
        there = np.unique(np.clip(place + np.array(offsets), 0, len(self.key_frames) - 1))
        images = self.key_frames[there]
        return images[self.session[images] == self.session[self.key_frames[place]]]


def _numbers(store: MapStore, images: NDArray[np.int64]) -> int:
    for image in images.tolist():
        seen = store.landmarks(image)
        if len(seen):
            return seen.descriptors.shape[1]
    raise DataError(f"{store.path}: expected landmarks, found none in any key frame; let another run write it")
