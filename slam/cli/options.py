"""The options of the commands, one named type each, with exit codes and the names that options accept.

A type carries the help of its option, so that the signature of a command is a list of names. Options that several
commands share stand first, then those of one command, in the order of its help.
"""

from pathlib import Path
from typing import Annotated

import typer

from slam.simulation.scenario.config import SimulationConfig as Drive
from slam.simulation.scenario.room_config import RoomConfig as Room

# Shells report 130 for a program that Ctrl-C has ended; typer reports 2 for an unknown option.
EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 1, 2, 130

# Written out here because the registries are slow to import, and help must answer at once. A test compares these lists
# with the registries.
PARADIGM_NAMES = (
    "sequence-histograms, dynamic-sequences, hierarchical-places, tracked-words, pixel-sequences, global-descriptor, "
    "seq-slam"
)
PRESET_NAMES = "default, published"
FEATURE_NAMES = "surf, surf-oriented, sift, orb, brief"
BACK_END_NAMES = "none, huber, dcs, switchable, gnc, pcm, pcm+gnc"
FORMAT_NAMES = "kitti, kitti-raw, euroc, tum-rgbd, own-camera, bag, malaga, new-college, city-centre, images"

# Groups of options in the help of commands that have many.
INPUT, RECOGNITION, BACK_END, OUTPUT = "Input", "Place recognition", "Odometry and back end", "Output"
_ROUTE, _SCENE, _ROOM, _CAMERA = "Route", "Scene", "Room", "Camera"
_TWO_RECORDINGS = "Two recordings"
_RULE = "Rule of a revisit, for ground truth given as poses"

# The defaults of RunConfig, for help: without an option its value comes from --config, and without that from here.
DEFAULT_PARADIGM, DEFAULT_FEATURES, DEFAULT_BACK_END = "tracked-words", "surf", "pcm+gnc"
DEFAULT_PRESET = "default"

# Options of several commands.

Out = Annotated[Path, typer.Option("--out", help="Folder for the results.", show_default=True, rich_help_panel=OUTPUT)]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace earlier results in the output folder.", rich_help_panel=OUTPUT)
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.", rich_help_panel=OUTPUT)]
NoRecord = Annotated[bool, typer.Option("--no-record", help="Do not write recording.rrd.", rich_help_panel=OUTPUT)]
Sequence = Annotated[
    str | None,
    typer.Option(
        help="Name of the sequence, for example 00.", show_default="the only one of the source", rich_help_panel=INPUT
    ),
]
Format = Annotated[
    str | None,
    typer.Option(
        "--format",
        help=f"Format of the source: {FORMAT_NAMES}.",
        show_default="recognised by the files",
        rich_help_panel=INPUT,
    ),
]
FrameRate = Annotated[
    float | None,
    typer.Option("--fps", help="Images per second.", show_default="by the times of the source", rich_help_panel=INPUT),
]
ImageTopic = Annotated[
    list[str] | None,
    typer.Option(
        "--image-topic",
        help="Image topic of a bag. Give it twice for a stereo pair, the left camera first.",
        show_default="found by the types of the topics",
        rich_help_panel=INPUT,
    ),
]
Settings = Annotated[
    Path | None,
    typer.Option(
        "--config",
        help="TOML file with settings, such as the config.toml of a run.",
        show_default="built-in settings",
        rich_help_panel=INPUT,
    ),
]
Mask = Annotated[
    Path | None,
    typer.Option(
        "--mask",
        help="Image of the camera's size, black where it does not show the scene, such as on the bonnet.",
        show_default="static parts are found",
        rich_help_panel=INPUT,
    ),
]
Vocabulary = Annotated[
    Path | None,
    typer.Option(
        help="Vocabulary file of visual words.", show_default="a general vocabulary", rich_help_panel=RECOGNITION
    ),
]

_PRESET_HELP = f"Settings of the paradigm by name, as the papers state them or ours: {PRESET_NAMES}."

# simulate


def _default(drive: object, room: object) -> str:
    """Name the default of an option that differs between drives and rooms."""
    return f"{drive}; {room} in a room"


