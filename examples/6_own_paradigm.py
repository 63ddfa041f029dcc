"""Add a paradigm of your own: a class with `observe`, `finish`, `state` and `restore`, and nothing to inherit from.

    python examples/6_own_paradigm.py [--out runs/examples]

It proposes earlier images; geometric verification and decision are those of all paradigms. Leaves 6_own_paradigm.png:
precision and recall of its own score, of its final answer, and of random images, which end in the same stages.
"""

import cv2
import numpy as np
from street import arguments, street

from place_recognition.belief.likelihood_ratios import OWN_SCORES, RatioTable
from place_recognition.evaluation.precision_recall import precision_recall
from place_recognition.evaluation.stages import stage_answers
from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.image_processing.surf import Surf
from place_recognition.paradigms.registry import PARADIGMS, make_control, make_recognizer
from place_recognition.recognizer import propose_best
from slam.datasets.formats.registry import open_dataset
from slam.report.place_recognition_figures import plot_precision_recall
from slam.report.style import save_png
from slam.simulation import loop_truth


class BrightnessPattern:
    """Proposes images whose light and dark areas lie as in the query (a Proposer)."""

    def __init__(self):
        """Make a proposer that has seen nothing."""
        self._vectors = []

    def observe(self, image):
        """Return the proposals for an ObservedImage, then add it to the map."""
        cells = cv2.resize(image.pixels, (32, 8), interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
        vector = (cells - cells.mean()) / (np.linalg.norm(cells - cells.mean()) + 1e-9)
        # Later images show what the camera still sees; they are no revisit.
        cosines = np.array([earlier @ vector for earlier in self._vectors[: image.last_matchable + 1]])
        self._vectors.append(vector)
        return [propose_best(image, cosines, max_count=10, min_separation=4)]

    def finish(self):
        """Return no further proposals: each image was answered at once."""
        return []

    def state(self):
        """Return everything that changes from image to image, for a checkpoint."""
        return {"vectors": list(self._vectors)}

    def restore(self, state):
        """Continue from a state."""
        self._vectors = list(state["vectors"])


NAME = "brightness-pattern"
PARADIGMS[NAME] = lambda history, features, config, rows: BrightnessPattern()
# Powers of ten by which each score is likelier at a revisit than at a new place. As long as nobody measured them: 0.
OWN_SCORES[NAME] = RatioTable((0.0,), (0.0,))

given = arguments(__doc__).parse_args()
drive = open_dataset(street(given))
truth = loop_truth(drive.ground_truth).astype(bool)


def recognise(recogniser):
    """Show the drive to a recogniser and return its beliefs."""
    beliefs = [b for frame in drive for b in recogniser.observe(frame.index, frame.left, float("nan"))]
    return beliefs + recogniser.finish()


features = FeatureCache(Surf())
beliefs, control = recognise(make_recognizer(NAME, features)), recognise(make_control(features))
answers = {f"{NAME}, own score": stage_answers(beliefs, "own"), NAME: beliefs, "random images": control}
curves = {name: precision_recall(answer, truth) for name, answer in answers.items()}
for name, curve in curves.items():
    print(f"{name}: R@P100 {curve.recall_at_full_precision:.3f}")
save_png(plot_precision_recall(curves, "two laps of a simulated street"), given.out / "6_own_paradigm.png")
