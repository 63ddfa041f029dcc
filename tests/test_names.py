"""The field's words: rules for names in code, help texts and headings (CONTRIBUTING.md gives them)."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from .command_lines import commands

ROOT = Path(__file__).parents[1]
PACKAGES = ("odometry", "place_recognition", "slam")
FOLDERS = (*PACKAGES, "tests", "benchmarks", "examples")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]

# Words that said something else to everybody but their author, and what is said now.
RETIRED = {
    "way": "distance, path length",
    "judge": "verifier, check",
    "proof": "verification",
    "prove": "verify",
    "opinion": "candidate beliefs",
    "verdict": "decision",
    "doubt": "rejection reason",
    "eye": "camera",
    "hindsight": "sequence consensus",
    "told": "description",
    "ledger": "loop log",
    "keeper": "session recorder",
    "thaw": "deserialize",
    "freezer": "serializer",
    "spokesman": "representative",
    "surprise": "chi square",
    "remembered": "replayed",
    "eavesdrop": "listen",
}
# Terms of the field that have one of these words in them.
COMPOUNDS = re.compile(r"birds?_?eye", re.IGNORECASE)
# Bounds are min_ and max_.
BOUNDS = re.compile(r"(^|_)(least(?!_squares)|most|fewest|longest|shortest)(_|$)")
UNITS = {
    "m", "px", "voxels", "rad", "deg", "s", "ms", "frames", "images", "hz", "fps", "mb", "gb", "bytes", "percent",
    "sigma", "per_m", "deg_per_m", "m_per_s", "per_360m",
}  # fmt: skip


def sources(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def words(name: str) -> set[str]:
    """Words of snake_case and CamelCase, lower case, without plural."""
    name = COMPOUNDS.sub("", name)
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", name)
    return {re.sub(r"(ies|s|d|ing)$", "", part.lower()) for part in parts} | {part.lower() for part in parts}


def defined(path: Path) -> Iterator[tuple[int, str]]:
    """Every name that a file gives to something: classes, functions, parameters, variables, attributes."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr


@pytest.mark.parametrize("folder", FOLDERS)
def test_no_identifier_has_a_retired_word(folder: str):
    found = [
        f"{path.relative_to(ROOT)}:{line} {name}"
        for path in sources(folder)
        for line, name in defined(path)
        if words(name) & RETIRED.keys()
    ]
    assert found == []


@pytest.mark.parametrize("folder", FOLDERS)
def test_no_file_or_folder_name_has_a_retired_word(folder: str):
    assert [path.name for path in (ROOT / folder).rglob("*") if words(path.stem) & RETIRED.keys()] == []


def retired_in(text: str) -> set[str]:
    return words(text) & (RETIRED.keys() - {"way"}) | set(re.findall(r"\bway driven|\bof way\b|\bmetres of way", text))


def test_no_help_text_has_a_retired_word():
    found = {}
    for names, command in commands():
        for text in (command.help or "", *(one.help or "" for one in command.params)):
            if retired_in(text):
                found[" ".join(names)] = text
    assert found == {}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_no_heading_has_a_retired_word(page: Path):
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    assert [heading for heading in headings if retired_in(heading)] == []


@pytest.mark.parametrize("folder", PACKAGES)
def test_bounds_are_min_and_max(folder: str):
    found = [
        f"{path.relative_to(ROOT)}:{line} {name}"
        for path in sources(folder)
        for line, name in defined(path)
        if BOUNDS.search(name.lower())
    ]
    assert found == []


def test_no_class_name_is_defined_twice():
    places = defaultdict(list)
    for path in sources(*PACKAGES):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(str(path.relative_to(ROOT)))
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def config_numbers(path: Path) -> Iterator[tuple[str, str]]:
    """Class and name of each field of a configuration that is a number with a fraction."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ClassDef) and node.name.endswith("Config"):
            for field in node.body:
                if isinstance(field, ast.AnnAssign) and ast.unparse(field.annotation).startswith("float"):
                    yield node.name, field.target.id  # type: ignore[union-attr]


# Numbers of a configuration that have no unit: ratios, shares, probabilities and weights.
DIMENSIONLESS = re.compile(
    r"ratio|share|fraction|probability|weight|score|similarity|factor|evidence|power|confidence|threshold|quality|overlap"
    r"|correlation|chi2|log10|decay|variance|scale|gain|contrast|significance|cosine|precision|recall|slope|quantile|distance$"
)


def test_configuration_fields_carry_their_unit():
    found = [
        f"{path.relative_to(ROOT)} {owner}.{name}"
        for path in sources(*PACKAGES)
        for owner, name in config_numbers(path)
        if not any(name == unit or name.endswith(f"_{unit}") for unit in UNITS) and not DIMENSIONLESS.search(name)
    ]
    assert found == []


def test_the_search_for_retired_words_finds_them():
    assert words("WayJudge") & RETIRED.keys() == {"way", "judge"}
    assert words("doubts_of") & RETIRED.keys() == {"doubt"}
    assert not words("always_eyed") & {"way"}
    assert BOUNDS.search("least_inliers")
    assert not BOUNDS.search("almost")
