"""Frames, landmarks and loop candidates as rows of a map database, and back."""

import json
import sqlite3
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry.motion import Motion
from place_recognition.recognizer import Belief, StageScores
from slam.frame_record import FrameRecord, LoopRecord
from slam.loop_closing.loop_closer import FrameLandmarks, LoopClosure, LoopVerification, Rejection
from slam.loop_closing.relative_pose import ScaleRatio


def frame_row(frame: FrameRecord, session: int) -> dict[str, Any]:
    """Columns of table `frame` but for those known at the end."""
    motion = frame.motion
    return {
        "image": frame.image,
        "session": session,
        "timestamp": frame.timestamp,
        "T_previous_camera": pack(motion.T_previous_current, "<f8"),
        "covariance": pack(motion.covariance, "<f8"),
        "predicted": motion.predicted,
        "reason": motion.reason,
        "inliers": int(motion.inliers.sum()),
        "tracks": len(motion.inliers),
        "residual_px": None if np.isnan(motion.residual_px) else motion.residual_px,
        "key_frame": frame.is_key_frame,
        "T_world_odometry": pack(frame.T_world_odometry, "<f8"),
        "T_world_online": pack(frame.T_world_online, "<f8"),
        "stage_ms": json.dumps(dict(frame.stage_ms)),
    }


def landmark_row(frame: FrameRecord) -> dict[str, Any]:
    """Columns of table `landmark`."""
    return {"image": frame.image} | landmark_values(frame.landmarks)


def landmark_values(seen: FrameLandmarks) -> dict[str, Any]:
    """Columns of table `landmark` but for the image."""
    return {
        "pixels": pack(seen.pixels, "<f4"),
        "points": pack(seen.points, "<f4"),
        "grey": pack(seen.grey, "u1"),
        "descriptors": pack(seen.descriptors, "<f2"),
    }


def loop_row(number: int, loop: LoopRecord) -> dict[str, Any]:
    """Columns of table `loop` except those known at the end."""
    belief, geometry = loop.belief, loop.geometry
    closed = geometry if isinstance(geometry, LoopClosure) else None
    pixels = (np.empty((0, 2)),) * 2 if geometry is None else (geometry.pixels_query, geometry.pixels_match)
    return {
        "number": number,
        "at_image": loop.at_image,
        "query": belief.query,
        "match": belief.match,
        "score": float(belief.score),
        "accepted": bool(belief.accepted),
        "inliers": None if belief.inliers is None else int(belief.inliers),
        "verified": bool(belief.verified),
        "stages": json.dumps(_stages(belief)),
        "pixels": pack(belief.pixels, "<f4"),
        "outcome": "" if geometry is None else "rejected" if closed is None else "closed",
        "geometry": json.dumps(_details(geometry)),
        "T_match_query": None if closed is None else pack(closed.T_match_query, "<f8"),
        "covariance": None if closed is None else pack(closed.covariance, "<f8"),
        "pixels_query": pack(pixels[0], "<f4"),
        "pixels_match": pack(pixels[1], "<f4"),
    }


def read_frame(row: sqlite3.Row, landmarks: FrameLandmarks) -> FrameRecord:
    """A frame from its row."""
    motion = Motion(
        T_previous_current=unpack(row["T_previous_camera"], "<f8", 4, 4),
        covariance=unpack(row["covariance"], "<f8", 6, 6),
        predicted=bool(row["predicted"]),
        reason=row["reason"],
        inliers=np.arange(row["tracks"]) < row["inliers"],
        residual_px=float("nan") if row["residual_px"] is None else row["residual_px"],
    )
    corrected = row["T_world_camera"]
    return FrameRecord(
        image=row["image"],
        timestamp=row["timestamp"],
        motion=motion,
        T_world_odometry=unpack(row["T_world_odometry"], "<f8", 4, 4),
        T_world_online=unpack(row["T_world_online"], "<f8", 4, 4),
        landmarks=landmarks,
        is_key_frame=bool(row["key_frame"]),
        stage_ms=json.loads(row["stage_ms"]),
        T_world_camera=None if corrected is None else unpack(corrected, "<f8", 4, 4),
        unit=1.0 if row["unit"] is None else row["unit"],
    )


def read_landmarks(row: sqlite3.Row) -> FrameLandmarks:
    """Landmarks of a frame, from their row."""
    pixels = unpack(row["pixels"], "<f4", -1, 2)
    count = len(pixels)
    return FrameLandmarks(
        pixels=pixels,
        points=unpack(row["points"], "<f4", count, 3),
        grey=unpack(row["grey"], "u1", count),
        descriptors=unpack(row["descriptors"], "<f2", count, len(row["descriptors"]) // (2 * count) if count else 0),
    )


def read_loop(row: sqlite3.Row) -> LoopRecord:
    """A loop record from its row."""
    stages = json.loads(row["stages"])
    belief = Belief(
        query=row["query"],
        match=row["match"],
        score=row["score"],
        accepted=bool(row["accepted"]),
        inliers=row["inliers"],
        verified=bool(row["verified"]),
        pixels=unpack(row["pixels"], "<f4", -1, 4),
        probability=stages.pop("probability"),
        answered_at=stages.pop("answered_at"),
        stages=StageScores(tuple(stages.pop("candidates")), **stages),
    )
    return LoopRecord(row["at_image"], belief, _geometry(row))


def _stages(belief: Belief) -> dict[str, Any]:
    scores = belief.stages
    return {
        "probability": _plain(belief.probability, float),
        "answered_at": _plain(belief.answered_at, int),
        "candidates": [int(image) for image in scores.candidates],
        "own_score": _plain(scores.own_score, float),
        "geometry_match": _plain(scores.geometry_match, int),
        "geometry_score": _plain(scores.geometry_score, float),
    }


def _plain(value: float | None, kind: type[float]) -> float | None:
    """A number as JSON knows it: recognisers may answer with numbers of NumPy."""
    return None if value is None else kind(value)


def _details(geometry: LoopVerification) -> dict[str, Any]:
    if geometry is None:
        return {}
    counts = {"matches": int(geometry.matches), "inliers": int(geometry.inliers)}
    if isinstance(geometry, Rejection):
        return counts | {"reason": geometry.reason}
    return counts | {"unit_log": float(geometry.scale.log), "unit_sigma": float(geometry.scale.sigma)}


def _geometry(row: sqlite3.Row) -> LoopVerification:
    details = json.loads(row["geometry"])
    seen: dict[str, Any] = {
        "pixels_query": unpack(row["pixels_query"], "<f4", -1, 2),
        "pixels_match": unpack(row["pixels_match"], "<f4", -1, 2),
    }
    if row["outcome"] == "":
        return None
    if row["outcome"] == "rejected":
        return Rejection(**details, **seen)
    scale = ScaleRatio(details.pop("unit_log"), details.pop("unit_sigma"))
    return LoopClosure(
        query=row["query"],
        match=row["match"],
        T_match_query=unpack(row["T_match_query"], "<f8", 4, 4),
        covariance=unpack(row["covariance"], "<f8", 6, 6),
        scale=scale,
        **details,
        **seen,
    )


def pack(array: NDArray[Any], dtype: str) -> bytes:
    """Bytes of an array, row by row."""
    return np.ascontiguousarray(array, dtype).tobytes()


def unpack(content: bytes, dtype: str, *shape: int) -> NDArray[Any]:
    """The array (shape) of bytes; it may be written to.

    Raises:
        ValueError: there are too few bytes, or too many.
    """
    return np.frombuffer(bytearray(content), dtype).reshape(shape)
