"""What the commands share: exit codes, names that help lists, and options that mean the same everywhere."""

from pathlib import Path
from typing import Annotated

import typer

EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 1, 2, 130

Out = Annotated[Path, typer.Option("--out", help="Folder for the results.", show_default=True)]
# Named here and not taken from the catalogue, which is slow to import.
PARADIGM_NAMES = (
    "sequence-histograms, dynamic-sequences, hierarchical-places, tracked-words, pixel-sequences, global-descriptor"
)
FEATURE_NAMES = "surf, surf-oriented, sift, orb"
BACK_END_NAMES = "none, huber, dcs, switchable, gnc, pcm, pcm+gnc"
KIND_NAMES = "kitti, euroc, tum-rgbd, own-camera, bag, malaga, new-college, city-centre, images"
Kind = Annotated[str | None, typer.Option(help=f"Of the source, if it is not recognised: {KIND_NAMES}.")]
Topic = Annotated[list[str] | None, typer.Option(help="Of a bag: the left camera's, then the right one's.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an earlier run in the output folder.")]
