"""The parts of the system, built from a configuration: the one place where names become classes."""

from collections.abc import Callable

from odometry.camera import StereoCamera
from odometry.stereo import StereoOdometry
from place_recognition.image_processing.features import SharedFeatures
from place_recognition.image_processing.surf import Surf
from place_recognition.paradigms.tracked_words import TrackedWords
from place_recognition.recognizer import PlaceRecognizer
from slam.config import RunConfig
from slam.errors import ConfigError
from slam.keyframes import KeyFrameSelector
from slam.loop_closing import LoopCloser
from slam.mapping.landmarks import LandmarkMap
from slam.pose_graph import PoseGraph
from slam.robust import back_end
from slam.system import Parts

PARADIGMS: dict[str, Callable[[SharedFeatures, RunConfig], PlaceRecognizer]] = {
    "tracked-words": lambda features, config: TrackedWords(features, config.tracked_words),
}


def check_names(config: RunConfig) -> RunConfig:
    """Pass on a configuration whose names all exist.

    Raises:
        ConfigError: an unknown paradigm or back end; the message lists the known ones.
    """
    if config.paradigm not in PARADIGMS:
        raise ConfigError(f"unknown paradigm '{config.paradigm}': expected one of {', '.join(PARADIGMS)}")
    back_end(config.robust)
    return config


def build_parts(camera: StereoCamera, config: RunConfig) -> Parts:
    """All parts for one camera, of a configuration whose names have been checked."""
    features = SharedFeatures(Surf(config.features))
    odometry = StereoOdometry(camera, config.odometry)
    return Parts(
        odometry=odometry,
        features=features,
        recognizer=PARADIGMS[config.paradigm](features, config),
        loop_closer=LoopCloser(camera, features, config.loop_closing, odometry.disparity),
        graph=PoseGraph(config.pose_graph),
        key_frames=KeyFrameSelector(config.key_frames),
        landmarks=LandmarkMap(config.landmarks, camera),
    )
