"""Reference frame of an odometry: the earlier image that motion is measured from, and the motion since."""

from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from odometry import se3

ViewT = TypeVar("ViewT")

Array = NDArray[np.float64]


def _here() -> Array:
    return np.eye(4)


def _certain() -> Array:
    return np.zeros((6, 6))


@dataclass(frozen=True)
class Reference(Generic[ViewT]):
    """An image that motion is measured from, and the images since.

    Attributes:
        view: the image and its points.
        T_reference_previous: (4, 4) pose of the previous image, metres.
        T_reference_measured: (4, 4) pose of the last image that was measured from this one.
        covariance_previous: (6, 6) of `T_reference_previous`, of the part that was not measured from this image.
        age_frames: images since this one, or since the last one measured from it.
    """

    view: ViewT
    T_reference_previous: Array = field(default_factory=_here)
    T_reference_measured: Array = field(default_factory=_here)
    covariance_previous: Array = field(default_factory=_certain)
    age_frames: int = 0

    def age(self, images: int) -> "Reference[ViewT]":
        """Count images that have been taken since."""
        return replace(self, age_frames=self.age_frames + images)

    def update(self, T_reference_current: Array) -> "Reference[ViewT]":
        """Take over the measured pose (4, 4) of the current image, which is the next one's previous image."""
        return Reference(self.view, T_reference_current, T_reference_current)

    def extend(self, T_previous_current: Array, covariance: Array) -> "Reference[ViewT]":
        """Append a motion (4, 4) that was not measured from this image, with its covariance (6, 6)."""
        return replace(
            self,
            T_reference_previous=self.T_reference_previous @ T_previous_current,
            covariance_previous=se3.compose_covariance(self.covariance_previous, T_previous_current, covariance),
        )

    def velocity(self, T_reference_current: Array) -> Array:
        """Tangent vector (6,) of the motion to (4, 4) from the image measured before, per image."""
        return se3.log(se3.inverse(self.T_reference_measured) @ T_reference_current) / self.age_frames

    def state(self, view: object) -> dict[str, Any]:
        """Plain values and arrays, for a checkpoint; `view` is the state of the view."""
        return {**vars(self), "view": view}
