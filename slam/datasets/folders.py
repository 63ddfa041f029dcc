"""Finds the folder of one sequence below the folder that the user named."""

from collections.abc import Callable
from pathlib import Path

from slam.errors import DataError


def subfolders(root: Path) -> list[Path]:
    """Folders in a folder, by name; an empty list if there is no such folder."""
    return sorted(item for item in root.iterdir() if item.is_dir()) if root.is_dir() else []


def contains_dataset(root: Path, is_dataset: Callable[[Path], bool]) -> bool:
    """Whether a folder is a dataset, or has one directly below it."""
    return root.is_dir() and (is_dataset(root) or any(is_dataset(folder) for folder in subfolders(root)))


def find_dataset(root: Path, sequence: str | None, is_dataset: Callable[[Path], bool], marker: str) -> Path:
    """Return the folder of one sequence: `root`, or the folder of that name directly below it.

    Args:
        root: folder that the user named.
        sequence: name of a folder below; None where there is only one dataset.
        is_dataset: whether a folder is a dataset of the format.
        marker: file by which the format is recognised, for the error message.

    Raises:
        DataError: there is no dataset, or there are several and none was named.
    """
    if sequence is None and is_dataset(root):
        return root
    datasets = {folder.name: folder for folder in subfolders(root) if is_dataset(folder)}
    if not datasets:
        raise DataError(f"{root}: expected {marker} in it or in a folder below, found none; check the path")
    name = sequence or next(iter(datasets))
    if name not in datasets or (sequence is None and len(datasets) > 1):
        wanted = f"one sequence {sequence}" if sequence else "one sequence"
        raise DataError(f"{root}: expected {wanted}, found {', '.join(datasets)}; choose one with --sequence")
    return datasets[name]
