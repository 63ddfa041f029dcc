"""Bayes filter of two states, "revisit" and "new place", over the detections so far.

Tsintotas, Bampis, Gasteratos, 'Modest-vocabulary loop-closure detection with incremental bag of tracked words', RAS
141, 2021: the successor of the bag of tracked words. Equations: docs/math.md.

For the chapter (section 4.2.3.4); no paradigm uses it.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class BayesFilterConfig:
    """Probabilities of the filter, from the paper.

    Attributes:
        persistence_probability: probability that the state is the same at the next image.
        false_alarm_probability: probability of a detection at a new place; with 0 a single detection settles the state.
        detection_probability: probability of a detection at a revisit: hardly more than every second image is
            recognised.
    """

    persistence_probability: float = 0.975
    false_alarm_probability: float = 0.0
    detection_probability: float = 0.54

    def __post_init__(self) -> None:
        """Raise ValueError for a number outside [0, 1]."""
        for name, value in vars(self).items():
            if not 0 <= value <= 1:
                raise ValueError(f"expected {name} between 0 and 1, got {value}")


class BayesFilter:
    """Probability that the camera is at a revisited place, updated image by image.

    With the paper's numbers the revisit outlasts four images without detection, the fourth barely: after a detection
    the probability falls to 0.947, 0.850, 0.696, 0.501, then 0.316.
    """

    def __init__(self, config: BayesFilterConfig | None = None) -> None:
        self.config = config or BayesFilterConfig()
        self._probability = 0.0

    @property
    def probability(self) -> float:
        """Probability of a revisit; 0 before the first image."""
        return self._probability

    @property
    def is_revisit(self) -> bool:
        """Whether a revisit is the likelier state."""
        return self._probability > 0.5

    def update(self, is_detected: bool) -> float:
        """Update with the detection of the next image, or its absence, and return the new probability.

        If neither state can explain the observation, only the prediction step is done.
        """
        revisit = self._predict()
        joint_revisit = revisit * self._likelihood(self.config.detection_probability, is_detected)
        joint_new = (1 - revisit) * self._likelihood(self.config.false_alarm_probability, is_detected)
        total = joint_revisit + joint_new
        self._probability = joint_revisit / total if total > 0 else revisit
        return self._probability

    def _predict(self) -> float:
        stays = self.config.persistence_probability
        return stays * self._probability + (1 - stays) * (1 - self._probability)

    def _likelihood(self, detection_probability: float, is_detected: bool) -> float:
        return detection_probability if is_detected else 1 - detection_probability
