"""Checks of a saved map: is the file complete, and are its contents consistent?"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.diagnostics.findings import Finding, Inspection, MapUse, Status, report_fault
from slam.errors import DataError
from slam.frame_record import FrameRecord
from slam.map_database import schema
from slam.map_database.checkpoint import serialize
from slam.map_database.database import MAP_FILE, MapDatabase, map_file

Array = NDArray[np.float64]

CheckResult = tuple[Status, str]
Check = Callable[[MapDatabase], CheckResult]

_ALL_MAP_USES = tuple(MapUse)
_HEADER, _APPLICATION_AT = b"SQLite format 3\0", 68  # of the file format, section 1.3
_MAX_ROTATION_ERROR = 1e-6  # of the elements of R R^T - 1
_MAX_DESCRIPTOR = 1.01  # of the numbers of a descriptor of unit length, with room for rounding


def is_map(path: Path) -> bool:
    """Return whether a path is a saved map: the folder of a run that has one, or a file by its suffix or first bytes.

    A file with the suffix counts even if it is damaged: its error message is then about a map.
    """
    if path.is_dir():
        return (path / MAP_FILE).is_file()
    if path.suffix == Path(MAP_FILE).suffix:
        return True
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(_APPLICATION_AT + 4)
    return head.startswith(_HEADER) and head[_APPLICATION_AT:] == schema.APPLICATION.to_bytes(4, "big")


def inspect_map(path: Path) -> Inspection:
    """Inspect a saved map, or the map of a run in a folder; a fault that keeps it from being read is a finding too."""
    file = map_file(path)
    try:
        with MapDatabase.open(file) as database:
            findings = tuple(_run_check(topic, check, database) for topic, check in _CHECKS.items())
    except DataError as error:
        findings = (report_fault("file", str(error), _ALL_MAP_USES),)
    return Inspection(str(path), "map", findings, _ALL_MAP_USES)


def _run_check(topic: str, check: Check, database: MapDatabase) -> Finding:
    forbids = (MapUse.RESUME,) if topic == "checkpoint" else _ALL_MAP_USES
    try:
        status, text = check(database)
    except DataError as error:
        status, text = Status.FAULT, str(error)
    return Finding(topic, status, text, forbids=forbids if status is Status.FAULT else ())


def _file(database: MapDatabase) -> CheckResult:
    messages = [row[0] for row in database.query("PRAGMA integrity_check(3)")]
    if messages != ["ok"]:
        return (
            Status.FAULT,
            f"{database.path}: expected a sound file, SQLite finds {messages[0]}; copy it again or run again",
        )
    size = sum(
        row[0] for row in database.query("SELECT page_count * page_size FROM pragma_page_count, pragma_page_size")
    )
    return Status.OK, f"sound, {size / 1e6:.1f} MB"


def _tables(database: MapDatabase) -> CheckResult:
    lost = schema.missing_columns(database.query)
    if lost:
        return Status.FAULT, f"expected the columns of version {schema.VERSION}, found no {lost[0]}; run again"
    stray = database.query("PRAGMA foreign_key_check")
    if stray:
        return Status.FAULT, f"{len(stray)} rows of {stray[0]['table']} belong to no {stray[0]['parent']}; run again"
    return Status.OK, f"version {schema.VERSION}, all rows belong together"


def _drives(database: MapDatabase) -> CheckResult:
    sessions = database.sessions()
    if not sessions:
        return Status.FAULT, "expected a drive, found none; a run writes one: revisit run SOURCE --out DIR"
    counts = [database.images(session.number) for session in sessions]
    firsts = [session.first_image for session in sessions]
    if firsts != np.concatenate([[0], np.cumsum(counts)[:-1]]).tolist():
        return Status.FAULT, f"expected drives that follow one another, found them begin at images {firsts}; run again"
    unfinished = [session.name for session in sessions if not session.finished]
    if unfinished:
        return (
            Status.WARNING,
            f"{', '.join(unfinished)} did not end, so no pose is corrected yet; continue with --resume",
        )
    return Status.OK, f"{len(sessions)}, all complete"


def _frames(database: MapDatabase) -> CheckResult:
    count, landmarks, numbers = database.images(), 0, set()
    for expected, frame in enumerate(database.frames()):
        if frame.image != expected:
            return Status.FAULT, f"image {expected} is missing, or its landmarks are; run again"
        fault = _fault(frame)
        if fault:
            return Status.FAULT, f"image {frame.image}: {fault}; run again"
        landmarks += len(frame.landmarks)
        numbers |= {frame.landmarks.descriptors.shape[1]} if len(frame.landmarks) else set()
    if database.count("landmark") != count or len(numbers) > 1:
        return Status.FAULT, f"expected landmarks of one kind for {count} images, found others; run again"
    if landmarks == 0:
        return Status.FAULT, "expected landmarks, found none in any image; no place can be recognised with this map"
    return Status.OK, f"{count}, {len(database.key_frames())} key frames, {landmarks} landmarks"


def _fault(frame: FrameRecord) -> str:
    """Return what of a frame is impossible; empty if nothing is."""
    poses = [frame.T_world_odometry, frame.T_world_online, frame.motion.T_previous_current]
    poses += [] if frame.T_world_camera is None else [frame.T_world_camera]
    if not all(_is_pose(T) for T in poses):
        return "expected poses with rotation matrices, found others"
    seen = frame.landmarks
    if not all(np.isfinite(array).all() for array in (seen.pixels, seen.points, seen.descriptors)):
        return "expected finite landmarks, found others"
    if np.abs(seen.descriptors).max(initial=0) > _MAX_DESCRIPTOR or (seen.points[:, 2] <= 0).any():
        return "expected landmarks before the camera with descriptors of unit length, found others"
    return "" if np.isfinite(frame.unit) and frame.unit > 0 else f"expected a length as its unit, found {frame.unit}"


def _is_pose(T: Array) -> bool:
    R = T[:3, :3]
    error = np.abs(R @ R.T - np.eye(3)).max()
    rigid = error < _MAX_ROTATION_ERROR and np.linalg.det(R) > 0 and T[3].tolist() == [0, 0, 0, 1]
    return bool(np.isfinite(T).all() and rigid)


def _loops(database: MapDatabase) -> CheckResult:
    images = database.images()
    for number, loop in enumerate(database.loops()):
        belief = loop.belief
        match = belief.query - 1 if belief.match is None else belief.match
        if not -1 <= match < belief.query < images:
            found = f"{belief.query} and {belief.match}"
            return Status.FAULT, f"loop {number}: expected two of {images} images, found {found}; run again"
    (row,) = database.query("SELECT count(*), total(outcome = 'closed'), total(kept) FROM loop")
    return Status.OK, f"{row[0]} candidates of the recogniser, {row[1]:.0f} closed, {row[2]:.0f} kept in the end"


def _checkpoint(database: MapDatabase) -> CheckResult:
    sessions = database.sessions()
    newest = sessions[-1].number if sessions else 0
    checkpoint = database.checkpoint(newest)
    if checkpoint is None:
        return Status.WARNING, "there is none; a resumed run would begin again at the first frame"
    frames = database.images(newest)
    if checkpoint.frames != frames:
        return Status.FAULT, f"expected it after {frames} frames, found it after {checkpoint.frames}; run again"
    _, arrays = serialize(checkpoint.state)
    return Status.OK, f"after {frames} frames, {sum(array.nbytes for array in arrays) / 1e6:.1f} MB"


_CHECKS: dict[str, Check] = {
    "file": _file,
    "tables": _tables,
    "drives": _drives,
    "frames": _frames,
    "loops": _loops,
    "checkpoint": _checkpoint,
}
