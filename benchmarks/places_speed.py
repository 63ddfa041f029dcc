"""Time of each paradigm for an image once the map is large: a table of medians and 99th percentiles.

    python benchmarks/places_speed.py IMAGES... [--map 4500] [--measured 200] [--paradigms NAME...]

IMAGES are folders of images in the natural order of their names, or KITTI sequence folders. The map is grown by showing
them again and again, each time as another camera on another day would see them: mirrored or not, zoomed, turned a
little, brighter or darker, so that the features differ. Then the first day is shown once more and measured.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray
from place_benchmarks import Stopwatch, image_files

from place_recognition import staged_recognizer
from place_recognition.belief.place_filter import PlaceFilter
from place_recognition.image_processing.local_features import FeatureCache, LocalFeatures
from place_recognition.image_processing.surf import Surf
from place_recognition.map.inverted_index import InvertedIndex
from place_recognition.map.place_map import PlaceSegmentation
from place_recognition.paradigms import hierarchical_places
from place_recognition.paradigms.registry import PARADIGMS, make_recognizer
from place_recognition.verification.present_view import CameraSteps, PresentView
from place_recognition.vocabulary import word_tracking as tracking
from place_recognition.vocabulary.word_tree import HybridWordIndex

Image = NDArray[np.uint8]

SIZE = (1241, 376)
STEP = 1.0  # metres from image to image
# stage: where its function is looked up when the recogniser runs
STAGES: dict[str, tuple[Any, str]] = {
    "features": (FeatureCache, "get"),
    "present view": (PresentView, "advance"),
    "steps of the camera": (CameraSteps, "add"),
    "optical flow": (tracking, "optical_flow"),
    "guided selection": (tracking, "select_guided"),
    "nearest words": (HybridWordIndex, "nearest"),
    "words added": (HybridWordIndex, "add"),
    "place formation": (PlaceSegmentation, "add"),
    "words of a place": (hierarchical_places, "grow_gas"),
    "inverted index": (InvertedIndex, "cosines"),
    "candidate verification": (staged_recognizer, "verify_candidates"),
    "forward step": (PlaceFilter, "add"),
    "backward steps": (PlaceFilter, "posterior"),
}


@dataclass(frozen=True)
class Day:
    """How one camera sees the world on one day.

    Attributes:
        matrix: affine transformation (2, 3) from its pixels to the original ones.
        exposure: factor of the grey levels.
        mirrored: whether left and right are exchanged, which makes another town.
    """

    matrix: NDArray[np.float64]
    exposure: float
    mirrored: bool

    @classmethod
    def random(cls, number: int) -> "Day":
        """Return the day of a number; its changes are small enough for tracks to continue."""
        rng = np.random.default_rng(number)
        centre = (SIZE[0] / 2 + rng.uniform(-60, 60), SIZE[1] / 2 + rng.uniform(-15, 15))
        matrix = cv2.getRotationMatrix2D(centre, rng.uniform(-3, 3), rng.uniform(1.0, 1.35))
        return cls(matrix, float(rng.uniform(0.7, 1.25)), bool(number % 2))

    def later(self) -> "Day":
        """Return the same route at a later time: the camera a little aside, other light."""
        shifted = self.matrix + np.array([[0.01, 0.0, 9.0], [0.0, 0.01, 4.0]])
        return replace(self, matrix=shifted, exposure=0.85 * self.exposure)

    def see(self, image: Image) -> Image:
        """The image (H, W) as this camera sees it, of SIZE."""
        scaled = cv2.resize(image, SIZE) if image.shape[::-1] != SIZE else image
        seen = cv2.warpAffine(scaled, self.matrix, SIZE, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        seen = np.clip(self.exposure * seen.astype(np.float32), 0, 255).astype(np.uint8)
        return np.ascontiguousarray(seen[:, ::-1]) if self.mirrored else seen


class CachedFeatures:
    """Extracts features (a FeatureExtractor) and keeps those of the images that fill the map, for all paradigms."""

    def __init__(self) -> None:
        self._surf = Surf()
        self._known: list[LocalFeatures] = []
        self._next: int | None = None

    @property
    def kind(self) -> str:
        """Name of the descriptor."""
        return self._surf.kind

    def begin(self) -> None:
        """Begin again with the first image; the images come in the same order as before."""
        self._next = 0

    def measure(self) -> None:
        """Extract features instead of taking them from the cache from now on."""
        self._next = None

    def extract(self, image: Image, mask: Image | None = None) -> LocalFeatures:
        """Features of an image."""
        if self._next is None:
            return self._surf.extract(image, mask)
        if self._next == len(self._known):
            self._known.append(self._surf.extract(image, mask))
        self._next += 1
        return self._known[self._next - 1]


def drive(images: list[Image], count: int) -> Iterator[Image]:
    """Yield `count` images: all of them as seen on one day, then all on another day, and so on."""
    for k in range(count):
        yield Day.random(k // len(images)).see(images[k % len(images)])


def measure(name: str, images: list[Image], sizes: tuple[int, int], features: CachedFeatures, watch: Stopwatch) -> None:
    """Fill a map of sizes[0] images, then measure sizes[1] more."""
    watch.running = False
    for stage, (owner, function) in STAGES.items():
        watch.watch(stage, owner, function)
    recognizer = make_recognizer(name, FeatureCache(features))
    observe = watch.timed("all", recognizer.observe)
    features.begin()
    for k, image in enumerate(drive(images, sizes[0])):
        observe(k, image, STEP * k)
    features.measure()
    watch.running = True
    for k, image in enumerate(images[: sizes[1]], start=sizes[0]):
        observe(k, Day.random(0).later().see(image), STEP * k)
    watch.stop()


def show(name: str, watch: Stopwatch, measured: int) -> None:
    """Print the times of one paradigm."""
    print(f"\n{name:24s} {'median':>8s} {'p99':>8s} {'an image':>9s}  ms")
    for stage in [*STAGES, "all"]:
        calls = np.array(watch.milliseconds[stage])
        if len(calls):
            median, rare = np.percentile(calls, [50, 99])
            print(f"  {stage:22s} {median:8.2f} {rare:8.2f} {calls.sum() / measured:9.2f}", flush=True)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", type=existing, nargs="+")
    parser.add_argument("--map", type=int, default=4500, help="images in the map before the measured ones")
    parser.add_argument("--measured", type=int, default=200, help="images that are measured")
    parser.add_argument("--paradigms", nargs="+", choices=PARADIGMS, default=list(PARADIGMS)[:4])
    parser.add_argument("--cpu", action="store_true", help="time of this process only, on a machine that others use")
    arguments = parser.parse_args()

    files = [file for folder in arguments.images for file in image_files(folder)]
    images = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files]
    measured = min(arguments.measured, len(images))
    features = CachedFeatures()
    for name in arguments.paradigms:
        measure(name, images, (60, 20), CachedFeatures(), Stopwatch())  # compile, or load what was compiled
        watch = Stopwatch(time.process_time if arguments.cpu else time.perf_counter)
        measure(name, images, (arguments.map, measured), features, watch)
        show(name, watch, measured)


if __name__ == "__main__":
    run_script(main)
