"""Licences of all installed packages that Revisit depends on, as the packages declare them."""

import re
from dataclasses import dataclass
from importlib import metadata

DISTRIBUTION = "revisit-slam"


@dataclass(frozen=True)
class Licence:
    """Licence of one installed package.

    Attributes:
        package: name of the package.
        version: installed version.
        licence: SPDX expression if the package gives one, else the name that it uses; "unknown" without either.
        direct: whether Revisit itself requires the package.
    """

    package: str
    version: str
    licence: str
    direct: bool


def licences(distribution: str = DISTRIBUTION) -> list[Licence]:
    """List the packages that a distribution requires, directly or indirectly, by name; without extras.

    Raises:
        importlib.metadata.PackageNotFoundError: the distribution is not installed.
    """
    direct = _requirements(distribution)
    found: dict[str, Licence] = {}
    waiting = sorted(direct)
    while waiting:
        name = waiting.pop()
        if name in found or not _is_installed(name):
            continue
        found[name] = Licence(name, metadata.version(name), declared_licence(metadata.metadata(name)), name in direct)
        waiting += sorted(_requirements(name))
    return [found[name] for name in sorted(found)]


def declared_licence(about: metadata.PackageMetadata) -> str:
    """Read the licence from the metadata of a package: its expression, its classifiers or its first line of text."""
    fields = about.get_all("Classifier") or []
    classified = [field.split(" :: ")[-1] for field in fields if field.startswith("License :: OSI Approved ::")]
    text = (about.get_all("License") or [""])[0].strip()
    expression = about.get_all("License-Expression") or []
    candidates = [*expression, "; ".join(classified), *text.splitlines()[:1]]
    return next((candidate for candidate in candidates if candidate), "unknown")


def _requirements(distribution: str) -> set[str]:
    """Names of the packages that a distribution requires without extras."""
    required = metadata.requires(distribution) or []
    names = (re.match(r"[\w.-]+", line) for line in required if "extra ==" not in line)
    return {re.sub(r"[-_.]+", "-", name.group()).lower() for name in names if name}


def _is_installed(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:  # required only on another system or Python version
        return False
    return True
