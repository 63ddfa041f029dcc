"""Input and output of a robust back end, and the condensation of the input.

Condensation leaves out most poses that no loop touches; the solution is the same to first order. Odometry between the
poses that stay is composed, its covariance moved along by the adjoint (Barfoot and Furgale, T-RO 2014). The back ends
take a third of the time on it.

Where loops touch more than `MAX_POSES` poses, a long drive, they are moved along odometry to the nearest pose that
stays. Back ends decide on these, and the whole problem is fitted from there (docs/decisions/robust_consensus.md).
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from slam.pose_graph.optimization.edges import Edges, concatenate
from slam.pose_graph.optimization.gauss_newton import factorize
from slam.pose_graph.optimization.marginals import marginals_by_factors

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Rows = NDArray[np.int64]

MIN_KEPT_WEIGHT = 0.5  # of a loop that counts as kept
MAX_POSES = 10_000  # of a condensed problem; with more of them loops are moved
# Places that are passed hundreds of times join all laps with one another, and the factors of the normal equations fill
# up. In space 350,000 blocks are 100 MB, and take some seconds for each fit.
_MIN_MOVED_POSES = 500
_MAX_FACTOR_BLOCKS = 350_000
_MAX_COVARIANCE_BLOCKS = 100_000  # the inverse takes longer than the factors
_MIN_POSES_BETWEEN_VISITS = 5  # that stayed: else a place would grow along the chain
_MAX_SPACING = 10  # poses from one that stays to the next, so that the shape of the trajectory remains


@dataclass(frozen=True)
class OnlineMap:
    """What is known before the back end begins: the map that was made while driving.

    Attributes:
        poses: (N, n, n) online poses, metres.
        used: (L,) bool, the loops that the online map uses.
    """

    poses: Array
    used: Mask


@dataclass(frozen=True)
class LoopProblem:
    """Trusted edges that connect all poses, and loops, some of them possibly false.

    Attributes:
        trusted: edges such as odometry that are taken to be right; without them the graph falls apart.
        loops: L edges, some of them false.
        start: (N, n, n) poses that the trusted edges lead to, metres; the first one is held.
        online: the map made while driving, from which the decisions on a long drive begin; None if there is none.
    """

    trusted: Edges
    loops: Edges
    start: Array
    online: OnlineMap | None = None

    def edges_with(self, chosen: Mask) -> Edges:
        """Trusted edges, then the chosen loops (L,) bool."""
        return concatenate(self.trusted, self.loops[chosen])

    def error(self, chosen: Mask, poses: Array) -> float:
        """Half the chi-square of the trusted edges and the chosen loops (L,) at poses (N, n, n)."""
        return 0.5 * float(self.edges_with(chosen).chi2(poses).sum())


@dataclass(frozen=True)
class BackEndResult:
    """Poses and loop weights of a back end.

    Attributes:
        poses: (N, n, n) optimised poses, metres.
        weights: (L,) weight of each loop, 0 to 1; a loop is kept from `MIN_KEPT_WEIGHT` upwards.
        reasons: (L,) why each loop was kept or left out; `slam.pose_graph.robust.backends.solve` fills them in.
    """

    poses: Array
    weights: Array
    reasons: tuple[str, ...]

    @property
    def kept(self) -> Mask:
        """(L,) bool, the loops that the poses are fitted to."""
        return self.weights >= MIN_KEPT_WEIGHT


@dataclass(frozen=True)
class CondensedProblem:
    """A problem with fewer poses.

    Attributes:
        problem: the condensed problem; its trusted edges join successive poses that stayed.
        rows: (K,) rows in the whole problem of the poses that stayed.
        whole: (N, n, n) start of the whole problem, metres.
        is_exact: whether every loop ends at poses that stayed; else loops were moved there along odometry.
    """

    problem: LoopProblem
    rows: Rows
    whole: Array
    is_exact: bool = True

    def expand(self, poses: Array) -> Array:
        """Poses (N, n, n) of the whole problem from those that stayed (K, n, n); corrections are interpolated."""
        if len(self.rows) == len(self.whole):
            return poses
        group = self.problem.trusted.group
        correction = poses @ group.inverse(self.whole[self.rows])
        at, share = self._intervals
        change = group.log(group.inverse(correction[at]) @ correction[at + 1])
        return np.asarray(correction[at] @ group.exp(share[:, None] * change) @ self.whole)

    def expand_covariances(self, covariances: Array) -> Array:
        """Covariances (N, dof, dof) of the whole problem's start from those of the poses that stayed (K, dof, dof).

        They are interpolated in the frame of the first pose: there the covariance of a chain of poses grows by
        a share with each of them.
        """
        group, (at, share) = self.problem.trusted.group, self._intervals
        common = _rotate(group.adjoint(self.whole[self.rows]), covariances)
        between = common[at] + share[:, None, None] * (common[at + 1] - common[at])
        return _rotate(group.adjoint(group.inverse(self.whole)), between)

    def place_modes(self, kept: Mask, poses: Array) -> sparse.csr_array:
        """Basis (N dof, K dof) of rigid motions of K places, interpolated along all poses (N, n, n).

        All poses of a place that the kept loops (L,) join move together: loops resist that least.
        """
        count, loops, group = len(self.rows), self.problem.loops[kept], self.problem.trusted.group
        place = np.arange(count)
        early, late = np.minimum(loops.first, loops.second), np.maximum(loops.first, loops.second)
        far = late - early > _MIN_POSES_BETWEEN_VISITS
        np.minimum.at(place, late[far], early[far])
        while (place != place[place]).any():
            place = place[place]
        place = np.unique(place, return_inverse=True)[1]
        at, share = self._intervals
        Ad, dof, row = group.adjoint(group.inverse(poses)), group.dof, np.arange(len(poses))
        blocks = [(1.0 - share)[:, None, None] * Ad, share[:, None, None] * Ad]
        modes = [
            sparse.bsr_array(
                (block, place[end], np.arange(len(row) + 1)), shape=(len(row) * dof, (place.max() + 1) * dof)
            )
            for block, end in zip(blocks, (at, at + 1), strict=True)
        ]
        return (modes[0].tocsr() + modes[1].tocsr()).tocsr()

    @property
    def _intervals(self) -> tuple[Rows, Array]:
        """(N,) number of the pose that stayed before each pose, and the share of the way to the next that stayed."""
        row = np.arange(len(self.whole))
        # Each pose lies between two that stayed; the last one belongs to the interval before it.
        at = np.minimum(np.searchsorted(self.rows, row, side="right") - 1, len(self.rows) - 2)
        return at, (row - self.rows[at]) / (self.rows[at + 1] - self.rows[at])


def condense(problem: LoopProblem, max_factor_blocks: int = _MAX_FACTOR_BLOCKS) -> CondensedProblem:
    """Condense a problem; one whose trusted edges are no chain of successive poses stays as it is.

    Args:
        problem: trusted edges and loops.
        max_factor_blocks: maximum number of blocks in the factors of the normal equations where loops are moved.
    """
    count, loops, trusted = len(problem.start), problem.loops, problem.trusted
    order = np.argsort(trusted.first, kind="stable")
    rows = np.unique(np.concatenate([loops.first, loops.second, np.arange(0, count, _MAX_SPACING), [count - 1]]))
    successive = len(trusted) == count - 1 and bool(
        (trusted.first[order] == np.arange(count - 1)).all() and (trusted.second == trusted.first + 1).all()
    )
    if not successive or len(rows) == count <= MAX_POSES:
        return CondensedProblem(problem, np.arange(count), problem.start)
    is_exact = len(rows) <= MAX_POSES
    if not is_exact:
        rows = _choose_rows(loops, count, max_factor_blocks)
        loops = _move_ends(loops, trusted[order], problem.start, rows)
    renumbered = Edges(
        np.searchsorted(rows, loops.first), np.searchsorted(rows, loops.second), loops.motions, loops.information
    )
    small = LoopProblem(_compose_steps(trusted[order], problem.start, rows), renumbered, problem.start[rows])
    return CondensedProblem(small, rows, problem.start, is_exact)


def _choose_rows(loops: Edges, count: int, max_factor_blocks: int) -> Rows:
    """Evenly spaced rows of N poses, as close as the fill of the factors allows."""

    def spaced(spacing: int) -> Rows:
        return np.unique(np.append(np.arange(0, count, spacing), count - 1))

    closest = max(_MAX_SPACING, -(-count // MAX_POSES))
    spacing = max(closest, -(-count // _MIN_MOVED_POSES))
    while spacing > closest:
        closer = max(spacing // 2, closest)
        if _count_factor_blocks(loops, spaced(closer)) > max_factor_blocks:
            break
        spacing = closer
    return spaced(spacing)


def _count_factor_blocks(loops: Edges, rows: Rows) -> int:
    """Blocks in the factors of the normal equations of loops moved to rows, and of the chain that joins these."""
    first, second = (_nearest(rows, ends) for ends in (loops.first, loops.second))
    at = np.arange(len(rows) - 1)
    i, j = np.concatenate([first, at]), np.concatenate([second, at + 1])
    links = sparse.coo_array((np.ones(len(i)), (i, j)), shape=(len(rows), len(rows))).tocsc()
    links = links + links.T
    return int(factorize(links + sparse.diags_array(2.0 * links.sum(axis=0) + 1.0, format="csc")).L.nnz)


def _nearest(rows: Rows, ends: Rows) -> Rows:
    """(M,) numbers of the rows nearest to poses (M,)."""
    return np.asarray(np.searchsorted((rows[:-1] + rows[1:] + 1) // 2, ends, side="right"))


def _move_ends(loops: Edges, steps: Edges, poses: Array, rows: Rows) -> Edges:
    """Loops between the rows nearest to their ends, moved there along the N - 1 steps that lead to poses (N, n, n).

    The covariance of the steps on the way is added to that of the loop.
    """
    first, second = (rows[_nearest(rows, ends)] for ends in (loops.first, loops.second))
    adjoint, inverse = loops.group.adjoint, loops.group.inverse
    # Errors of steps add up in the frame of the first pose, so that of any way is a difference of two sums.
    Ad = adjoint(poses[1:])
    sums = np.concatenate([np.zeros_like(Ad[:1]), np.cumsum(_rotate(Ad, steps.covariance), axis=0)])

    def between(one: Rows, other: Rows) -> Array:
        return sums[np.maximum(one, other)] - sums[np.minimum(one, other)]

    T_second_moved = inverse(poses[loops.second]) @ poses[second]
    T_first_moved = loops.motions @ T_second_moved
    covariance = _rotate(adjoint(inverse(T_second_moved)), loops.covariance)
    covariance += _rotate(adjoint(inverse(poses[second])), between(loops.second, second))
    covariance += _rotate(adjoint(inverse(poses[loops.first] @ T_first_moved)), between(loops.first, first))
    motions = inverse(poses[first]) @ poses[loops.first] @ T_first_moved
    symmetric = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
    return Edges(first, second, motions, np.asarray(np.linalg.inv(symmetric), dtype=np.float64))


def _compose_steps(steps: Edges, poses: Array, rows: Rows) -> Edges:
    """Edges between successive rows of the poses (N, n, n) that N - 1 steps lead to."""
    ends = np.repeat(rows[1:], np.diff(rows))
    inverse = steps.group.inverse
    Ad = steps.group.adjoint(inverse(poses[ends]) @ poses[1:])
    covariance = np.add.reduceat(_rotate(Ad, steps.covariance), rows[:-1], axis=0)
    at = np.arange(len(rows) - 1)
    return Edges(at, at + 1, inverse(poses[rows[:-1]]) @ poses[rows[1:]], np.linalg.inv(covariance))


def condensed_covariances(problem: LoopProblem, errors: Array) -> Array:
    """Covariances (N, dof, dof) of the poses of a long drive: those of some poses, interpolated.

    Args:
        problem: N - 1 trusted edges between successive poses, loops to which the poses are fitted, and the poses.
        errors: (N - 1, dof, M) errors of the trusted edges by M causes of one standard deviation.
    """
    small, poses = condense(problem, _MAX_COVARIANCE_BLOCKS), problem.start
    trusted, loops, before = small.problem.trusted, small.problem.loops, problem.loops
    if not small.is_exact:
        share = _share_of_information(before, loops, small.rows)
        loops = replace(loops, information=loops.information * share[:, None, None])
    adjoint, inverse, rows = trusted.group.adjoint, trusted.group.inverse, small.rows
    moved = adjoint(poses[1:]) @ errors
    sums = np.concatenate([np.zeros_like(moved[:1]), np.cumsum(moved, axis=0)])  # in the frame of the first pose
    of_steps = adjoint(inverse(poses[rows[1:]])) @ np.diff(sums[rows], axis=0)
    first, second = rows[loops.first], rows[loops.second]
    # What moved a loop along odometry has odometry's errors.
    of_loops = adjoint(inverse(poses[second])) @ (sums[second] - sums[before.second] + sums[before.first] - sums[first])
    of_both = np.concatenate([of_steps, of_loops])
    return small.expand_covariances(marginals_by_factors(poses[rows], concatenate(trusted, loops), of_both))


def _share_of_information(loops: Edges, moved: Edges, rows: Rows) -> Array:
    """(L,) share that loops have in the information that they state once they are moved to the nearest of the rows.

    Loops that come to one pose from one side share the errors of odometry there. They are added from the farthest to
    the nearest, as observations of a random walk, in scalars (traces of covariances).
    """
    own, after = (np.trace(edges.covariance, axis1=1, axis2=2) for edges in (loops, moved))
    added = np.maximum(after - own, 0.0)
    nearer, share = np.argsort(-added, kind="stable"), np.ones(len(loops))
    for end, pose in ((loops.first, moved.first), (loops.second, moved.second)):
        side = 2 * pose + (end > rows[pose])
        variances, left = np.full(2 * len(rows), np.inf), np.zeros(2 * len(rows))
        for k in nearer:
            before = variances[side[k]] + left[side[k]] - added[k]
            variances[side[k]], left[side[k]] = 1.0 / (1.0 / before + 1.0 / own[k]), added[k]
        stated = np.bincount(side, 1.0 / after, 2 * len(rows))
        share = np.minimum(share, 1.0 / ((variances + left)[side] * stated[side]))
    return share


def _rotate(Ad: Array, covariance: Array) -> Array:
    """Covariances (M, dof, dof) in other frames, by the adjoints (M, dof, dof) to them."""
    return np.asarray(Ad @ covariance @ np.swapaxes(Ad, 1, 2))
