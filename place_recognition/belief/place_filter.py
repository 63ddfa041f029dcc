"""Where is the camera? A hidden Markov model over the places of the map and "a new place", smoothed with a fixed lag.

The state is a place of the map, with the speed and direction at which the earlier pass is followed, or "a new place".
A place may also be seen from elsewhere, as a crossing is from the street that leads to it: then the camera moves, but
the match does not, which is the speed 0; it counts as a new place. From step to step a revisit goes on along the
earlier pass, ends, or begins. What is observed are the candidates of an image, with their likelihood ratios against a
new place. The probability of each place given all images up to `lag_frames` later follows by the forward-backward
algorithm (Rabiner, Proc. IEEE 77(2) 1989). It is the Bayes filter of the chapter's section 4.2.3.4 with places for
states, as in FAB-MAP (Cummins and Newman, IJRR 27(6) 2008) and with motion as in Hansen and Browning, 'Visual place
recognition using HMM sequence matching', IROS 2014.

Equations: docs/math.md. Reasons and figures: docs/decisions/place_filter.md.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Steps by which the earlier pass advances for each step of this pass; negative where it is driven backwards.
_SPEEDS = np.array([-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0])
_AT_PLACE = _SPEEDS != 0  # at speed 0 the place is seen from elsewhere
_MOVES = np.arange(-3, 4)  # steps by which the place may move
_MOVES_ELSEWHERE = np.array(
    [0.02, 0.05, 0.13, 0.6, 0.13, 0.05, 0.02]
)  # from elsewhere any of the places ahead may match
_MOVE_NOISE = 0.05  # probability of moving one step less, or one more, than the speed says
_SLOW_SHARE = 0.5  # of the changes of the slowest speeds, that lead to a view from elsewhere: slow is not that yet
_SPEED_CHANGE = 0.02  # probability of another speed at the next step, mostly a neighbouring one
_ANY_SPEED = 0.02  # share of these changes that lead to any speed
_BIRTH_RADIUS = 2  # a revisit may begin this many steps beside a candidate
_MAX_PLACES, _MIN_MASS = 60, 1e-9  # only places with mass are kept
_MATCH_RADIUS = 3  # steps within which places are one match
_OUT_OF_REACH = 4  # steps: no move leads that far, and no match extends that far
_MIN_LOG_ODDS = -30.0


@dataclass(frozen=True)
class PlaceFilterConfig:
    """Parameters of the model.

    Attributes:
        begin_probability: probability that a revisit begins at a step that proposes candidates.
        end_probability: probability that a revisit ends at a step.
        miss_probability: probability of what is observed where no candidate is near the place, relative to a new place.
        location_sigma_frames: standard deviation of a candidate's location about the true one.
        lag_frames: number of later images that an answer waits for; 0 answers at once, from the past alone.
        min_probability: smallest probability of an accepted match.
    """

    begin_probability: float = 0.0003
    end_probability: float = 0.02
    miss_probability: float = 0.35
    location_sigma_frames: float = 2.5
    lag_frames: int = 15
    min_probability: float = 0.999


@dataclass(frozen=True)
class Observation:
    """Candidates of one image.

    Attributes:
        places: (K,) the places of the candidates, as steps of the camera when it saw them.
        log_ratios: (K,) log10 of their likelihood ratios against a new place.
        elsewhere: (K,) log10 of those of their places seen from elsewhere.
        sharpness: (K,) factor, at least 1, by which a place is known better than usual (inverse variance).
        junctions: (J, 2) places that successive steps show, far apart: there a pass meets or leaves an earlier one.
    """

    places: Indices
    log_ratios: Array
    elsewhere: Array
    sharpness: Array
    junctions: Indices = field(default_factory=lambda: np.empty((0, 2), np.int64))


@dataclass(frozen=True)
class PlacePosterior:
    """Answer for one step.

    Attributes:
        place: most likely place; None where nothing is likely.
        probability: probability that the camera is there, or within 3 steps of it.
        log_odds: log10 of its odds, which orders answers whose probability rounds to 1.
    """

    place: int | None
    probability: float
    log_odds: float


@dataclass(frozen=True)
class _Message:
    """Forward message of one step and what the backward pass needs.

    Attributes:
        places: (N,) places with mass, rising.
        mass: (N, S) probability of each place and speed, given the steps so far.
        new: probability of a new place.
        likelihood: (N, S) likelihood ratio of each place and speed.
        births: (N,) probability that a revisit begins there.
        begin: probability that a revisit begins anywhere: 0 where nothing was observed.
        routes: (R, 3) moves that led here: row of the place before, row of the place here, column of the move.
        shares: (R,) share of the move that took each route.
        junctions: (J, 2) of the observation.
    """

    places: Indices
    mass: Array
    new: float
    likelihood: Array
    births: Array
    begin: float
    routes: Indices
    shares: Array
    junctions: Indices


class PlaceFilter:
    """Takes the observation of each step and returns the posterior of any of the latest `lag_frames` + 1 steps."""

    def __init__(self, config: PlaceFilterConfig | None = None) -> None:
        self.config = config or PlaceFilterConfig()
        self._window: deque[_Message] = deque(maxlen=self.config.lag_frames + 1)

    def add(self, observation: Observation) -> None:
        """Add the observation of the next step: predict, add births, weigh by the likelihood, normalise, prune."""
        last, ends = self._window[-1] if self._window else _before_the_first(), self.config.end_probability
        origins, moves, ahead, shares = _routes(last.places, _near(observation.junctions, last.places))
        born = _around(observation.places, _BIRTH_RADIUS)
        begin = self.config.begin_probability if len(born) else 0.0
        birth = begin / max(len(born), 1)
        places, rows = np.unique(np.concatenate([ahead, born]), return_inverse=True)
        moved, began = rows[: len(ahead)], rows[len(ahead) :]
        joint = np.zeros((len(places), len(_SPEEDS)))
        goes_on = (last.mass @ _SPEED_CHANGES)[origins] * _MOVE_PROBABILITIES.T[moves]
        np.add.at(joint, moved, (1 - ends) * shares[:, None] * goes_on)
        joint[began] += last.new * birth * _BIRTH_SPEEDS
        likelihood = self._likelihood(observation, places)
        joint *= likelihood
        new = (1 - begin) * last.new + ends * float(last.mass.sum())
        total = float(joint.sum()) + new
        keep = _likeliest(places, joint.sum(axis=1) / total)
        births, here = np.zeros(len(places)), np.full(len(places), -1)
        births[began], here[keep] = birth, np.arange(len(keep))
        routes = np.stack([origins, here[moved], moves], axis=1)
        kept = routes[:, 1] >= 0
        self._window.append(
            _Message(
                places[keep], joint[keep] / total, new / total, likelihood[keep], births[keep], begin,
                routes[kept], shares[kept], observation.junctions,
            )
        )  # fmt: skip

    def _likelihood(self, observation: Observation, places: Indices) -> Array:
        """Likelihood ratio (N, S) of each place and speed: of the candidate that explains it best, or of a miss."""
        best = np.full((2, len(places)), -np.inf)
        if len(observation.places):
            distance = (places[:, None] - observation.places) / self.config.location_sigma_frames
            off = distance**2 * observation.sharpness / (2 * np.log(10))
            best = np.array([(ratios - off).max(axis=1) for ratios in (observation.log_ratios, observation.elsewhere)])
        log_ratios = np.where(_AT_PLACE, best[0][:, None], best[1][:, None])
        return np.maximum(10.0**log_ratios, self.config.miss_probability)

    def posterior(self, steps_ago: int) -> PlacePosterior:
        """Return the posterior of the step `steps_ago` steps before the latest one, given all steps so far."""
        position = len(self._window) - 1 - steps_ago
        later = list(self._window)[position:]
        future, new = np.ones_like(later[-1].mass), 1.0
        for before, after in zip(later[-2::-1], later[:0:-1], strict=True):
            future, new = self._backward(before, after, future, new)
        both = later[0].mass * future
        elsewhere = later[0].new * new + float((both @ ~_AT_PLACE).sum())
        return _summarize(later[0].places, both @ _AT_PLACE, elsewhere, later[-1].junctions)

    def _backward(self, before: _Message, after: _Message, future: Array, new: float) -> tuple[Array, float]:
        """One step of the backward pass, from the message of a step to that of the step before it."""
        weighted, ends = after.likelihood * future, self.config.end_probability
        goes_on = _gather(after.routes, after.shares, weighted, len(before.places), _MOVE_PROBABILITIES)
        earlier = (1 - ends) * (goes_on @ _SPEED_CHANGES.T) + ends * new
        begins = float(after.births @ (weighted @ _BIRTH_SPEEDS))
        earlier_new = (1 - after.begin) * new + begins
        scale = max(earlier_new, float(earlier.max(initial=0.0)))
        return earlier / scale, earlier_new / scale

    def state(self) -> list[dict[str, Any]]:
        """The messages that later steps still need, for a checkpoint."""
        return [dict(vars(message)) for message in self._window]

    def restore(self, state: list[dict[str, Any]]) -> None:
        """Continue from a state."""
        self._window.extend(_Message(**message) for message in state)


def _before_the_first() -> _Message:
    """Before the first step the place is new."""
    mass, rows = np.empty((0, len(_SPEEDS))), np.empty((0, 3), np.int64)
    return _Message(rows[:, 0], mass, 1.0, mass, mass[:, 0], 0.0, rows, mass[:, 0], rows[:, :2])


def _near(junctions: Indices, places: Indices) -> Indices:
    """The junctions (J, 2) that a place of (N,) may reach by one move, or that part places of one match."""
    away = np.abs(junctions[:, :, None] - places).min(axis=(1, 2), initial=_OUT_OF_REACH)
    return junctions[away < _OUT_OF_REACH]


def _routes(places: Indices, junctions: Indices) -> tuple[Indices, Indices, Indices, Array]:
    """All moves of places (N,), along the pass and over the junctions (J, 2) on the way, in equal shares.

    Returns:
        Of R routes: row of the place, column of the move, where it leads, and its share of the move, (R,) each.
    """
    to = places[:, None] + _MOVES
    first, last = junctions[:, 0, None, None], junctions[:, 1, None, None]
    forward = (places[:, None] <= first) & (to > first)
    backward = (places[:, None] >= last) & (to < last)
    junction, origins, moves = np.nonzero(forward | backward)
    beyond = to + np.where(forward, last - first - 1, first - last + 1)
    shares = 1.0 / (1 + np.count_nonzero(forward | backward, axis=0))
    rows, columns = (index.ravel() for index in np.indices(to.shape))
    return (
        np.concatenate([rows, origins]),
        np.concatenate([columns, moves]),
        np.concatenate([to.ravel(), beyond[junction, origins, moves]]),
        np.concatenate([shares.ravel(), shares[origins, moves]]),
    )


@njit(cache=True, nogil=True)
def _gather(routes: Indices, shares: Array, weighted: Array, count: int, probabilities: Array) -> Array:
    """Sum (count, S) of the weights (M, S) of the places that each place may move to; probabilities (S, moves)."""
    out = np.zeros((count, weighted.shape[1]))
    for k in range(len(routes)):
        origin, here, move = routes[k]
        for speed in range(weighted.shape[1]):
            out[origin, speed] += shares[k] * probabilities[speed, move] * weighted[here, speed]
    return out


def _likeliest(places: Indices, at_place: Array) -> Indices:
    """Rows of the places (N,) that are kept, rising: those of most mass (N,)."""
    keep = np.sort(np.argsort(-at_place, kind="stable")[:_MAX_PLACES])
    return keep[(at_place[keep] > _MIN_MASS) & (places[keep] >= 0)]


def _summarize(places: Indices, mass: Array, new: float, junctions: Indices) -> PlacePosterior:
    """The most likely place: the mean of those around the one of most mass, and how likely they are together."""
    if len(places) == 0 or mass.max() <= 0:
        return PlacePosterior(None, 0.0, _MIN_LOG_ODDS)
    best = int(places[mass.argmax()])
    near = np.abs(places - best) <= _MATCH_RADIUS
    links = _near(junctions, np.array([best]))
    over = np.abs(links - best) + 1 + np.abs(places[:, None, None] - links[:, ::-1])
    beyond = over.min(axis=(1, 2), initial=_OUT_OF_REACH) <= _MATCH_RADIUS
    inside, total = float(mass[near | beyond].sum()), float(mass.sum()) + new
    odds = inside / max(total - inside, 1e-300)
    log_odds = max(float(np.log10(max(odds, 1e-300))), _MIN_LOG_ODDS)
    place = round(float(mass[near] @ places[near]) / float(mass[near].sum()))
    return PlacePosterior(place, inside / total, log_odds)


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
    moves[~_AT_PLACE] = _MOVES_ELSEWHERE
    return moves / moves.sum(axis=1, keepdims=True)


def _speed_changes() -> Array:
    """Probability (S, S) of each speed at the next image, row = speed now."""
    count = len(_SPEEDS)
    neighbors = np.eye(count, k=1) + np.eye(count, k=-1)
    neighbors[:, ~_AT_PLACE] *= _SLOW_SHARE
    change = (1 - _ANY_SPEED) * neighbors / 2 + _ANY_SPEED / count
    changes: Array = (1 - _SPEED_CHANGE) * np.eye(count) + _SPEED_CHANGE * change
    return changes / changes.sum(axis=1, keepdims=True)


_MOVE_PROBABILITIES, _SPEED_CHANGES = _move_probabilities(), _speed_changes()
# Revisits begin with a view from elsewhere, as a street is seen before it is entered; most passes go forwards.
_BIRTH_WEIGHTS = np.where(_SPEEDS == 0, 8.0, np.where(_SPEEDS > 0, 2.0, 1.0))
_BIRTH_SPEEDS = _BIRTH_WEIGHTS / _BIRTH_WEIGHTS.sum()
