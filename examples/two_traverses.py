"""A table over the published sets of two recordings, from whichever of them lie in a folder, beside published values.

    python examples/two_traverses.py --data data --out runs/two_traverses
    python examples/two_traverses.py --data data --paradigms seq-slam --preset published

Each line is one set and one paradigm: recall at 1, 5 and 10 of what the paradigm proposes, beside random images, and
the final answers. What lies in DATA, where to get it and what others publish stands in SETS below. A set that is
missing, or has an odd file, costs one line. The results of each line are in its folder below OUT, with pictures of
right and wrong matches. Sets of single photographs have no order: they are taken without temporal model, and only by
paradigms that look at one image at a time.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from street import arguments

from place_recognition.evaluation.stages import CANDIDATE_COUNTS
from place_recognition.paradigms.registry import PARADIGMS, PRESETS
from slam.apps.places import PlacesOptions, recognize_images
from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.registry import open_images
from slam.errors import RevisitError
from slam.evaluation.traverse_truth_files import TraverseTruthOptions, resolve_traverse_truth

# They look at one image at a time: tracks, sequences and lines mean nothing in photographs without order.
WITHOUT_ORDER = ("global-descriptor",)
TUTORIAL = "https://github.com/stschubert/VPR_Tutorial"
DOWNLOADER = "https://github.com/gmberton/VPR-datasets-downloader"
BOQ = "BoQ, README of https://github.com/amaralibey/Bag-of-Queries"


@dataclass(frozen=True)
class TraverseSet:
    """A published set.

    Attributes:
        name: for the table.
        query, reference: folders of images, below DATA.
        origin: where to get it.
        published: the best value that we could verify, and its source; empty where we found none for these two.
        tolerance, soft: ground truth by equal numbers, and what is tolerated; None for positions in the names. A
            matrix GT.npz beside the folders goes before both.
        is_ordered: whether the images follow each other.
    """

    name: str
    query: str
    reference: str
    origin: str
    published: str = ""
    tolerance: int | None = None
    soft: float | None = None
    is_ordered: bool = True

    def truth(self, data: Path) -> TraverseTruthOptions:
        """How its ground truth is found."""
        matrix = (data / self.query).parent / "GT.npz"
        if matrix.is_file():
            return TraverseTruthOptions(matrix)
        return TraverseTruthOptions(tolerance=self.tolerance, soft=self.soft)


SETS = (
    TraverseSet(
        "Gardens Point, day",
        "gardens_point/day_right",
        "gardens_point/day_left",
        f"{TUTORIAL} or the list in data/README.md",
        tolerance=2,
        soft=5,
    ),
    TraverseSet(
        "Gardens Point, night",
        "gardens_point/night_right",
        "gardens_point/day_right",
        TUTORIAL,
        f"HDC-DELF R@1 0.85, R@5 0.93, R@10 0.95, README of {TUTORIAL}",
        tolerance=0,
        soft=8,  # the tutorial's soft truth
    ),
    TraverseSet(
        "Nordland",
        "nordland/summer",
        "nordland/winter",
        "https://huggingface.co/datasets/Somayeh-h/Nordland",
        f"R@1 0.813, {BOQ} (1 frame)",
        tolerance=1,
    ),
    TraverseSet(
        "St Lucia",
        "st_lucia/images/test/queries",
        "st_lucia/images/test/database",
        DOWNLOADER,
        f"R@1 0.999, {BOQ}",
    ),
    TraverseSet(
        "St Lucia, small",
        "StLucia_small/180809_1545",
        "StLucia_small/100909_0845",
        TUTORIAL,
    ),
    TraverseSet(
        "SFU Mountain",
        "sfu_mountain/dusk",
        "sfu_mountain/dry",
        "https://autonomy.cs.sfu.ca/sfu-mountain-dataset",
        tolerance=1,
    ),
    TraverseSet(
        "Oxford RobotCar",
        "oxford_robotcar/queries",
        "oxford_robotcar/database",
        "https://robotcar-dataset.robots.ox.ac.uk, images named @east@north@.jpg",
    ),
    TraverseSet(
        "MSLS, validation",
        "msls/images/val/queries",
        "msls/images/val/database",
        f"https://www.mapillary.com/dataset/places, with {DOWNLOADER}",
        f"R@1 0.938, {BOQ}",
        is_ordered=False,
    ),
    TraverseSet(
        "Pitts30k, test",
        "pitts30k/images/test/queries",
        "pitts30k/images/test/database",
        DOWNLOADER,
        f"R@1 0.937, {BOQ}",
        is_ordered=False,
    ),
)

HEADER = (
    f"{'set':22}{'paradigm':22}{'query':>6}{'ref.':>7}{'R@1':>7}{'95 %':>14}{'R@5':>7}{'R@10':>7}{'random':>8}"
    f"{'R@P100':>8}{'AUC':>7}{'AP':>7}{'true':>6}{'false':>6}"
)


def main(given: list[str] | None = None) -> int:
    """Print the table. Returns an exit code: 1 where no set could be used."""
    parser = arguments(__doc__)
    parser.add_argument("--data", type=Path, default=Path("data"), help="folder of the sets")
    parser.add_argument("--paradigms", nargs="+", choices=PARADIGMS, default=list(PARADIGMS), metavar="NAME")
    parser.add_argument("--preset", choices=PRESETS, default="default")
    parser.add_argument("--descriptor", default="hog", help="of global-descriptor: hog, or onnx:FILE")
    chosen = parser.parse_args(given)
    print(HEADER)
    lines = 0
    for one in SETS:
        missing = [name for name in (one.query, one.reference) if not (chosen.data / name).is_dir()]
        if missing:
            print(f"{one.name:22}not there: {chosen.data / missing[0]}; get it from {one.origin}")
            continue
        for line in measure(one, chosen):
            print(line, flush=True)
            lines += 1
        print(f"{'':22}published: {one.published or 'no value for these two recordings that we could verify'}")
    return 0 if lines else 1


def measure(one: TraverseSet, chosen: Any) -> Iterator[str]:
    """Match the two recordings of a set by each paradigm; a line for each, or for what is wrong."""
    paradigms = [name for name in chosen.paradigms if one.is_ordered or name in WITHOUT_ORDER]
    try:
        query, reference = (open_images(DatasetSpec(chosen.data / name)) for name in (one.query, one.reference))
        truth = resolve_traverse_truth(one.truth(chosen.data), query, reference)
    except RevisitError as error:
        print(error, file=sys.stderr)
        return
    for paradigm in paradigms:
        options = PlacesOptions(
            chosen.data / one.query,
            paradigm,
            chosen.out / f"{Path(one.query).parts[0]}_{Path(one.query).name}.{paradigm}",
            descriptor=chosen.descriptor,
            overwrite=True,
            preset=chosen.preset,
            reference=chosen.data / one.reference,
            temporal=one.is_ordered,
        )
        try:
            record = recognize_images(options, query, truth, Console(stderr=True), reference)
        except RevisitError as error:
            print(error, file=sys.stderr)
            continue
        counts = f"{len(query):6d}{len(reference):7d}"
        yield f"{one.name:22}{paradigm:22}{counts}{describe(record.result.section)}"


def describe(places: dict[str, Any]) -> str:
    """Format the values of the section `places`; dashes where there is no ground truth."""
    stages, control = places["stages"], places["control"] or {}
    candidates, last = stages["candidates"], stages["temporal"]
    recall = ["-"] * len(CANDIDATE_COUNTS)
    interval, random = "-", "-"
    if candidates:
        recall = [f"{candidates[f'recall_at_{count}']:.3f}" for count in CANDIDATE_COUNTS]
        low, high = candidates["intervals_95"]["recall_at_1"]
        interval = f"{low:.3f}-{high:.3f}"
    if control.get("candidates"):
        random = f"{control['candidates']['recall_at_1']:.3f}"
    names = ("recall_at_100_precision", "area_under_curve", "average_precision")
    final = [f"{last[name]:.3f}" if last else "-" for name in names]
    accepted = ["-" if places[name] is None else places[name] for name in ("true_positives", "false_positives")]
    return (
        f"{recall[0]:>7}{interval:>14}{recall[1]:>7}{recall[2]:>7}{random:>8}{final[0]:>8}{final[1]:>7}{final[2]:>7}"
        f"{accepted[0]:>6}{accepted[1]:>6}"
    )


if __name__ == "__main__":
    sys.exit(main())
