"""The commands that pages and helps show, as a person would type them."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from slam.cli import app

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "data" / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
APP = typer.main.get_command(app.app)
LINE = re.compile(r"^ *revisit ([^`\n]*)$", re.MULTILINE)
MENTION = re.compile(r"`revisit ([^`]+)`")
EXAMPLE = re.compile(r"^ *Example: revisit (.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Shown:
    """A command in a page or in a help: where, and its words after `revisit`."""

    where: str
    words: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.where}: revisit {' '.join(self.words)}"

    @property
    def name(self) -> str:
        return self.words[0]


def commands(group: Any = APP, *before: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command with its names, such as (evaluate, loops)."""
    for name, command in sorted(getattr(group, "commands", {}).items()):
        if hasattr(command, "commands"):
            yield from commands(command, *before, name)
        else:
            yield (*before, name), command


def lines() -> list[Shown]:
    """Whole commands: lines of the pages, and examples of the helps."""
    in_pages = [Shown(page.name, words(found)) for page in PAGES for found in LINE.findall(page.read_text())]
    in_helps = [Shown("help", words(found)) for _, one in commands() for found in EXAMPLE.findall(one.help or "")]
    return in_pages + in_helps


def mentions() -> list[Shown]:
    """Commands within sentences, which may leave out anything."""
    return [Shown(page.name, words(found)) for page in PAGES for found in MENTION.findall(page.read_text())]


def words(line: str) -> tuple[str, ...]:
    return tuple(shlex.split(line, comments=True))


def find(shown: Shown) -> tuple[Any, list[str]]:
    """The command itself and the words that follow its name."""
    command, rest = APP, list(shown.words)
    while rest and hasattr(command, "commands") and rest[0] in command.commands:
        command = command.commands[rest.pop(0)]
    return command, rest
