"""Have I been here? One paradigm of place recognition on the images of one camera, without odometry.

    python examples/3_recognise_places.py [--paradigm tracked-words] [--out runs/examples]

Leaves 3_recognise_places.png (the matrix, the detections and the truth: Figures 4.8, 4.7 and 4.9 of the chapter, and
4.12 where a paradigm has a filter) and 3_precision_recall.png (Figure 4.16).
"""

import numpy as np
from street import arguments, street

from place_recognition.evaluation.precision_recall import accepted_counts, precision_recall
from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.image_processing.surf import Surf
from place_recognition.paradigms.registry import PARADIGMS, make_recognizer
from slam.datasets.formats.registry import open_dataset
from slam.report.place_recognition_figures import plot_places, plot_precision_recall
from slam.report.style import save_png
from slam.simulation import loop_truth

parser = arguments(__doc__)
parser.add_argument("--paradigm", choices=PARADIGMS, default="tracked-words", help="how places are recognised")
given = parser.parse_args()
drive = open_dataset(street(given))

rows = MatrixRecorder()  # keeps the similarities, for the picture only
recogniser = make_recognizer(given.paradigm, FeatureCache(Surf()), rows=rows)
beliefs = []
for frame in drive:
    # A sequence paradigm returns beliefs late, when a sequence ends. NaN: the distance is not measured here.
    beliefs += recogniser.observe(frame.index, frame.left, distance_travelled_m=float("nan"))
beliefs += recogniser.finish()

truth = loop_truth(drive.ground_truth).astype(bool)  # (N, N): row = query, column = earlier image
curve = precision_recall(beliefs, truth)
right, wrong = accepted_counts(beliefs, truth)
print(f"{given.paradigm}: {right} true and {wrong} false detections, R@P100 {curve.recall_at_full_precision:.3f}")

matrices = {stage: rows.matrix(len(drive), stage) for stage in rows.stages}
detections = np.array([(b.query, b.match) for b in beliefs if b.accepted], dtype=np.int64).reshape(-1, 2)
save_png(plot_places(given.paradigm, matrices, detections, truth), given.out / "3_recognise_places.png")
curves = {given.paradigm: curve}
save_png(plot_precision_recall(curves, "two laps of a simulated street"), given.out / "3_precision_recall.png")
