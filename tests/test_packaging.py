"""What an installed wheel needs is in it."""

import subprocess
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("odometry", "place_recognition", "slam")


def tracked(package: str) -> list[Path]:
    try:
        listed = subprocess.run(
            ["git", "ls-files", "-z", package], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not a git checkout: which files belong to the project is unknown")
    return [ROOT / name for name in listed.split("\0") if name]


@pytest.mark.parametrize("package", PACKAGES)
def test_every_file_of_a_package_is_code_or_matches_a_pattern_of_the_package_data(package: str) -> None:
    patterns = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["*"]
    others = [path for path in tracked(package) if path.suffix != ".py"]
    assert [path.name for path in others if not any(fnmatch(path.name, pattern) for pattern in patterns)] == []


@pytest.mark.parametrize("package", PACKAGES)
def test_every_folder_with_files_is_a_package_or_inside_one(package: str) -> None:
    folders = {path.parent for path in tracked(package) if path.suffix == ".py"}
    assert [folder.name for folder in folders if not (folder / "__init__.py").is_file()] == []
    assert (ROOT / package / "py.typed").is_file()


def test_the_citation_names_the_version_of_the_project() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"version: {project['version']}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## {project['version']}" in (ROOT / "CHANGELOG.md").read_text()
