"""Two drives through one world: where the second one met the first, and one graph for both.

No motion leads from the end of one drive to the beginning of the next. What leads there is what the loops between them
agree on: each says where the second drive began in the world of the first, and a step is added to the chain that is as
unsure as they may be wrong together. From there on two drives are one, and the back ends judge all loops alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing import LoopClosure
from slam.pose_graph import PoseGraph, PoseGraphConfig
from slam.robust import OptimizationResult

Array = NDArray[np.float64]
Step = tuple[Array, Array]  # T_previous_current (4, 4), metres, and its covariance (6, 6), rotation first


@dataclass(frozen=True)
class MeetingConfig:
    """When loops between two drives agree.

    Attributes:
        near_m: two loops agree if they put the second drive's beginning at most so far apart, metres, and
        drift: so much more for each metre of way between them,
        near_deg: turned by at most so much against one another, degrees.
        least: loops that must agree, among them
        apart_m: two so far apart on the way, metres: neighbouring images are wrong together.
        sigma_rad, sigma_m: of the step from one drive to the next, one standard deviation.
    """

    near_m: float = 2.0
    drift: float = 0.02
    near_deg: float = 5.0
    least: int = 5
    apart_m: float = 5.0
    sigma_rad: float = 0.1
    sigma_m: float = 10.0

    @property
    def covariance(self) -> Array:
        """(6, 6) of the step between two drives."""
        return np.diag(np.repeat(np.square([self.sigma_rad, self.sigma_m]), 3))


@dataclass(frozen=True)
class Drive:
    """What a graph needs to know of one drive.

    Attributes:
        steps: (N - 1) motions with their covariances.
        poses: (N, 4, 4) as they are known now, in a frame of the drive's own or of its world.
    """

    steps: tuple[Step, ...]
    poses: Array


@dataclass(frozen=True)
class Joined:
    """Several drives in one frame.

    Attributes:
        poses: T_world_camera (N, 4, 4) of all images of all drives in their order.
        optimized: what became of each loop, in the order in which they were given.
        T_world_session: (4, 4) the first camera of the last drive.
    """

    poses: Array
    optimized: OptimizationResult
    T_world_session: Array = field(default_factory=lambda: np.eye(4))


def meeting(
    known: Array, own: Array, loops: Sequence[LoopClosure], config: MeetingConfig | None = None
) -> Array | None:
    """Where a drive began in the world of others, T_world_session (4, 4); None where its loops do not agree.

    Args:
        known: T_world_camera (M, 4, 4) of the other drives.
        own: T_session_camera (N, 4, 4) of this drive.
        loops: between them; `match` counts from the first image of the others, `query` from that of this drive.
        config: when loops agree.
    """
    config = config or MeetingConfig()
    if len(loops) < config.least:
        return None
    queries = np.array([loop.query for loop in loops])
    said = np.array([known[loop.match] @ loop.T_match_query @ se3.inverse(own[loop.query]) for loop in loops])
    seen = own[queries, :3, 3]
    ways = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(own[:, :3, 3], axis=0), axis=1))])[queries]
    # Compared where the images are, not where the drive began: there a small turn would move them far.
    put = np.einsum("kij,lj->kli", said[:, :3, :3], seen) + said[:, None, :3, 3]  # loop k about the image of loop l
    apart = np.linalg.norm(put - np.einsum("llj->lj", put)[None], axis=2)
    between = np.abs(ways[:, None] - ways)
    turned = np.degrees(_angles(said))
    agree = (apart <= config.near_m + config.drift * between) & (turned <= config.near_deg + config.drift * between)
    best = int(agree.sum(axis=1).argmax())
    together = np.flatnonzero(agree[best])
    if len(together) < config.least or np.ptp(ways[together]) < config.apart_m:
        return None
    return np.asarray(said[best])


def _angles(poses: Array) -> Array:
    """Angles (K, K), radians, between the rotations of poses (K, 4, 4)."""
    traces = np.einsum("kij,lij->kl", poses[:, :3, :3], poses[:, :3, :3])
    angles: Array = np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0))
    return angles


def join(
    drives: Sequence[Drive], loops: Sequence[LoopClosure], graph: PoseGraphConfig, robust: str,
    config: MeetingConfig | None = None,
) -> Joined:  # fmt: skip
    """One graph of several drives, optimised.

    Args:
        drives: in their order, their poses in one world as far as it is known.
        loops: within and between them, with images counted from the first of the first drive.
        graph: what is believed of odometry and loops.
        robust: name of a back end.
        config: how sure the step from one drive to the next is.
    """
    config = config or MeetingConfig()
    whole = PoseGraph(graph)
    for number, drive in enumerate(drives):
        if number:
            T_last_first = se3.inverse(drives[number - 1].poses[-1]) @ drive.poses[0]
            whole.add_odometry(T_last_first, config.covariance)
        for T_previous_current, covariance in drive.steps:
            whole.add_odometry(T_previous_current, covariance)
    for loop in loops:
        whole.add_loop(loop)
    optimized = whole.optimize(robust)
    begin = sum(len(drive.poses) for drive in drives[:-1])
    return Joined(optimized.poses, optimized, optimized.poses[begin])
