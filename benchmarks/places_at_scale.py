"""Growth of query time, recall and memory with the map, up to a million images: a table and a log-log plot.

    python benchmarks/places_at_scale.py IMAGES... --out DIR [--sizes 10000 100000 1000000] [--queries 100]

IMAGES are folders of images in the natural order of their names, or KITTI sequence folders; they are the queries, in
their order, and all descriptors and words of the maps are drawn from them. Maps are filled through their own methods,
not by recognising a million images. Query time is the time of a whole image without its local features, which do not
depend on the map. Each paradigm runs in a process of its own, whose peak of resident memory is reported.
The features of older images go to a temporary file (TMPDIR) of up to 35 kB for each image.
"""

import argparse
import resource
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from command_line import existing, run_script
from map_fillers import FILLERS, Material, RecalledFeatures
from numpy.typing import NDArray
from place_benchmarks import image_files

from place_recognition.image_processing.surf import Surf

WARM = 40  # images before the measured ones: tracks and sequences must have begun, and answers wait for 15 images


@dataclass(frozen=True)
class Row:
    """Measurements of one paradigm at one size of the map.

    Attributes:
        paradigm: name of the paradigm.
        images: number of images in the map.
        words: number of words in the map, or in the vocabulary.
        median, mean: median and mean of the query times, ms.
        recall: share of nearest words that are those of an exhaustive search; NaN where the search is exhaustive.
        memory: peak of resident memory, GB.
        disk: size of the temporary file, GB.
        filling: seconds spent on filling the map so far.
    """

    paradigm: str
    images: int
    words: int
    median: float
    mean: float
    recall: float
    memory: float
    disk: float
    filling: float


def grow(name: str, folders: list[Path], sizes: list[int], queries: int) -> list[Row]:
    """Fill the map of one paradigm to each size in turn and measure it."""
    files = [file for folder in folders for file in image_files(folder)][: queries + WARM]
    images = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files]
    surf = Surf()
    material = Material([surf.extract(image) for image in images])
    features = RecalledFeatures(surf.kind, material.features)
    filler = FILLERS[name](features, material)
    rows, filling = [], 0.0
    for size in sizes:
        begin = time.perf_counter()
        filler.fill(size)
        filling += time.perf_counter() - begin
        times = ask(filler.recognizer, images, size)
        rows.append(report(name, filler, (size, filling), times))
    return rows


def ask(recognizer: Any, images: list[NDArray[np.uint8]], size: int) -> NDArray[np.float64]:
    """Milliseconds for each of the images after the first ones."""
    times = []
    for k, image in enumerate(images):
        begin = time.perf_counter()
        recognizer.observe(size + k, image, float(size + k))
        times.append(1e3 * (time.perf_counter() - begin))
    return np.array(times[WARM:])


def report(name: str, filler: Any, fill: tuple[int, float], times: NDArray[np.float64]) -> Row:
    """Measure and print the row of a size at once: the next one may take minutes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    words, disk = filler.recognizer.word_count, filler.history.images.disk_bytes / 1e9
    row = Row(name, fill[0], words, float(np.median(times)), float(times.mean()), filler.recall(), peak, disk, fill[1])
    print(
        f"{row.paradigm:20s} {row.images:9,d} images {row.words:11,d} words  {row.median:7.2f} ms median "
        f"{row.mean:7.2f} ms mean  recall {row.recall:.3f}  {row.memory:5.2f} GB  {row.disk:5.1f} GB on disk  "
        f"filled in {row.filling:5.0f} s",
        flush=True,
    )
    return row


def plot(rows: list[Row], path: Path) -> None:
    """Query time over the size of the map, both logarithmic, with the bar of three times the first one."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 5))
    for name in dict.fromkeys(row.paradigm for row in rows):
        mine = [row for row in rows if row.paradigm == name]
        sizes, means = [row.images for row in mine], [row.mean for row in mine]
        (line,) = axes.loglog(sizes, means, "o-", label=name)
        axes.loglog([sizes[0], sizes[-1]], [3 * means[0]] * 2, ":", color=line.get_color(), linewidth=1)
    axes.set_xlabel("images in the map")
    axes.set_ylabel("mean query time without local features [ms]")
    axes.set_title("Dotted: three times the time at the smallest map")
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=150, bbox_inches="tight")


def show_ratios(rows: list[Row]) -> None:
    """Print the ratio of the query times in the largest and the smallest map."""
    for name in dict.fromkeys(row.paradigm for row in rows):
        mine = [row for row in rows if row.paradigm == name]
        small, large = mine[0], mine[-1]
        print(
            f"{name:20s} {large.images:,d} against {small.images:,d} images: "
            f"{large.median / small.median:.2f} times by median, {large.mean / small.mean:.2f} by mean"
        )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", type=existing, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sizes", type=int, nargs="+", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--queries", type=int, default=100)
    parser.add_argument("--paradigms", nargs="+", choices=FILLERS, default=list(FILLERS))
    arguments = parser.parse_args()

    arguments.out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for name in arguments.paradigms:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
            rows += process.submit(grow, name, arguments.images, sorted(arguments.sizes), arguments.queries).result()
    show_ratios(rows)
    plot(rows, arguments.out / "places_at_scale.png")


if __name__ == "__main__":
    run_script(main)
