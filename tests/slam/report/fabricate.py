"""A plausible record of a drive that never took place: two laps of a circle with drift."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import cv2
import numpy as np

from odometry import se3
from place_recognition.evaluation.precision_recall import precision_recall
from place_recognition.evaluation.similarity_matrix import SimilarityMatrix
from place_recognition.evaluation.stages import measure_reliability, measure_stages
from place_recognition.recognizer import Belief, StageScores
from slam.mapping.birds_eye_view import BirdsEyeView, PlaneWindow, render_birds_eye_view
from slam.mapping.occupancy_grid import OccupancyGrid
from slam.mapping.tsdf import Surface
from slam.report.dense_map_section import DenseOverview, write_dense_page
from slam.run_result import LoopEventRow, LoopRow, MatchedPixels, PointCloud, RunRecord, StageRow

RADIUS = 40.0
LAP = 100
IMAGE = (376, 1241)  # rows, columns
GRAINS = (2, 4, 8, 16, 32, 64)  # pixels


def circle(frames):
    turn = se3.exp(np.array([0.0, 2 * np.pi / LAP, 0.0, 0.0, 0.0, 2 * np.pi * RADIUS / LAP]))
    poses = [np.eye(4)]
    for _ in range(frames - 1):
        poses.append(poses[-1] @ turn)
    return np.array(poses)


def drifting(poses, rng, turn, step):
    out = [poses[0]]
    for before, after in pairwise(poses):
        noise = rng.normal([0, turn, 0, 0, 0, 2 * step], [2e-4, turn, 2e-4, step, step / 3, step])
        out.append(out[-1] @ se3.inverse(before) @ after @ se3.exp(noise))
    return np.array(out)


def cloud(poses, rng):
    points = [se3.transform(T, rng.uniform([-12, -4, 4], [12, 1.5, 25], size=(30, 3))) for T in poses]
    points = np.concatenate([np.concatenate(points), [[5000.0, 0.0, 0.0]]])  # one outlier, as maps have
    return PointCloud(points, rng.integers(0, 255, len(points)).astype(np.uint8))


def loop_log(frames):
    rows = []
    for query in range(LAP + 5, frames, 5):
        truth = query % 15 != 0
        reason = "kept by the back end" if truth else "too few inliers (9 of 25)"
        rows.append(
            LoopRow(query, query - LAP if truth else 3, 0.8, True, 120, 60 if truth else 9, truth, truth,
                    1.0 if truth else float("nan"), 1.3 if truth else float("nan"), truth, reason)
        )  # fmt: skip
    return (LoopRow(20, 2, 0.1, False, reason="score below threshold", truth=False), *rows)


def metrics(frames):
    row = {
        "ate_alignment": "se3",
        "t_rel_percent": None,
        "r_rel_deg_per_100m": 0.61,
        "end_error_percent": 1.4,
    }
    return {
        "schema": 1, "source": "fabricated", "sequence": "00",
        "command": "revisit run fabricated --out runs/x",
        "versions": {"revisit-slam": "0.1.0", "numpy": "2.0"}, "seed": 7,
        "frames": frames, "path_length_m": 502.6,
        "odometry": {"ate_m": 5.42, "end_error_m": 7.0, **row},
        "online": {"ate_m": 2.5, "end_error_m": 1.1, **row},
        "corrected": {"ate_m": 0.83, "end_error_m": 0.9, **row},
        "loops": {"proposed": 19, "verified": 13, "kept": 13, "true": 13, "false": 0,
                  "precision": 1.0, "recall": 0.9},
        "timing_ms": {"total": {"median": 42.0, "p99": 81.0}}, "frames_per_second": 21.3, "wall_seconds": 9.4,
        "peak_memory_mb": 512.0,
        "memory_mb": {"odometry": 3.2, "recognise": 61.5},
        "notes": {"odometry.t_rel_percent": "the drive is shorter than 800 m"},
    }  # fmt: skip


def record(frames=200, seed=3):
    rng = np.random.default_rng(seed)
    truth = circle(frames)
    odometry = drifting(truth, rng, 1.2e-3, 0.012)
    corrected = drifting(truth, rng, 5e-5, 0.004)
    online = np.concatenate([odometry[: LAP + 10], corrected[LAP + 10 :]])
    stages = ("read", "odometry", "recognise", "verify", "optimise")
    times = {name: rng.gamma(4.0, 2.0 + 2 * k, frames) for k, name in enumerate(stages)}
    times["optimise"][::2] = np.nan
    return RunRecord(
        "fabricated circle", np.arange(frames) / 10, odometry, online, corrected, truth,
        np.arange(frames) % 70 == 69, rng.integers(80, 400, frames), loop_log(frames), times,
        cloud(odometry, rng), cloud(corrected, rng), metrics(frames),
    )  # fmt: skip


def without_truth(whole):
    loops = tuple(replace(row, truth=None) for row in whole.loops)
    return replace(whole, ground_truth=None, loops=loops, metrics={})


def without_loops(whole):
    return replace(whole, loops=())


def straight(frames=60):
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 2, 3] = np.arange(frames)
    empty = PointCloud(np.empty((0, 3)), np.empty(0, np.uint8))
    whole = record(frames)
    return replace(whole, odometry=poses, online=poses, corrected=poses, ground_truth=poses, loops=(),
                   map_before=empty, map_after=empty)  # fmt: skip


def standing():
    poses = np.eye(4)[None]
    return replace(straight(1), odometry=poses, online=poses, corrected=poses, ground_truth=poses, stage_ms={})


def with_evidence(whole, seed=5):
    """Add what the recogniser and the geometry saw of each row."""
    rng = np.random.default_rng(seed)
    sought = [row for row in whole.loops if row.accepted]
    stages = [
        StageRow(row.query, row.match, 50 if row.verified else 12, True, 0.2, 0.01, -1.3, 0.8, 0.03, 0.1, 1.7,
                 row.verified or None, "drift explains 4.0 m" if row.verified else "")
        for row in whole.loops
    ]  # fmt: skip
    events = [
        LoopEventRow(row.query, row.match, row.query + later, used, reason)
        for row in whole.loops
        if row.verified
        for later, used, reason in ((0, False, "waits"), (2, True, "joined"))
    ]
    rows, columns = np.indices((len(whole.timestamps),) * 2)
    matrix = np.exp(-(((rows - columns) % LAP) ** 2) / 50).astype(np.float32)
    matrix[columns >= rows - 20] = np.nan
    truth = np.zeros(matrix.shape, bool)
    for row in sought:
        truth[row.query, row.match] = row.truth
    beliefs = [
        Belief(row.query, row.match, float(row.inliers), True, probability=0.98,
               stages=StageScores((row.match, 2), row.score, row.match, 0.3 * row.inliers))
        for row in sought
    ]  # fmt: skip
    return replace(
        whole,
        stages=tuple(stages),
        events=tuple(events),
        matched=tuple(matched(row, rng) for row in sought),
        curve=precision_recall(beliefs, truth),
        place_stages=measure_stages(beliefs, truth),
        reliability=measure_reliability(beliefs, truth),
        matrices={"similarity": SimilarityMatrix(matrix)},
    )


def matched(row, rng):
    query = rng.uniform(20, np.array(IMAGE[::-1]) - 20, (row.inliers, 2)).astype(np.float32)
    return MatchedPixels(row.query, row.match, query, query + rng.normal(scale=4, size=query.shape).astype(np.float32))


def street(index):
    """Noise that takes about as many bytes as a photograph of a street: a few pictures, each shifted in many ways."""
    return np.roll(noise(index % 8), 31 * (index // 8), axis=1)


@cache
def noise(seed):
    rng = np.random.default_rng(seed)
    layers = [cv2.resize(rng.normal(size=(-(-IMAGE[0] // k), -(-IMAGE[1] // k))), IMAGE[::-1]) * k**0.5 for k in GRAINS]
    return cv2.normalize(sum(layers), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def dense_window(record):
    positions = np.concatenate([record.odometry, record.corrected])[:, :3, 3]
    return PlaneWindow.around(positions, 25.0, 0.5)


def top_view(height):
    return BirdsEyeView(height, np.full((*height.shape, 3), 127, np.uint8))


def write_dense(path, record, grid=None):
    """Write the page of a dense map of the record's landmarks."""
    window, maps = dense_window(record), []
    for state, poses, points in (
        ("before", record.odometry, record.map_before), ("after", record.corrected, record.map_after)
    ):  # fmt: skip
        surface = Surface(points.points, np.repeat(points.grey[:, None], 3, axis=1), np.zeros((0, 3), np.int32))
        maps.append(DenseOverview(state, render_birds_eye_view([surface], window), poses[:, :3, 3]))
    write_dense_page(path, maps, window, grid or OccupancyGrid(np.full((30, 50), 205, np.uint8), 0.5, np.zeros(2)))
