"""How did the camera move? Visual odometry that knows nothing of places, maps or files."""

from typing import TYPE_CHECKING, Any

from odometry.camera import StereoCamera
from odometry.motion import Motion

if TYPE_CHECKING:
    from odometry.mono.mono_config import MonoOdometryConfig
    from odometry.mono.mono_odometry import MonoOdometry
    from odometry.stereo.stereo_odometry import StereoOdometry, StereoOdometryConfig

__all__ = [
    "MonoOdometry",
    "MonoOdometryConfig",
    "Motion",
    "StereoCamera",
    "StereoOdometry",
    "StereoOdometryConfig",
]


def __getattr__(name: str) -> Any:
    """Import the odometry itself, and the compiler it needs, when it is first asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from odometry.mono import mono_odometry
    from odometry.stereo import stereo_odometry

    return getattr(mono_odometry if name.startswith("Mono") else stereo_odometry, name)
