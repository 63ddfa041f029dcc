"""Every dependency stands under a licence that an MIT project may use, and is named with it."""

import tomllib
from email.message import Message
from pathlib import Path

from slam.apps.doctor import declared_licence, licences

ROOT = Path(__file__).parents[3]
FREE = (
    "MIT",
    "BSD",
    "Apache",
    "ISC",
    "Python Software Foundation",
    "PSF",
    "MPL",
    "Mozilla",
    "Zlib",
    "Unlicense",
    "CC0",
)


def test_every_dependency_that_is_named_is_listed_with_its_licence() -> None:
    named = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    listed = {one.package for one in licences() if one.direct}
    assert {line.split(">")[0].lower() for line in named} <= listed


def test_no_installed_dependency_forbids_use_in_an_mit_project() -> None:
    other = {one.package: one.licence for one in licences() if not any(name in one.licence for name in FREE)}
    assert other == {}
    assert "evo" not in {one.package for one in licences()}  # GPL: in the tests alone


def about(**fields: str) -> Message:
    message = Message()
    for name, value in fields.items():
        message[name.replace("_", "-")] = value
    return message


def test_an_expression_goes_before_a_classifier_and_that_before_text() -> None:
    classifier = "License :: OSI Approved :: MIT License"
    assert declared_licence(about(License_Expression="0BSD", Classifier=classifier, License="long text")) == "0BSD"
    assert declared_licence(about(Classifier=classifier, License="long text")) == "MIT License"
    assert declared_licence(about(Classifier="License :: OSI Approved", License="Free\nas in air")) == "Free"
    assert declared_licence(about(Classifier="Topic :: Games")) == "unknown"
