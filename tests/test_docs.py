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


def rows(table: str) -> list[list[str]]:
    """Cells of the rows that one table of the chapter page holds."""
    body = (ROOT / "docs" / "chapter.md").read_text().split(f"| {table} |", 1)[1].split("\n\n", 1)[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in body.splitlines()[2:]]


def numbers(cells: list[str]) -> list[str]:
    return sorted(re.findall(r"4(?:\.\d+)+", " ".join(cells)))


def test_every_equation_of_the_chapter_is_linked_once():
    assert numbers([row[0] for row in rows("equation")]) == sorted(f"4.{k}" for k in range(1, 13))
    assert all(NAME.search(row[2]) for row in rows("equation"))


def test_every_figure_and_table_of_the_chapter_is_linked_and_says_what_draws_it_or_why_not():
    text = (ROOT / "docs" / "chapter.md").read_text()
    figures = [row for row in rows("figure") if not row[0].startswith("Table")]
    assert numbers([row[0] for row in figures]) == sorted(f"4.{k}" for k in range(1, 17) if k != 10)
    assert [row[0] for row in rows("figure") if row[0].startswith("Table")] == ["Table 4.2"]
    assert "Not implemented: Figure 4.10 and Table 4.1, which" in text
    assert all(NAME.search(row[1]) and row[2] for row in rows("figure"))
    for row in figures:
        for example in FILE.findall(row[2]):
            assert set(numbers([row[0]])) <= set(numbers([(ROOT / example).read_text()]))


def test_every_section_of_the_chapter_is_linked():
    known = {row[0] for row in rows("section")}
    parts = {"4.2.1": 2, "4.2.2": 2, "4.2.3": 5, "4.3": 3, "4.4": 4}
    inner = {f"{part}.{k}" for part, count in parts.items() for k in range(1, count + 1)}
    assert known == {"4.1", "4.5", "4.6"} | inner
    assert all(NAME.search(row[2]) for row in rows("section") if row[0] != "4.6")


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_every_page_is_in_the_contents(page: Path):
    assert str(page.relative_to(ROOT / "docs")) in (ROOT / "mkdocs.yml").read_text()
