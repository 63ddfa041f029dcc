"""Which folder holds the drive that is meant."""

from collections.abc import Callable
from pathlib import Path

from slam.errors import DataError


def subfolders(root: Path) -> list[Path]:
    """Folders in a folder, by name; none where there is no such folder."""
    return sorted(item for item in root.iterdir() if item.is_dir()) if root.is_dir() else []


def holds_drives(root: Path, is_drive: Callable[[Path], bool]) -> bool:
    """Whether a folder is a drive, or holds some."""
    return root.is_dir() and (is_drive(root) or any(is_drive(folder) for folder in subfolders(root)))


def find_drive(root: Path, sequence: str | None, is_drive: Callable[[Path], bool], mark: str) -> Path:
    """Folder of one drive: `root`, or the one below it of that name.

    Args:
        root: what was named.
        sequence: name of a folder below; None where there is only one drive.
        is_drive: whether a folder is one.
        mark: file by which it is known, for the message.

    Raises:
        DataError: there is none, or several to choose from.
    """
    if sequence is None and is_drive(root):
        return root
    drives = {folder.name: folder for folder in subfolders(root) if is_drive(folder)}
    if not drives:
        raise DataError(f"{root}: expected {mark} in it or in a folder below, found none; check the path")
    name = sequence or next(iter(drives))
    if name not in drives or (sequence is None and len(drives) > 1):
        found = ", ".join(drives)
        raise DataError(f"{root}: expected one sequence{f' {sequence}' if sequence else ''}, found {found};"
                        " choose one with --sequence")  # fmt: skip
    return drives[name]
