"""The parts of the system, built from a configuration: the one place where names become classes."""

from pathlib import Path

from odometry.camera import StereoCamera
from odometry.mono import MonoOdometry
from odometry.stereo import StereoOdometry
from place_recognition.image_processing.extractors import EXTRACTORS
from place_recognition.image_processing.features import SharedFeatures
from place_recognition.paradigms.catalogue import PARADIGMS, ParadigmsConfig, build, local_features
from place_recognition.recognizer import PlaceRecognizer, RowSink
from slam.config import RunConfig, read_config
from slam.errors import ConfigError, DataError
from slam.eyes import Eyes, OneEye, TwoEyes
from slam.keyframes import KeyFrameSelector
from slam.loop_closing import LoopCloser, fixed_scale
from slam.loop_geometry import estimate_relative_scale
from slam.mapping.landmarks import LandmarkMap
from slam.pose_graph import PoseGraph
from slam.robust import back_end
from slam.system import Parts


def check_paradigm(name: str) -> None:
    """Raise ConfigError for an unknown paradigm; the message lists the known ones."""
    if name not in PARADIGMS:
        raise ConfigError(f"unknown paradigm '{name}': expected one of {', '.join(PARADIGMS)}")


def check_features(name: str) -> None:
    """Raise ConfigError for unknown local features; the message lists the known ones."""
    if name not in EXTRACTORS:
        raise ConfigError(f"unknown local features '{name}': expected one of {', '.join(EXTRACTORS)}")


def check_names(config: RunConfig) -> RunConfig:
    """Pass on a configuration whose names all exist.

    Raises:
        ConfigError: unknown paradigm, local features or back end; the message lists the known ones.
    """
    check_paradigm(config.paradigm)
    check_features(config.places.features)
    back_end(config.robust)
    return config


def read_checked(path: Path) -> RunConfig:
    """Configuration from a TOML file, whose names all exist.

    Raises:
        ConfigError: the file is missing or damaged, or holds an unknown name or a value that cannot work.
    """
    config = read_config(path)
    try:
        return check_names(config)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def build_recognizer(
    name: str, features: SharedFeatures, config: ParadigmsConfig, rows: RowSink | None = None
) -> PlaceRecognizer:
    """Build the recogniser of a paradigm whose name has been checked.

    Raises:
        DataError: its vocabulary or its descriptor is missing, damaged or of another kind.
    """
    try:
        return build(name, features, config, rows)
    except (OSError, ValueError) as error:  # place_recognition knows nothing of this family
        raise DataError(str(error)) from error


def build_parts(camera: StereoCamera, config: RunConfig, rows: RowSink | None = None) -> Parts:
    """All parts for one camera, of a configuration whose names have been checked.

    The rows of the recogniser's matrix go to `rows`, where there is one.
    """
    features = SharedFeatures(local_features(config.places))
    eyes: Eyes
    if config.mono:
        eyes, compare = OneEye(MonoOdometry(camera, config.one_camera.odometry), camera), estimate_relative_scale
    else:
        eyes, compare = TwoEyes(StereoOdometry(camera, config.odometry)), fixed_scale
    return Parts(
        eyes=eyes,
        features=features,
        recognizer=build_recognizer(config.paradigm, features, config.places, rows),
        loop_closer=LoopCloser(camera, features, config.loop_closing, eyes.disparity, compare),
        graph=PoseGraph(config.graph),
        key_frames=KeyFrameSelector(config.key_frames),
        landmarks=LandmarkMap(config.landmarks, camera),
    )
