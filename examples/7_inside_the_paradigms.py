"""Intermediate results of the recognisers, drawn from one drive as in Figures 4.3, 4.4, 4.11 and 4.13 to 4.15.

    python examples/7_inside_the_paradigms.py [--out runs/examples]

Leaves 7_inside_the_paradigms.png: edges of an image, its words, where sequences end, and what a revisit votes for.
"""

import cv2
import numpy as np
from street import arguments, street

from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from place_recognition.image_processing.global_descriptors import cell_histograms
from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.image_processing.surf import Surf
from place_recognition.map.sequence_map import FixedDistanceSegmentation, WordVariance
from place_recognition.paradigms.registry import make_recognizer
from place_recognition.vocabulary.vocabulary import default_vocabulary, word_histogram
from slam.datasets.formats.registry import open_dataset
from slam.report import style
from slam.report.style import new_figure, save_png
from slam.simulation import loop_truth

given = arguments(__doc__).parse_args()
drive = open_dataset(street(given))
images, poses = [frame.left for frame in drive], drive.ground_truth
query = 3 * len(images) // 4  # in the second lap
figure = new_figure(13.0, 10.5)
axes = figure.subplots(3, 2)

# 4.3: how strong edges of each direction are in each cell of 8 x 8 pixels
small = cv2.resize(images[0], (256, 80), interpolation=cv2.INTER_AREA)
cells = cell_histograms(small.astype(np.float32), cell=8, orientations=9)
rows, columns, bins = np.nonzero(cells > 0.12 * cells.max())
across = np.pi / 9 * (bins + 0.5) + np.pi / 2  # an edge runs across its gradient
dx, dy = 4 * np.cos(across), 4 * np.sin(across)
x, y = 8 * columns + 3.5, 8 * rows + 3.5
axes[0, 0].imshow(small, cmap="gray")
axes[0, 0].plot([x - dx, x + dx], [y - dy, y + dy], color=style.ODOMETRY, lw=1)
axes[0, 0].set_title("HOG: directions of edges, cell by cell (Figure 4.3)")

# 4.4 and 4.11: how often each visual word is seen in an image, and in its sequence
vocabulary, features = default_vocabulary(), FeatureCache(Surf())
counts = np.array([word_histogram(features.get(k, image), vocabulary) for k, image in enumerate(images)])
sequence = counts[:5].sum(axis=0)
common = np.argsort(-sequence, kind="stable")[:80]
axes[0, 1].bar(range(80), sequence[common], color=style.ODOMETRY, label="five images")
axes[0, 1].bar(range(80), counts[0, common], color=style.CORRECTED, label="the first alone")
axes[0, 1].set(title=f"80 of {len(vocabulary)} words, the most frequent (Figures 4.4, 4.11)", ylabel="times seen")
axes[0, 1].legend(frameon=False)

# 4.13: sequences of 5 m, and sequences that end where the view changes
distance_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1))])
segmentations = {"after 5 m": FixedDistanceSegmentation(), "where the words change": WordVariance(len(vocabulary))}
for ax, (name, segmentation) in zip(axes[1], segmentations.items(), strict=True):
    begins = [segmentation.starts_sequence(np.flatnonzero(n), d) for n, d in zip(counts, distance_m, strict=True)]
    plan = poses[:, [0, 2], 3] - poses[:, [0, 2], 3].mean(axis=0)
    plan[len(images) // 2 :] *= 0.9  # the second lap is drawn inside the first
    ax.scatter(*plan.T, c=np.cumsum(begins) % 10, cmap="tab10", s=9)
    ax.set(title=f"{sum(begins)} sequences, which end {name} (Figure 4.13)", aspect="equal")

# 4.14 and 4.15: what the images before a revisit get votes for
numbers = {"hierarchical-places": "4.14", "tracked-words": "4.15"}
for ax, (paradigm, number) in zip(axes[2], numbers.items(), strict=True):
    rows = MatrixRecorder()
    recogniser = make_recognizer(paradigm, features, rows=rows)
    for k in range(query + 1):
        recogniser.observe(k, images[k], distance_m[k])
    votes, truth = np.nan_to_num(rows.matrix(query + 1).values[query]), np.flatnonzero(loop_truth(poses)[query])
    ax.fill_between(range(query + 1), votes, step="mid", color=style.CORRECTED)
    ax.axvspan(truth.min(), truth.max(), color=style.ACCEPTED, alpha=0.3, label="where the camera had been")
    ax.set(title=f"{paradigm}: votes of image {query} (Figure {number})", xlabel="earlier image", ylabel="votes")
    ax.legend(frameon=False)
save_png(figure, given.out / "7_inside_the_paradigms.png")
