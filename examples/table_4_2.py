"""Table 4.2 of the chapter: every paradigm over the five recordings, from their original downloads.

    python examples/table_4_2.py --data data --truth TRUTH --out runs/table_4_2

DATA holds what was unpacked: `kitti` (sequences 00 and 05), `malaga_6L`, `new_college`, `city_centre`;
`data/README.md` says where to get them. TRUTH holds the matrices that the chapter's authors published:
`groundTruthKITTI00.mat`, `groundTruthKITTI05.mat`, `groundTruthMalaga6L.mat`, `groundTruthNC.mat`,
`groundTruthCityCentre.mat`. What is missing is named and left out. Each cell is kept in OUT and not computed again.
Three columns stand beside one another: the published value, and ours with the published preset and by default.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

from rich.console import Console

from place_recognition.paradigms.registry import PARADIGMS
from slam.apps.places import PlacesOptions, recognize_images
from slam.datasets.formats.image_sequence import ImageSequence
from slam.datasets.formats.kitti import open_image_sequence
from slam.datasets.formats.place_datasets import open_city_centre, open_malaga, open_new_college
from slam.errors import DataError, RevisitError
from slam.evaluation.revisit_truth_files import RevisitTruth, check_truth_size, read_revisit_truth
from slam.io.files import atomic_writer
from slam.io.metrics import read_metrics
from slam.report.recall_table import DATASETS, PRESETS, RecallTable, format_latex, format_text, plot_table
from slam.report.style import save_png

# The papers' rule: an image less old is no revisit. The published presets bring their own.
EXCLUDE_S = {"default": 40.0, "published": None}


@dataclass(frozen=True)
class Recording:
    """A data set of the table.

    Attributes:
        folder: its name below DATA.
        open: reads it as the chapter does.
        truth: its matrix below TRUTH.
    """

    folder: str
    open: Callable[[Path], ImageSequence]
    truth: str


RECORDINGS = dict(
    zip(
        DATASETS,
        (
            Recording("kitti", lambda root: open_image_sequence(root, "00"), "groundTruthKITTI00.mat"),
            Recording("kitti", lambda root: open_image_sequence(root, "05"), "groundTruthKITTI05.mat"),
            Recording("malaga_6L", open_malaga, "groundTruthMalaga6L.mat"),
            Recording("new_college", open_new_college, "groundTruthNC.mat"),
            Recording("city_centre", open_city_centre, "groundTruthCityCentre.mat"),
        ),
        strict=True,
    )
)


def main(arguments: list[str] | None = None) -> int:
    """Fill the table. Returns an exit code."""
    given = parser().parse_args(arguments)
    unknown = sorted(set(given.paradigms) - set(PARADIGMS))
    if unknown:
        print(f"unknown paradigm {unknown[0]}: expected some of {', '.join(PARADIGMS)}", file=sys.stderr)
        return 2
    for path in (given.data, given.truth):
        if not path.is_dir():
            print(f"{path}: expected a folder, found none; check the path", file=sys.stderr)
            return 1
    messages, measured, problems = Console(stderr=True), {}, []
    for name, recording in RECORDINGS.items():
        try:
            images, truth = opened(recording, given.data, given.truth)
            for paradigm, preset in product(given.paradigms, PRESETS):
                folder = given.out / name / (paradigm if preset == "default" else f"{paradigm}-{preset}")
                options = PlacesOptions(given.data / recording.folder, paradigm, folder, preset=preset, overwrite=True)
                measured[paradigm, preset, name] = 100 * cell(options, images, truth, messages)
        except RevisitError as error:
            problems.append(f"{name}: left out. {error}")
    write(RecallTable(tuple(given.paradigms), measured), given.out)
    print("\n".join(problems), file=sys.stderr)
    return 0 if measured else 1


def parser() -> argparse.ArgumentParser:
    """Parse the command line."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--data", type=Path, default=Path("data"))
    made.add_argument("--truth", type=Path, required=True)
    made.add_argument("--out", type=Path, default=Path("runs/table_4_2"))
    made.add_argument("--paradigms", nargs="+", default=list(PARADIGMS), help="some of them; all by default")
    return made


def opened(recording: Recording, data: Path, truth: Path) -> tuple[ImageSequence, RevisitTruth]:
    """Open the images and the ground truth of one recording.

    Raises:
        DataError: either is missing or damaged, or they do not belong together.
    """
    root = data / recording.folder
    if not root.is_dir():
        raise DataError(f"{root}: expected the recording, found nothing; data/README.md says where to get it")
    images, known = recording.open(root), read_revisit_truth(truth / recording.truth)
    check_truth_size(known, len(images), root)
    return images, known


def cell(options: PlacesOptions, images: ImageSequence, truth: RevisitTruth, messages: Console) -> float:
    """Return R@P100 of one paradigm on one recording, read from an earlier run or computed now."""
    kept = options.out / "metrics.json"
    if not kept.is_file():
        messages.print(f"{images.name}: {options.paradigm}, {options.preset}")
        options = replace(options, exclude=EXCLUDE_S[options.preset])
        if recognize_images(options, images, truth, messages).metrics["interrupted"]:
            raise KeyboardInterrupt
    places = read_metrics(kept)["places"]
    assert isinstance(places, dict)
    return float(places["recall_at_100_precision"])


def write(table: RecallTable, out: Path) -> None:
    """Print the table, and write it as text, LaTeX and picture."""
    out.mkdir(parents=True, exist_ok=True)
    for name, text in (("table_4_2.txt", format_text(table) + "\n"), ("table_4_2.tex", format_latex(table))):
        with atomic_writer(out / name) as file:
            file.write(text)
    save_png(plot_table(table), out / "table_4_2.png")
    print(format_text(table))


if __name__ == "__main__":
    sys.exit(main())
