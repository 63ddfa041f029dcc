"""Add a paradigm of your own: a class with `observe`, `finish`, `state` and `restore`, and nothing to inherit from.

    python examples/6_own_paradigm.py [--out runs/examples]

Leaves 6_own_paradigm.png: its precision and recall beside those of a paradigm of the chapter.
"""

import cv2
import numpy as np
from street import arguments, street

from place_recognition.evaluation.precision_recall import precision_recall
from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.image_processing.surf import Surf
from place_recognition.paradigms.registry import make_recognizer
from place_recognition.recognizer import Belief
from slam.datasets.formats.registry import open_dataset
from slam.report.place_recognition_figures import plot_precision_recall
from slam.report.trajectory_figure import save_png
from slam.simulation import loop_truth


class BrightnessPattern:
    """Recognises a place by the light and dark areas of its image (a PlaceRecognizer)."""

    def __init__(self, threshold=0.9, exclusion=30):
        """Accept a cosine of `threshold`; compare with no image among the latest `exclusion`."""
        self.threshold, self.exclusion, self._vectors = threshold, exclusion, []

    def observe(self, image_id, image, distance_travelled_m):
        """Return the belief of an image (H, W) uint8, then add the image to the map."""
        cells = cv2.resize(image, (32, 8), interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
        vector = (cells - cells.mean()) / (np.linalg.norm(cells - cells.mean()) + 1e-9)
        belief = self._believe(image_id, np.array([v @ vector for v in self._vectors[: -self.exclusion]]))
        self._vectors.append(vector)
        return [belief]

    def finish(self):
        """Return no further beliefs."""
        return []

    def state(self):
        """Return everything that changes from image to image, for a checkpoint."""
        return {"vectors": list(self._vectors)}

    def restore(self, state):
        """Continue from a state."""
        self._vectors = list(state["vectors"])

    def _believe(self, query, cosines):
        if not len(cosines):
            return Belief(query, None, 0.0, accepted=False)
        best = int(cosines.argmax())
        return Belief(query, best, float(cosines[best]), accepted=bool(cosines[best] >= self.threshold))


given = arguments(__doc__).parse_args()
drive = open_dataset(street(given))
truth = loop_truth(drive.ground_truth).astype(bool)

recognisers = {
    "brightness-pattern": BrightnessPattern(),
    "tracked-words": make_recognizer("tracked-words", FeatureCache(Surf())),
}
curves = {}
for name, recogniser in recognisers.items():
    beliefs = [b for frame in drive for b in recogniser.observe(frame.index, frame.left, float("nan"))]
    curves[name] = precision_recall(beliefs + recogniser.finish(), truth)
    print(f"{name}: R@P100 {curves[name].recall_at_full_precision:.3f}")
save_png(plot_precision_recall(curves, "two laps of a simulated street"), given.out / "6_own_paradigm.png")
