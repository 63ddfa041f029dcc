"""The components of the system, built from a configuration: the one place where names become classes."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from odometry.mono.mono_odometry import MonoOdometry
from odometry.stereo.rgbd_odometry import RgbdOdometry
from odometry.stereo.stereo_odometry import StereoOdometry
from place_recognition.image_processing.extractors import EXTRACTORS, is_extractor
from place_recognition.image_processing.local_features import FeatureCache, FeatureExtractor
from place_recognition.image_processing.static_regions import ImageMasks
from place_recognition.paradigms.registry import (
    PARADIGMS,
    PRESETS,
    ParadigmsConfig,
    exclusion_s,
    make_control,
    make_feature_extractor,
    make_recognizer,
    with_exclusion,
    with_preset,
)
from place_recognition.recognizer import MatrixSink, PlaceRecognizer, TwoRecordingRecognizer
from slam.config import RunConfig, read_config
from slam.datasets.dataset import Dataset
from slam.datasets.formats.image_sequence import read_grey
from slam.errors import ConfigError, DataError
from slam.external.matches_file import FileRecognizer, TrustedLoopVerifier, check_matches_file, path_of
from slam.external.odometry_file import FileOdometry, FileTrajectory, check_odometry_file, read_uncertainty
from slam.io.matches import read_proposed_loops
from slam.keyframes import KeyFrameSelector
from slam.loop_closing.loop_closer import LoopCloser
from slam.mapping.landmark_map import LandmarkMap
from slam.pose_graph.pose_graph import PoseGraph
from slam.pose_graph.robust.backends import back_end
from slam.system import Components, LoopVerifier, VisualOdometry
from slam.visual_odometry import MonocularVisualOdometry, RgbdVisualOdometry, StereoVisualOdometry

Image = NDArray[np.uint8]

_PLACE_RECOGNITION_SETTINGS = ("features", "vocabulary", "descriptor", "preset")
_CAMERA_HEIGHT = "camera_height"  # setting of the odometry of one camera


def check_paradigm(name: str) -> None:
    """Raise ConfigError for an unknown paradigm; the message lists the known ones."""
    if name not in PARADIGMS and path_of(name) is None:
        raise ConfigError(f"unknown paradigm '{name}': expected one of {', '.join(PARADIGMS)}")


def check_features(name: str) -> None:
    """Raise ConfigError for unknown local features; the message lists the known ones."""
    if not is_extractor(name):
        known = ", ".join(EXTRACTORS)
        raise ConfigError(f"unknown local features '{name}': expected one of {known}, found none; or name onnx:FILE")


def check_preset(name: str) -> None:
    """Raise ConfigError for an unknown preset of the paradigms; the message lists the known ones."""
    if name not in PRESETS:
        raise ConfigError(f"unknown preset '{name}': expected one of {', '.join(PRESETS)}")


def check_names(config: RunConfig) -> RunConfig:
    """Pass on a configuration whose names all exist, and whose settings do not contradict each other.

    Raises:
        ConfigError: unknown paradigm, local features, preset or back end; the message lists the known ones. Also a
            setting about a file that is not given.
    """
    check_paradigm(config.paradigm)
    check_features(config.place_recognition.features)
    check_preset(config.place_recognition.preset)
    check_matches_settings(config.paradigm, config.place_recognition.preset, config.trust_poses)
    if config.odometry_covariance and not config.odometry_file:
        raise ConfigError("--odometry-covariance: says how uncertain the motions of a file are; add --odometry FILE")
    back_end(config.robust)
    return config


def check_matches_settings(paradigm: str, preset: str, trust_poses: bool) -> None:
    """Raise ConfigError where a preset or trust in poses does not fit a paradigm that has been checked."""
    if path_of(paradigm) is None and trust_poses:
        raise ConfigError("--trust-poses: takes the poses of a file of matches; add --matches FILE")
    if path_of(paradigm) is not None and preset != "default":
        raise ConfigError(f"--preset {preset}: a file of matches has no preset; leave it out")


def check_files(config: RunConfig, dataset: Dataset) -> tuple[str, ...]:
    """Check that the trajectory and the matches of other programs belong to a dataset; remarks about the files.

    Raises:
        ConfigError, DataError: a file is missing or damaged, or of another drive.
    """
    remarks, matches = tuple[str, ...](), path_of(config.paradigm)
    if config.odometry_file:
        remarks += check_odometry_file(Path(config.odometry_file), config.odometry_covariance, dataset)
    if matches is not None:
        remarks += check_matches_file(matches, len(dataset), config.trust_poses)
    return remarks


def read_checked_config(path: Path) -> RunConfig:
    """Configuration from a TOML file, whose names all exist.

    Raises:
        ConfigError: the file is missing or damaged, or holds an unknown name or a value that cannot work.
    """
    config = read_config(path)
    try:
        return check_names(config)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def override_config(base: RunConfig, settings: Mapping[str, object]) -> RunConfig:
    """A configuration with some settings replaced, as the command line names them.

    Args:
        base: the configuration.
        settings: fields of `RunConfig`, or names of place recognition or odometry settings, to their values.

    Raises:
        ConfigError: an unknown name, or a value that cannot work.
    """
    own = {k: v for k, v in settings.items() if k not in (*_PLACE_RECOGNITION_SETTINGS, _CAMERA_HEIGHT)}
    places = {k: v for k, v in settings.items() if k in _PLACE_RECOGNITION_SETTINGS}
    changed = replace(base, **own, place_recognition=replace(base.place_recognition, **places))  # type: ignore[arg-type]
    return check_names(_with_height(changed, settings[_CAMERA_HEIGHT]) if _CAMERA_HEIGHT in settings else changed)


def _with_height(config: RunConfig, height: object) -> RunConfig:
    """Set the height above the road, metres, of a single camera."""
    if not config.mono:
        raise ConfigError("--camera-height: gives the scale that one camera lacks; add --mono")
    try:
        odometry = replace(config.mono_odometry.odometry, camera_height_m=float(height))  # type: ignore[arg-type]
    except ValueError as error:
        raise ConfigError(f"--camera-height: {error}") from error
    return replace(config, mono_odometry=replace(config.mono_odometry, odometry=odometry))


def exclude_time(config: ParadigmsConfig, seconds: float, timestamps: NDArray[np.float64]) -> ParadigmsConfig:
    """Settings by which no image is matched with those of the latest seconds of a recording.

    Args:
        config: settings of the paradigms.
        seconds: the time; 0 changes nothing.
        timestamps: (N,) times of the images, seconds; their median distance turns the time into a number of images.
    """
    if not seconds or len(timestamps) < 2:
        return config
    period_s = float(np.median(np.diff(timestamps)))
    # 1e-9: a whole number of periods must not be rounded up to one more.
    return with_exclusion(config, math.ceil(seconds / period_s - 1e-9))


def exclude_by_preset(config: RunConfig, timestamps: NDArray[np.float64]) -> RunConfig:
    """Configuration for a recording with times (N,), whose latest images are excluded as its preset says.

    An exclusion that the configuration itself names stays.
    """
    places = config.place_recognition
    if places.view.exclusion_frames:
        return config
    return replace(config, place_recognition=exclude_time(places, exclusion_s(config.paradigm, places), timestamps))


def build_extractor(config: ParadigmsConfig) -> FeatureExtractor:
    """Build the extractor of the local features, whose name has been checked.

    Raises:
        DataError: the file of learned features is missing, or holds no usable network.
    """
    try:
        return make_feature_extractor(config)
    except (OSError, ValueError) as error:  # place_recognition raises no RevisitError
        raise DataError(str(error)) from error


def build_recognizer(
    name: str, features: FeatureCache, config: ParadigmsConfig, rows: MatrixSink | None = None
) -> TwoRecordingRecognizer:
    """Build the recogniser of a paradigm whose name has been checked.

    Raises:
        DataError: its vocabulary, its descriptor or its file of matches is missing, damaged or of another kind.
    """
    matches = path_of(name)
    if matches is not None:
        return FileRecognizer(read_proposed_loops(matches).best)
    try:
        return make_recognizer(name, features, config, rows)
    except (OSError, ValueError) as error:  # place_recognition raises no RevisitError
        raise DataError(str(error)) from error


def _build_loop_recognizer(
    name: str, features: FeatureCache, config: ParadigmsConfig, rows: MatrixSink | None
) -> PlaceRecognizer:
    """Build the recogniser of a run, in which each match of a file goes through the geometry."""
    matches = path_of(name)
    if matches is not None:
        return FileRecognizer(read_proposed_loops(matches).by_query)
    return build_recognizer(name, features, config, rows)


def build_control(features: FeatureCache, config: ParadigmsConfig, seed: int) -> TwoRecordingRecognizer:
    """Build the control of place recognition, which proposes random past images to the same geometry and belief."""
    return make_control(features, replace(config, seed=seed))


def build_components(camera: StereoCamera, config: RunConfig, rows: MatrixSink | None = None) -> Components:
    """All components for one camera, of a configuration whose names have been checked.

    Args:
        camera: camera of the dataset.
        config: the configuration.
        rows: receives the rows of the recogniser's similarity matrix; None where nobody needs them.

    Raises:
        DataError: the mask, the features, the vocabulary or the descriptor cannot be used.
    """
    places = with_preset(config.paradigm, replace(config.places_for_camera(), seed=config.seed))
    features = FeatureCache(build_extractor(places))
    mask = read_mask(Path(config.mask), (camera.height, camera.width)) if config.mask else None
    odometry = build_odometry(camera, config)
    return Components(
        odometry=odometry,
        masks=ImageMasks(config.static_regions, mask),
        features=features,
        recognizer=_build_loop_recognizer(config.paradigm, features, places, rows),
        loop_closer=build_loop_verifier(LoopCloser(camera, odometry, config.loop_closing), config),
        graph=PoseGraph(config.pose_graph_for_camera()),
        key_frames=KeyFrameSelector(config.key_frames_for_camera()),
        landmarks=_build_landmarks(camera, config),
    )


def build_loop_verifier(loop_closer: LoopCloser, config: RunConfig) -> LoopVerifier:
    """Verifier of loops: the loop closer, or poses of a file where these are trusted."""
    matches = path_of(config.paradigm)
    if matches is None or not config.trust_poses:
        return loop_closer
    return TrustedLoopVerifier(read_proposed_loops(matches).by_query, loop_closer)


def _build_landmarks(camera: StereoCamera, config: RunConfig) -> LandmarkMap:
    """Landmark map of a pair, or of a depth camera, whose accuracy does not depend on the resolution of its images."""
    if config.depth:
        return LandmarkMap(replace(config.landmarks, max_depth_m=config.rgbd.max_landmark_depth_m))
    return LandmarkMap(config.landmarks, camera)


def read_mask(path: Path, shape: tuple[int, int]) -> Image:
    """Mask (H, W) uint8 from an image file, 0 where the camera does not show the scene.

    Args:
        path: image of any format.
        shape: (H, W) of the camera's images.

    Raises:
        DataError: the file is missing or no image, has another size, or leaves out the whole image.
    """
    mask = read_grey(path)
    if mask.shape != shape:
        found = f"{mask.shape[1]} x {mask.shape[0]}"
        raise DataError(f"{path}: expected {shape[1]} x {shape[0]} pixels as the images have, found {found}; resize it")
    if not mask.any():
        raise DataError(f"{path}: expected white where features may lie, found a black image; paint that part white")
    return mask


def build_odometry(camera: StereoCamera, config: RunConfig) -> VisualOdometry:
    """Odometry of the pair, the depth camera or the left camera alone; with motions of a file where one is named."""
    measured = _build_measured_odometry(camera, config)
    if not config.odometry_file:
        return measured
    trajectory = FileTrajectory(Path(config.odometry_file))
    return FileOdometry(trajectory, measured, read_uncertainty(config.odometry_covariance))


def _build_measured_odometry(camera: StereoCamera, config: RunConfig) -> VisualOdometry:
    if config.mono:
        return MonocularVisualOdometry(MonoOdometry(camera, config.mono_odometry.odometry), camera)
    if config.depth:
        return RgbdVisualOdometry(RgbdOdometry(camera, config.rgbd.odometry))
    return StereoVisualOdometry(StereoOdometry(camera, config.odometry))