Shape = Annotated[
    str,
    typer.Argument(
        help="Shape of the route in a town: circle, figure-eight, blocks, or the path of a KITTI pose file; or room."
    ),
]
Laps = Annotated[int | None, typer.Option(help="Number of laps.", show_default=str(Drive.laps), rich_help_panel=_ROUTE)]
LapLength = Annotated[
    float | None,
    typer.Option(help="Length of one lap, metres.", show_default=str(Drive.length_m), rich_help_panel=_ROUTE),
]
Speed = Annotated[
    float | None,
    typer.Option(
        help="Speed of the car, metres per second.", show_default=str(Drive.speed_m_per_s), rich_help_panel=_ROUTE
    ),
]
LateralOffset = Annotated[
    float | None,
    typer.Option(
        help="Sideways shift of the laps after the first, metres.",
        show_default=str(Drive.lateral_offset_m),
        rich_help_panel=_ROUTE,
    ),
]
Reverse = Annotated[
    bool, typer.Option("--reverse", help="Drive every second lap in the opposite direction.", rich_help_panel=_ROUTE)
]
MaxFrames = Annotated[
    int | None,
    typer.Option(
        help="Maximum number of frames; 0 renders the whole route.",
        show_default=str(Drive.max_frames),
        rich_help_panel=_CAMERA,
    ),
]
SceneSeed = Annotated[
    int | None,
    typer.Option(
        help="Random seed of the town or room, and of the camera noise.",
        show_default=str(Drive.seed),
        rich_help_panel=_SCENE,
    ),
]
ChangeIllumination = Annotated[
    bool, typer.Option("--change-illumination", help="Give later laps another sun and sky.", rich_help_panel=_SCENE)
]
PerceptualAliasing = Annotated[
    bool,
    typer.Option("--perceptual-aliasing", help="Make two different streets look alike.", rich_help_panel=_SCENE),
]
CarsPer360m = Annotated[
    int | None,
    typer.Option(
        "--cars-per-360m",
        help="Number of moving cars met on 360 metres.",
        show_default=str(Drive.cars_per_360m),
        rich_help_panel=_SCENE,
    ),
]
Motion = Annotated[
    str | None,
    typer.Option(
        help="Motion in a room: hand, carried about; robot, driving and turning on the spot.",
        show_default=Room.motion,
        rich_help_panel=_ROOM,
    ),
]
Sensor = Annotated[
    str | None,
    typer.Option(
        help="Sensor in a room: mono, one camera; stereo, a pair; depth, one camera with a depth camera.",
        show_default=Room.sensor,
        rich_help_panel=_ROOM,
    ),
]
Duration = Annotated[
    float | None,
    typer.Option(
        help="Length of a sequence in a room, seconds.", show_default=f"{Room.duration_s}", rich_help_panel=_ROOM
    ),
]
PureRotation = Annotated[
    float | None,
    typer.Option(
        help="Time in the middle in which a carried camera turns without moving, seconds.",
        show_default=f"{Room.pure_rotation_s}",
        rich_help_panel=_ROOM,
    ),
]
SimulatedFrameRate = Annotated[
    float | None,
    typer.Option(
        help="Images or stereo pairs per second.",
        show_default=_default(Drive.frame_rate_hz, Room.frame_rate_hz),
        rich_help_panel=_CAMERA,
    ),
]
Width = Annotated[
    int | None,
    typer.Option(help="Image width, pixels.", show_default=_default(Drive.width, Room.width), rich_help_panel=_CAMERA),
]
Height = Annotated[
    int | None,
    typer.Option(
        help="Image height, pixels.", show_default=_default(Drive.height, Room.height), rich_help_panel=_CAMERA
    ),
]
DifficultyLevel = Annotated[
    str | None,
    typer.Option(
        "--difficulty",
        help="How hard it is: street, with errors of the calibration and corners as on real streets (not for a room); "
        "standard, with less of the first and constant speed; clean, with a perfect camera, constant speed, no wind.",
        show_default=_default(Drive.difficulty, Room.difficulty),
        rich_help_panel=_SCENE,
    ),
]
IdealSensor = Annotated[
    bool, typer.Option("--ideal-sensor", help="The same as --difficulty clean.", rich_help_panel=_CAMERA)
]
RectificationError = Annotated[
    float | None,
    typer.Option(
        help="Peak rectification error, pixels at KITTI's image size.",
        show_default="that of the difficulty",
        rich_help_panel=_CAMERA,
    ),
]
LensError = Annotated[
    float | None,
    typer.Option(
        help="Lens distortion left by the calibration, pixels at 45 degrees off the axis at KITTI's image size.",
        show_default="that of the difficulty",
        rich_help_panel=_CAMERA,
    ),
]
SaveDepth = Annotated[
    bool,
    typer.Option(
        "--save-depth", help="Also write the true depth map of each left image of a drive.", rich_help_panel=OUTPUT
    ),
]

# run

