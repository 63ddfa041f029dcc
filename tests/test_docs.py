"""The documentation: what a page says is in the code must be there. Needs no documentation tool."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
NAME = re.compile(r"\]\[([\w.]+)\]")
FILE = re.compile(r"`((?:examples|tests|place_recognition|slam|odometry|data)/[\w./]+\.\w+)`")
LINK = re.compile(r"\]\(([^)#]+)")


def resolves(name: str) -> bool:
    """Whether a dotted name is a class or a function at the top of its module."""
    module, _, member = name.rpartition(".")
    path = ROOT.joinpath(*module.split(".")).with_suffix(".py")
    if not path.is_file():
        return False
    defined = (ast.ClassDef, ast.FunctionDef)
    return any(isinstance(node, defined) and node.name == member for node in ast.parse(path.read_text()).body)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_every_link_of_a_page_resolves(page: Path):
    text = page.read_text()
    assert [name for name in NAME.findall(text) if not resolves(name)] == []
    assert [name for name in FILE.findall(text) if not (ROOT / name).is_file()] == []
    assert [name for name in LINK.findall(text) if not (page.parent / name).is_file()] == []


def test_a_name_that_is_not_there_does_not_resolve():
    assert resolves("slam.system.Slam")
    assert not resolves("slam.system.Slalom")
    assert not resolves("slam.systems.Slam")


def test_the_chapter_page_links_every_equation_and_figure_with_an_implementation():
    lines = [line for line in (ROOT / "docs" / "chapter.md").read_text().splitlines() if NAME.search(line)]
    equations, figures = " ".join(cells(lines, "equation")), " ".join(cells(lines, "figure"))
    assert {f"4.{k}" for k in range(1, 13)} <= set(re.findall(r"4\.\d+", equations))
    assert {f"4.{k}" for k in range(1, 17)} - {"4.10"} <= set(re.findall(r"4\.\d+", figures))


def cells(lines: list[str], table: str) -> list[str]:
    """First cells of the rows that one table of the chapter page holds."""
    text = (ROOT / "docs" / "chapter.md").read_text()
    body = text.split(f"| {table} |", 1)[1].split("\n\n", 1)[0]
    return [line.split("|")[1] for line in lines if line in body]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_every_page_is_in_the_contents(page: Path):
    assert str(page.relative_to(ROOT / "docs")) in (ROOT / "mkdocs.yml").read_text()
