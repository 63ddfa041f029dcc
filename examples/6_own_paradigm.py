"""Add a paradigm of your own: a class with `observe` and `finish`, and nothing to inherit from.

    python examples/6_own_paradigm.py [--out runs/examples]

Leaves 6_own_paradigm.png: its precision and recall beside those of a paradigm of the chapter.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from place_recognition.evaluation.precision_recall import precision_recall
from place_recognition.image_processing.features import SharedFeatures
from place_recognition.image_processing.surf import Surf
from place_recognition.paradigms.catalogue import build
from place_recognition.recognizer import Belief
from slam.datasets.open import open_drive
from slam.report.figures import save_png
from slam.report.place_figures import precision_recall_picture
from slam.simulation import DriveSpec, loop_truth, simulate


class BrightnessPattern:
    """Recognises a place by how light and shade lie in the image (a PlaceRecognizer)."""

    def __init__(self, threshold=0.9, exclusion=30):
        """Accept a cosine of `threshold`; compare with no image among the latest `exclusion`."""
        self.threshold, self.exclusion, self._vectors = threshold, exclusion, []

    def observe(self, image_id, image, travelled):
        """Answer for an image (H, W) uint8, then remember it."""
        cells = cv2.resize(image, (32, 8), interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
        vector = (cells - cells.mean()) / (np.linalg.norm(cells - cells.mean()) + 1e-9)
        belief = self._believe(image_id, np.array([v @ vector for v in self._vectors[: -self.exclusion]]))
        self._vectors.append(vector)
        return [belief]

    def finish(self):
        """Nothing is left unanswered."""
        return []

    def _believe(self, query, cosines):
        if not len(cosines):
            return Belief(query, None, 0.0, accepted=False)
        best = int(cosines.argmax())
        return Belief(query, best, float(cosines[best]), accepted=bool(cosines[best] >= self.threshold))


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--out", type=Path, default=Path("runs/examples"), help="folder of the results")
parser.add_argument("--width", type=int, default=620, help="of the images, pixels")
parser.add_argument("--speed", type=float, default=10.0, help="of the car, metres a second; it sees ten images in one")
given = parser.parse_args()

spec = DriveSpec("circle", laps=2, length=200.0, speed=given.speed, width=given.width, height=given.width * 376 // 1241)
drive = open_drive(simulate(spec, given.out / f"drive_{given.width}_{given.speed:g}"))
truth = loop_truth(drive.ground_truth).astype(bool)

recognisers = {
    "brightness-pattern": BrightnessPattern(),
    "tracked-words": build("tracked-words", SharedFeatures(Surf())),
}
curves = {}
for name, recogniser in recognisers.items():
    beliefs = [b for frame in drive for b in recogniser.observe(frame.index, frame.left, float("nan"))]
    curves[name] = precision_recall(beliefs + recogniser.finish(), truth)
    print(f"{name}: R@P100 {curves[name].recall_at_full_precision:.3f}")
save_png(precision_recall_picture(curves, "two laps of a simulated street"), given.out / "6_own_paradigm.png")