EarlierMap = Annotated[
    Path | None,
    typer.Option(
        "--map",
        help="Saved map of an earlier drive, a map.db or a run folder, whose places are recognised too.",
        show_default="an empty map",
        rich_help_panel=INPUT,
    ),
]
Resume = Annotated[
    bool, typer.Option("--resume", help="Continue an interrupted run in the output folder.", rich_help_panel=INPUT)
]
RunParadigm = Annotated[
    str | None,
    typer.Option(
        help=f"Place-recognition paradigm: {PARADIGM_NAMES}.",
        show_default=DEFAULT_PARADIGM,
        rich_help_panel=RECOGNITION,
    ),
]
RunPreset = Annotated[
    str | None, typer.Option(help=_PRESET_HELP, show_default=DEFAULT_PRESET, rich_help_panel=RECOGNITION)
]
RunFeatures = Annotated[
    str | None,
    typer.Option(
        help=f"Local features: {FEATURE_NAMES}, or onnx:FILE.",
        show_default=DEFAULT_FEATURES,
        rich_help_panel=RECOGNITION,
    ),
]
RunDescriptor = Annotated[
    str | None,
    typer.Option(
        help="Image descriptor of the paradigm global-descriptor: hog, small-cnn, or onnx:FILE.",
        show_default="hog",
        rich_help_panel=RECOGNITION,
    ),
]
RunRobust = Annotated[
    str | None,
    typer.Option(help=f"Robust back end: {BACK_END_NAMES}.", show_default=DEFAULT_BACK_END, rich_help_panel=BACK_END),
]
OdometryFile = Annotated[
    Path | None,
    typer.Option(
        "--odometry",
        help="Trajectory of another program, KITTI or TUM, whose motions are used instead of those measured here.",
        show_default="measured here",
        rich_help_panel=BACK_END,
    ),
]
OdometryCovariance = Annotated[
    str | None,
    typer.Option(
        help="Uncertainty of the motions of --odometry: SIGMA_RAD,SIGMA_M of each motion, or a file with a line of 6 "
        "standard deviations or 36 covariances for each frame.",
        show_default="estimated from the drive",
        rich_help_panel=BACK_END,
    ),
]
MatchesFile = Annotated[
    Path | None,
    typer.Option(
        "--matches",
        help="Matches of another program, CSV with query, match and perhaps score and x, y, z, qx, qy, qz, qw, which "
        "are used instead of a paradigm.",
        show_default="recognised here",
        rich_help_panel=RECOGNITION,
    ),
]
TrustPoses = Annotated[
    bool,
    typer.Option(
        "--trust-poses",
        help="Take the poses of --matches as they are, without looking at the images.",
        rich_help_panel=RECOGNITION,
    ),
]
Mono = Annotated[bool, typer.Option("--mono", help="Use the left camera alone.", rich_help_panel=BACK_END)]
CameraHeight = Annotated[
    float | None,
    typer.Option(
        help="Height of the camera above the road, metres, which gives the scale with --mono; 1.65 for KITTI.",
        show_default="unknown: no scale",
        rich_help_panel=BACK_END,
    ),
]
RunSeed = Annotated[
    int | None, typer.Option(help="Seed of every random generator.", show_default="0", rich_help_panel=BACK_END)
]
View = Annotated[str, typer.Option(help="Live view during the run: none, native or web.", rich_help_panel=OUTPUT)]
NoMap = Annotated[
    bool,
    typer.Option(
        "--no-map",
        help="Do not write map.db; the run can then neither be resumed nor used by revisit locate.",
        rich_help_panel=OUTPUT,
    ),
]

# reprocess

_FROM_MAP = "as in the map"
MapToReprocess = Annotated[
    Path, typer.Argument(metavar="MAP", help="Saved map of one drive: a map.db, or a run folder that has one.")
]
NewParadigm = Annotated[
    str | None, typer.Option(help=f"Place-recognition paradigm: {PARADIGM_NAMES}.", show_default=_FROM_MAP)
]
NewPreset = Annotated[str | None, typer.Option(help=_PRESET_HELP, show_default=_FROM_MAP)]
NewRobust = Annotated[str | None, typer.Option(help=f"Robust back end: {BACK_END_NAMES}.", show_default=_FROM_MAP)]
NewSettings = Annotated[
    Path | None,
    typer.Option(help="TOML file with settings, such as the config.toml of a run.", show_default=_FROM_MAP),
]
MovedSource = Annotated[
    Path | None, typer.Option(help="Recording of the drive, if it has been moved.", show_default=_FROM_MAP)
]

# places

