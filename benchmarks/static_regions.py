"""Place recognition with things in the image that are no place: a bonnet, burnt-in text, dirt, black bars, a logo.

    python benchmarks/static_regions.py DIR [--paradigm NAME ...] [--thing NAME ...]

DIR is a folder of images, or a KITTI root with one sequence, that revisits places, with `loops*.npz`, its true loops.
The things are painted into its images. For each paradigm and thing there are two lines: static regions found and left
out, and the control without that.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray

from place_recognition.image_processing.static_regions import StaticRegionConfig
from place_recognition.paradigms.registry import ParadigmsConfig
from slam.datasets.formats.image_sequence import ImageSequence
from slam.datasets.formats.kitti import open_image_sequence
from slam.evaluation.place_metrics import evaluate_places
from slam.pipeline.place_recognition import RecognizerFactory, run_recognizer

Image = NDArray[np.uint8]
Paint = Callable[[Image, int], None]

PARADIGMS = ("sequence-histograms", "dynamic-sequences", "hierarchical-places", "tracked-words")


def paint_nothing(image: Image, index: int) -> None:
    """Leave the image as it is."""


def paint_bonnet(image: Image, index: int) -> None:
    """A finely textured strip over the lowest quarter."""
    height, width = image.shape
    cells = np.random.default_rng(1).integers(0, 255, (height // 6, width // 6)).astype(np.uint8)
    image[3 * height // 4 :] = cv2.resize(cells, (width, height), interpolation=cv2.INTER_CUBIC)[3 * height // 4 :]


def paint_text(image: Image, index: int) -> None:
    """Two lines of a dash-cam: a clock that counts tenths of seconds, and a speed."""
    height, scale = image.shape[0], image.shape[1] / 1400
    clock = f"2024/03/05 12:{index // 600:02d}:{index // 10 % 60:02d}.{index % 10} N 49.0 E 8.4"
    speed = f"DASHCAM {40 + index // 7 % 20:03d} KM/H"
    for text, row in ((clock, height - 15), (speed, round(40 * scale) + 10)):
        cv2.putText(image, text, (20, row), cv2.FONT_HERSHEY_SIMPLEX, scale, 255, max(round(2 * scale), 1))


def paint_dirt(image: Image, index: int) -> None:
    """Forty dark, blurred specks."""
    height, width = image.shape
    rng = np.random.default_rng(0)
    light = np.ones(image.shape, np.float32)
    for _ in range(40):
        center = int(rng.integers(width)), int(rng.integers(height))
        cv2.circle(light, center, int(rng.integers(3, 14)), 0.2, -1)
    image[:] = (image * cv2.GaussianBlur(light, (0, 0), 2)).astype(np.uint8)


def paint_letterbox(image: Image, index: int) -> None:
    """Black bars over an eighth of the height at the top and at the bottom."""
    bar = image.shape[0] // 8
    image[:bar] = image[-bar:] = 0


def paint_logo(image: Image, index: int) -> None:
    """A half-transparent word."""
    scale = image.shape[1] / 800
    shape = np.zeros_like(image)
    place = round(0.7 * image.shape[1]), round(50 * scale)
    cv2.putText(shape, "REVISIT", place, cv2.FONT_HERSHEY_SIMPLEX, scale, 255, max(round(3 * scale), 1))
    image[shape > 0] = image[shape > 0] // 2 + 127


THINGS: dict[str, Paint] = {
    "clean": paint_nothing,
    "bonnet": paint_bonnet,
    "text": paint_text,
    "dirt": paint_dirt,
    "letterbox": paint_letterbox,
    "logo": paint_logo,
}


@dataclass(frozen=True)
class PaintedImages:
    """Images of a recording with something painted into each."""

    images: ImageSequence
    paint: Paint

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: int) -> Image:
        """Image (H, W) uint8 with the painting."""
        image = self.images[index].copy()
        self.paint(image, index)
        return image


def measure(images: PaintedImages, paradigm: str, enabled: bool, truth: NDArray[np.bool_]) -> str:
    """Run one paradigm and return its figures as text."""
    factory = RecognizerFactory(paradigm, ParadigmsConfig(), static_regions=StaticRegionConfig(enabled=enabled))
    run = run_recognizer(images, factory, lambda done, count: None, lambda: False)
    places = evaluate_places(paradigm, sorted(run.beliefs, key=lambda belief: belief.query), truth, None).section
    tolerant = places["tolerance_10"]
    assert isinstance(tolerant, dict)
    names = ("recall_at_100_precision", "true_positives", "false_positives")
    recall, true, false = (places[name] for name in names)
    return f"{recall:9.3f} {true:6d} {false:6d} {tolerant['false_positives']:8d} {100 * run.static_ratio:8.1f} %"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=existing)
    parser.add_argument("--paradigm", nargs="+", default=PARADIGMS)
    parser.add_argument("--thing", nargs="+", default=list(THINGS))
    given = parser.parse_args(arguments)
    images = open_image_sequence(given.root)
    truth = np.load(next(iter(sorted(given.root.glob("loops*.npz")))))["truth"].astype(bool)
    print(f"{'paradigm':20} {'thing':10} {'found':6} {'R@P100':>9} {'true':>6} {'false':>6} {'+-10':>8} {'static':>10}")
    for paradigm in given.paradigm:
        for thing in given.thing:
            for enabled in (True, False):
                figures = measure(PaintedImages(images, THINGS[thing]), paradigm, enabled, truth)
                print(f"{paradigm:20} {thing:10} {'yes' if enabled else 'no':6} {figures}", flush=True)


if __name__ == "__main__":
    run_script(main)
