"""Under which licences everything stands that Revisit is installed with, as the packages themselves declare."""

import re
from dataclasses import dataclass
from importlib import metadata

DISTRIBUTION = "revisit-slam"


@dataclass(frozen=True)
class Licence:
    """One installed package.

    Attributes:
        package: its name.
        version: the installed one.
        licence: an SPDX expression where the package gives one, else the name it uses; "unknown" without either.
        direct: Revisit names it itself, and no other package does it for Revisit.
    """

    package: str
    version: str
    licence: str
    direct: bool


def licences(distribution: str = DISTRIBUTION) -> list[Licence]:
    """All packages that a distribution needs, and those that these need, by name; extras are left out.

    Raises:
        importlib.metadata.PackageNotFoundError: the distribution is not installed.
    """
    direct = _needed(distribution)
    found: dict[str, Licence] = {}
    waiting = sorted(direct)
    while waiting:
        name = waiting.pop()
        if name in found or not _installed(name):
            continue
        found[name] = Licence(name, metadata.version(name), declared(metadata.metadata(name)), name in direct)
        waiting += sorted(_needed(name))
    return [found[name] for name in sorted(found)]


def declared(about: metadata.PackageMetadata) -> str:
    """The licence that the metadata of a package declare: as an expression, a classifier or a first line of text."""
    fields = about.get_all("Classifier") or []
    classified = [field.split(" :: ")[-1] for field in fields if field.startswith("License :: OSI Approved ::")]
    text = (about.get_all("License") or [""])[0].strip()
    expression = about.get_all("License-Expression") or []
    candidates = [*expression, "; ".join(classified), *text.splitlines()[:1]]
    return next((candidate for candidate in candidates if candidate), "unknown")


def _needed(distribution: str) -> set[str]:
    """Names of the packages that a distribution needs without any extra."""
    required = metadata.requires(distribution) or []
    names = (re.match(r"[\w.-]+", line) for line in required if "extra ==" not in line)
    return {re.sub(r"[-_.]+", "-", name.group()).lower() for name in names if name}


def _installed(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:  # needed on another system or version of Python only
        return False
    return True