PlacesParadigm = Annotated[
    str | None,
    typer.Option(
        help=f"Place-recognition paradigm: {PARADIGM_NAMES}.",
        show_default="none: name one, or a file with --matches",
        rich_help_panel=RECOGNITION,
    ),
]
PlacesTruth = Annotated[
    Path | None,
    typer.Option(
        help="Ground truth: a matrix of revisits (.mat, or .npz with `truth`), or poses (KITTI, TUM).",
        show_default="poses of the source",
        rich_help_panel=INPUT,
    ),
]
Reference = Annotated[
    Path | None,
    typer.Option(
        help="Another recording: the images are matched with its images alone, and not with each other.",
        show_default="none",
        rich_help_panel=_TWO_RECORDINGS,
    ),
]
ReferenceSequence = Annotated[
    str | None,
    typer.Option(
        help="Name of the sequence of the reference.",
        show_default="the only one of the reference",
        rich_help_panel=_TWO_RECORDINGS,
    ),
]
ReferenceTruth = Annotated[
    Path | None,
    typer.Option(
        help="Poses of the reference (KITTI, TUM), in the frame of those of --ground-truth.",
        show_default="none",
        rich_help_panel=_TWO_RECORDINGS,
    ),
]
EqualNumbers = Annotated[
    int | None,
    typer.Option(
        "--tolerance",
        help="Ground truth by equal numbers: largest difference of the numbers of two images of one place.",
        show_default="numbers say nothing",
        rich_help_panel=_TWO_RECORDINGS,
    ),
]
SamePlace = Annotated[
    float | None,
    typer.Option(
        "--max-distance",
        help="Largest distance of two images of one place, metres.",
        show_default="10 for poses, 25 for names",
        rich_help_panel=_TWO_RECORDINGS,
    ),
]
Soft = Annotated[
    float | None,
    typer.Option(
        help="Images, or metres, up to which a wrong match is tolerated: it counts neither as right nor as wrong.",
        show_default="none is",
        rich_help_panel=_TWO_RECORDINGS,
    ),
]
Temporal = Annotated[
    bool,
    typer.Option(
        "--temporal/--no-temporal",
        help="Whether the images around an image have a say in its answer; not where images have no order.",
        rich_help_panel=RECOGNITION,
    ),
]
PlacesPreset = Annotated[str, typer.Option(help=_PRESET_HELP, rich_help_panel=RECOGNITION)]
PlacesFeatures = Annotated[
    str, typer.Option(help=f"Local features: {FEATURE_NAMES}, or onnx:FILE.", rich_help_panel=RECOGNITION)
]
PlacesDescriptor = Annotated[
    str,
    typer.Option(
        help="Image descriptor of the paradigm global-descriptor: hog, small-cnn, or onnx:FILE.",
        rich_help_panel=RECOGNITION,
    ),
]
Exclude = Annotated[
    float | None,
    typer.Option(
        help="Minimum age of a match, seconds.",
        show_default="that of the preset",
        rich_help_panel=RECOGNITION,
    ),
]
PlacesSeed = Annotated[int, typer.Option(help="Seed of every random generator.", rich_help_panel=RECOGNITION)]

# evaluate loops

Matches = Annotated[Path, typer.Argument(help="Table of matches: a matches.csv, or any CSV with query, match, score.")]
LoopTruth = Annotated[
    Path,
    typer.Argument(help="Ground truth: a matrix of revisits (.mat, or .npz with `truth`), or poses (KITTI, TUM)."),
]
FrameTolerance = Annotated[
    int | None,
    typer.Option(
        help="Maximum distance of a match from the nearest true one, images, counted besides 0 and 10.",
        show_default="0 and 10 alone",
    ),
]
MaxDistance = Annotated[float, typer.Option(help="Maximum distance of the two cameras, metres.", rich_help_panel=_RULE)]
MaxAngle = Annotated[
    float, typer.Option(help="Maximum angle between the two viewing directions, degrees.", rich_help_panel=_RULE)
]
MinTimeGap = Annotated[float, typer.Option(help="Minimum time between the two images, seconds.", rich_help_panel=_RULE)]
MinDistance = Annotated[
    float, typer.Option(help="Minimum path length between the two images, metres.", rich_help_panel=_RULE)
]
OneToOne = Annotated[
    bool, typer.Option("--one-to-one", help="Accept only the nearest image as a true match.", rich_help_panel=_RULE)
]
PoseRate = Annotated[
    float | None,
    typer.Option(
        help="Poses per second, which --min-time-gap needs.",
        show_default="by the times of the poses",
        rich_help_panel=_RULE,
    ),
]
MetricsFolder = Annotated[
    Path | None, typer.Option(help="Folder for metrics.json and the curve.", show_default="none is written")
]


def choose_paradigm(paradigm: str | None, matches: Path | None) -> str | None:
    """Return the paradigm, or the name of a file of matches in its place; None where neither is given.

    Raises:
        typer.BadParameter: both are given.
    """
    if matches is None:
        return paradigm
    if paradigm is not None:
        raise typer.BadParameter("takes the place of a paradigm; leave out --paradigm", param_hint="--matches")
    return f"file:{matches.absolute()}"


def require_paradigm(paradigm: str | None, matches: Path | None) -> str:
    """Return the paradigm or the name of a file of matches.

    Raises:
        typer.BadParameter: none or both are given.
    """
    chosen = choose_paradigm(paradigm, matches)
    if chosen is None:
        raise typer.BadParameter(f"expected one of {PARADIGM_NAMES}, or --matches FILE", param_hint="--paradigm")
    return chosen
