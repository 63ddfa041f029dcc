"""What each threshold of the published presets decides: `python benchmarks/published_presets.py IMAGES TRUTH FPS`.

IMAGES is a folder of images, or one with image_0 in it, TRUTH an .npz with `truth` (N, N), FPS the images a second, by
which 40 s are excluded. For each paradigm of section 4.4 it prints how many matches are accepted, true within 10 images
and false, as published and with a threshold left out; `none` has no threshold at all and is the control. Then the same
of the paradigms of sequences with other choices where their papers leave one, and how long the sequences are. The
tables stand in docs/decisions/published_presets.md.
"""

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
from command_line import existing, run_script
from place_benchmarks import image_files

from place_recognition.image_processing.local_features import FeatureCache, FeatureExtractor, LocalFeatures
from place_recognition.map.sequence_map import WordVarianceConfig
from place_recognition.paradigms import published
from place_recognition.paradigms.registry import (
    PARADIGMS,
    ParadigmsConfig,
    exclusion_s,
    make_feature_extractor,
    make_recognizer,
    with_exclusion,
    with_preset,
)
from place_recognition.recognizer import Belief, ObservedImage, Proposals, Proposer
from place_recognition.vocabulary import vocabulary

SEQUENCES = ("sequence-histograms", "dynamic-sequences")
GATES: dict[str, dict[str, Any]] = {
    "as published": {},
    "no score": {"min_score": 0.0},
    "no geometry": {"min_inliers": 0},
    "no temporal gate": {"min_consistent_frames": 1},
    "none": {"min_score": 0.0, "min_inliers": 0, "min_consistent_frames": 1},
}
AS_PRINTED = WordVarianceConfig(min_variance=0.75, min_variance_ratio=0.0, min_images=1, max_images=1_000_000)
SURF_WORDS = str(Path(vocabulary.__file__).with_name("default.vocabulary"))


class CachingExtractor:
    """Extracts the features of each image once (a FeatureExtractor)."""

    def __init__(self, inner: FeatureExtractor) -> None:
        self._inner, self.kind = inner, inner.kind
        self._found: dict[bytes, LocalFeatures] = {}

    def extract(self, image: Any) -> LocalFeatures:
        """Return the features of an image."""
        key = image.tobytes()
        if key not in self._found:
            self._found[key] = self._inner.extract(image)
        return self._found[key]


class RecordedProposer:
    """Keeps what a proposer answers, and answers the same again once it has been rewound (a Proposer)."""

    def __init__(self, inner: Proposer) -> None:
        self.inner, self._answers = inner, []
        self._replayed: Iterator[list[Proposals]] | None = None

    def rewind(self) -> None:
        """Begin again with what has been recorded."""
        self._replayed = iter(self._answers)

    def observe(self, image: ObservedImage) -> list[Proposals]:
        """Answer to the next image."""
        return self._next(lambda: self.inner.observe(image))

    def finish(self) -> list[Proposals]:
        """Answer to the end."""
        return self._next(self.inner.finish)

    def _next(self, answer: Any) -> list[Proposals]:
        if self._replayed is not None:
            return next(self._replayed)
        self._answers.append(answer())
        return self._answers[-1]


@dataclass(frozen=True)
class Drive:
    """Images of a drive, its truth (N, N) and its images a second."""

    images: Sequence[Any]
    truth: Any
    fps: float

    def settings(self, name: str, chosen: ParadigmsConfig) -> ParadigmsConfig:
        """Return the settings of a published preset with its exclusion."""
        frames = math.ceil(exclusion_s(name, chosen) * self.fps - 1e-9)
        return with_preset(name, with_exclusion(chosen, frames))

    def observe(self, name: str, config: ParadigmsConfig, extractor: FeatureExtractor) -> list[Belief]:
        """Return all beliefs of a recogniser."""
        recognizer = make_recognizer(name, FeatureCache(extractor), config)
        beliefs = [b for k, image in enumerate(self.images) for b in recognizer.observe(k, image, float("nan"))]
        return beliefs + recognizer.finish()

    def count(self, beliefs: Sequence[Belief]) -> str:
        """Count the accepted matches: true within 10 images, and false."""
        near = [self.truth[b.query, max(b.match - 10, 0) : b.match + 11].any() for b in beliefs if b.accepted]
        return f"{sum(near)} true, {len(near) - sum(near)} false"


def measure_gates(drive: Drive, name: str) -> None:
    """Print what is accepted without each threshold."""
    config, build = drive.settings(name, ParadigmsConfig(preset="published")), PARADIGMS[name]
    extractor, kept = CachingExtractor(make_feature_extractor(config)), []

    def recorded(*arguments: Any) -> RecordedProposer:
        kept.extend([RecordedProposer(build(*arguments))] if not kept else [])
        return kept[0]

    for label, changes in GATES.items():
        decision = replace(published.DECISIONS[name], **changes)
        with patch.dict(PARADIGMS, {name: recorded}), patch.dict(published.DECISIONS, {name: decision}):
            print(f"{name:20s} {label:26s} {drive.count(drive.observe(name, config, extractor))}", flush=True)
        kept[0].rewind()


def measure_choices(drive: Drive, name: str) -> None:
    """Print what a paradigm of sequences accepts with other choices where its paper leaves one."""
    function, original = name.replace("-", "_"), PARADIGMS[name]
    settings = getattr(published, function)()
    printed_score = replace(settings, matching=replace(settings.matching, score="l2"))
    choices = {"[0, 1] score": settings, "equation 4.6 as printed": printed_score, "SURF, default words": settings}
    if name == "dynamic-sequences":
        choices["no bounds of the length"] = replace(settings, sequences=AS_PRINTED)
    for label, chosen in choices.items():
        words = SURF_WORDS if label.startswith("SURF") else ""
        kept: list[Proposer] = []

        def build(*arguments: Any, kept: list[Proposer] = kept) -> Proposer:
            kept.append(original(*arguments))
            return kept[-1]

        with patch.object(published, function, lambda chosen=chosen: chosen), patch.dict(PARADIGMS, {name: build}):
            config = drive.settings(name, ParadigmsConfig(preset="published", vocabulary=words))
            beliefs = drive.observe(name, config, CachingExtractor(make_feature_extractor(config)))
        lengths = np.diff(np.concatenate([[-1], kept[0]._map._ends]))  # type: ignore[attr-defined]
        best = max((b.stages.own_score for b in beliefs if b.stages.own_score is not None), default=0.0)
        lengths_text = f"{len(lengths)} sequences, mean {lengths.mean():.1f}" if len(lengths) else "one sequence"
        alone = f"{np.sum(lengths == 1)} of one image, {np.sum(lengths == 2)} of two, {np.sum(lengths == 15)} of 15"
        print(f"{name:20s} {label:26s} {drive.count(beliefs)}; best response {best:.2f}; {lengths_text}, {alone}")


def main() -> None:
    """Measure one drive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", type=existing)
    parser.add_argument("truth", type=existing)
    parser.add_argument("fps", type=float)
    given = parser.parse_args()
    images = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in image_files(given.images)]
    with np.load(given.truth) as arrays:
        drive = Drive(images, arrays["truth"].astype(bool), given.fps)
    for name in ("sequence-histograms", "dynamic-sequences", "hierarchical-places", "tracked-words"):
        measure_gates(drive, name)
    for name in SEQUENCES:
        measure_choices(drive, name)


if __name__ == "__main__":
    run_script(main)
