"""Exit codes, and the options and names that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

# 130 is what shells report for a program that was ended by Ctrl-C.
EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 1, 2, 130

# Written out here because the registries are slow to import, and help must answer at once. A test compares these lists
# with the registries.
PARADIGM_NAMES = (
    "sequence-histograms, dynamic-sequences, hierarchical-places, tracked-words, pixel-sequences, global-descriptor"
)
FEATURE_NAMES = "surf, surf-oriented, sift, orb"
BACK_END_NAMES = "none, huber, dcs, switchable, gnc, pcm, pcm+gnc"
FORMAT_NAMES = "kitti, euroc, tum-rgbd, own-camera, bag, malaga, new-college, city-centre, images"

# Groups of options in the help of commands that have many.
INPUT, RECOGNITION, BACK_END, OUTPUT = "Input", "Place recognition", "Odometry and back end", "Output"

# The defaults of RunConfig, for help: without an option its value comes from --config, and without that from here.
DEFAULT_PARADIGM, DEFAULT_FEATURES, DEFAULT_BACK_END = "tracked-words", "surf", "pcm+gnc"

Out = Annotated[Path, typer.Option("--out", help="Folder for the results.", show_default=True, rich_help_panel=OUTPUT)]
Overwrite = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace earlier results in the output folder.", rich_help_panel=OUTPUT),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.", rich_help_panel=OUTPUT)]
Sequence = Annotated[
    str | None,
    typer.Option(
        help="Name of the sequence, for example 00.",
        show_default="the only one of the source",
        rich_help_panel=INPUT,
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
    typer.Option(
        "--fps",
        help="Images per second.",
        show_default="by the times of the source",
        rich_help_panel=INPUT,
    ),
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
