"""Where is the camera? A hidden Markov model over the places of the map and "a new place", smoothed with a fixed lag.

The state is the location that an image shows, with the speed and direction at which the earlier pass is followed, or
"a new place". From image to image a revisit goes on along the earlier pass, ends, or begins; proposed candidates, with
their likelihood ratios against a new place, are what is observed. The probability of each location given all images up
to `lag_images` later follows by the forward-backward algorithm (Rabiner, Proc. IEEE 77(2) 1989). It is the Bayes filter
of the chapter's section 4.2.3.4 with places for states, as in FAB-MAP (Cummins and Newman, IJRR 27(6) 2008) and with
motion as in Hansen and Browning, 'Visual place recognition using HMM sequence matching', IROS 2014.

Equations: docs/math.md. Reasons and figures: docs/decisions/place_filter.md.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Images by which the earlier pass advances for each image of this pass; negative where it is driven backwards.
_SPEEDS = np.array([-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0])
_MOVES = np.arange(-3, 4)  # locations by which the place may move from image to image
_MOVE_NOISE = 0.1  # probability of moving one location less, or one more, than the speed says
_SPEED_CHANGE = 0.05  # probability of another speed at the next image, mostly a neighbouring one
_ANY_SPEED = 0.02  # share of these changes that lead to any speed
_BIRTH_RADIUS = 2  # a revisit may begin this many images beside a candidate
_MAX_LOCATIONS, _MIN_MASS = 60, 1e-9  # only locations with mass are kept
_MATCH_RADIUS = 3  # images within which locations are one match


@dataclass(frozen=True)
class PlaceFilterConfig:
    """Parameters of the model.

    Attributes:
        begin_probability: probability that a revisit begins at an image that proposes candidates.
        end_probability: probability that a revisit ends at an image.
        miss_probability: probability of what is observed where no candidate is near the place, relative to a new place.
        location_sigma_frames: standard deviation of a candidate's location about the true one.
        lag_frames: number of later images that an answer waits for; 0 answers at once, from the past alone.
        min_probability: smallest probability of an accepted match.
    """

    begin_probability: float = 0.001
    end_probability: float = 0.02
    miss_probability: float = 0.16
    location_sigma_frames: float = 1.5
    lag_frames: int = 15
    min_probability: float = 0.999


@dataclass(frozen=True)
class Observation:
    """Candidates of one image.

    Attributes:
        locations: (K,) distinct locations of the candidates.
        log_ratios: (K,) log10 of their likelihood ratios against a new place.
        sharpness: (K,) factor, at least 1, by which a candidate's location is known better than usual (inverse variance).
    """

    locations: Indices
    log_ratios: Array
    sharpness: Array


@dataclass(frozen=True)
class Posterior:
    """Answer for one image.

    Attributes:
        location: most likely location; None where nothing is likely.
        probability: probability that the image shows the places around it.
        log_odds: log10 of its odds, which orders answers whose probability rounds to 1.
    """

    location: int | None
    probability: float
    log_odds: float


@dataclass(frozen=True)
class _Message:
    """Forward message of one image and the likelihoods that the backward pass needs.

    Attributes:
        locations: (N,) locations with mass, rising.
        mass: (N, S) probability of each location and speed, given the images so far.
        new: probability of a new place.
        likelihood: (N,) likelihood ratio of each location.
        births: (N,) probability that a revisit begins there.
    """

    locations: Indices
    mass: Array
    new: float
    likelihood: Array
    births: Array

    def state(self) -> dict[str, Any]:
        """The message as plain values and arrays, for a checkpoint."""
        return dict(vars(self))


class PlaceFilter:
    """Smooths the observations of successive images: one posterior for each, in order, `lag_frames` images late."""

    def __init__(self, config: PlaceFilterConfig | None = None) -> None:
        self.config = config or PlaceFilterConfig()
        self._window: deque[_Message] = deque(maxlen=self.config.lag_frames + 1)
        self._undecided = 0

    def add(self, observation: Observation) -> list[Posterior]:
        """Add the observation of the next image and return the posterior that is ready now, if any."""
        self._window.append(self._forward(observation))
        self._undecided += 1
        return [self._decide()] if self._undecided > self.config.lag_frames else []

    def finish(self) -> list[Posterior]:
        """Return the posteriors of the last images, which have fewer images after them."""
        return [self._decide() for _ in range(self._undecided)]

    def _forward(self, observation: Observation) -> _Message:
        """One step of the forward pass: predict, add births, weigh by the likelihood, normalise, prune."""
        stay = 1 - self.config.end_probability
        if self._window:
            last = self._window[-1]
            moved = stay * (last.mass @ _TURNS)[:, None, :] * _MOVE_PROBABILITIES.T
            locations, mass, new = (last.locations[:, None] + _MOVES).ravel(), moved.reshape(-1, len(_SPEEDS)), last.new
            ended = self.config.end_probability * float(last.mass.sum())
        else:
            locations, mass, new, ended = np.empty(0, np.int64), np.empty((0, len(_SPEEDS))), 1.0, 0.0
        born = _around(observation.locations, _BIRTH_RADIUS)
        birth = self.config.begin_probability / max(len(born), 1)
        union, index = np.unique(np.concatenate([locations, born]), return_inverse=True)
        predicted = np.zeros((len(union), len(_SPEEDS)))
        np.add.at(predicted, index, np.concatenate([mass, np.full((len(born), 1), new * birth) * _BIRTH_SPEEDS]))
        likelihood, births = self._likelihood(observation, union), np.where(np.isin(union, born), birth, 0.0)
        joint, new = predicted * likelihood[:, None], new * (1 - birth * len(born)) + ended
        total = float(joint.sum()) + new
        mass = joint.sum(axis=1) / total
        keep = np.sort(np.argsort(-mass, kind="stable")[:_MAX_LOCATIONS])
        keep = keep[(mass[keep] > _MIN_MASS) & (union[keep] >= 0)]
        return _Message(union[keep], joint[keep] / total, new / total, likelihood[keep], births[keep])

    def _likelihood(self, observation: Observation, locations: Indices) -> Array:
        """Likelihood ratio (N,) of each location: that of the candidate which explains it best, or that of a miss."""
        missed = np.full(len(locations), self.config.miss_probability)
        if len(observation.locations) == 0:
            return missed
        distance = (locations[:, None] - observation.locations) / self.config.location_sigma_frames
        log_ratios = observation.log_ratios - distance**2 * observation.sharpness / (2 * np.log(10))
        return np.maximum(10.0 ** log_ratios.max(axis=1), missed)

    def _decide(self) -> Posterior:
        """Return the posterior of the image that has waited longest."""
        position = len(self._window) - self._undecided
        self._undecided -= 1
        message, later = self._window[position], list(self._window)[position:]
        future, new = np.ones_like(later[-1].mass), 1.0
        for before, after in zip(later[-2::-1], later[:0:-1], strict=True):
            future, new = self._backward(before, after, future, new)
        mass = (message.mass * future).sum(axis=1)
        return _summarize(message.locations, mass, message.new * new)

    def _backward(self, before: _Message, after: _Message, future: Array, new: float) -> tuple[Array, float]:
        """One step of the backward pass, from the message of an image to that of the image before it."""
        weighted = after.likelihood[:, None] * future
        move = after.locations - before.locations[:, None] + len(_MOVES) // 2
        possible = (move >= 0) & (move < len(_MOVES))
        moves = np.where(possible[:, :, None], _MOVE_PROBABILITIES.T[np.where(possible, move, 0)], 0.0)
        goes_on = np.einsum("pns,ns->ps", moves, weighted) @ _TURNS.T
        earlier = (1 - self.config.end_probability) * goes_on + self.config.end_probability * new
        births = float(after.births @ (weighted @ _BIRTH_SPEEDS))
        earlier_new = (1 - self.config.begin_probability) * new + births
        scale = max(earlier_new, float(earlier.max(initial=0.0)))
        return earlier / scale, earlier_new / scale

    def state(self) -> dict[str, Any]:
        """Everything that waits for later images, for a checkpoint."""
        return {"messages": [message.state() for message in self._window], "num_undecided": self._undecided}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._window.extend(_Message(**message) for message in state["messages"])
        self._undecided = state["num_undecided"]


def _summarize(locations: Indices, mass: Array, new: float) -> Posterior:
    """The most likely location: the mean of those around the one of most mass, and how likely they are together."""
    if len(locations) == 0:
        return Posterior(None, 0.0, _MIN_LOG_ODDS)
    near = np.abs(locations - locations[int(mass.argmax())]) <= _MATCH_RADIUS
    inside, total = float(mass[near].sum()), float(mass.sum()) + new
    outside = max(total - inside, 1e-300)
    location = round(float(mass[near] @ locations[near]) / inside) if inside > 0 else None
    log_odds = max(float(np.log10(max(inside, 1e-300) / outside)), _MIN_LOG_ODDS)
    return Posterior(location, inside / total, log_odds)


_MIN_LOG_ODDS = -30.0


def _around(locations: Indices, radius: int) -> Indices:
    """All locations within a radius of some of the given ones, rising."""
    return np.unique((locations[:, None] + np.arange(-radius, radius + 1)).ravel())


def _move_probabilities() -> Array:
    """Probability (S, M) of each move at each speed."""
    lower = np.floor(_SPEEDS).astype(np.int64)
    upper_share = _SPEEDS - lower
    exact = np.zeros((len(_SPEEDS), len(_MOVES) + 2))  # one column beside the moves on each side, for the noise
    rows, first = np.arange(len(_SPEEDS)), lower - _MOVES[0] + 1
    exact[rows, first] += 1 - upper_share
    exact[rows, first + 1] += upper_share
    noisy = exact.copy()
    noisy[:, 1:-1] = (1 - 2 * _MOVE_NOISE) * exact[:, 1:-1] + _MOVE_NOISE * (exact[:, :-2] + exact[:, 2:])
    moves: Array = noisy[:, 1:-1]
    return moves / moves.sum(axis=1, keepdims=True)


def _speed_changes() -> Array:
    """Probability (S, S) of each speed at the next image, row = speed now."""
    count = len(_SPEEDS)
    neighbors = np.eye(count, k=1) + np.eye(count, k=-1)
    change = (1 - _ANY_SPEED) * neighbors / 2 + _ANY_SPEED / count
    turns: Array = (1 - _SPEED_CHANGE) * np.eye(count) + _SPEED_CHANGE * change
    return turns / turns.sum(axis=1, keepdims=True)


_MOVE_PROBABILITIES, _TURNS = _move_probabilities(), _speed_changes()
_BIRTH_SPEEDS = np.where(_SPEEDS > 0, 2.0, 1.0) / np.where(_SPEEDS > 0, 2.0, 1.0).sum()  # most passes go forwards
