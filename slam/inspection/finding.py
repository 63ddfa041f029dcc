"""What was found out about a recording, and what that means for its use."""

from dataclasses import dataclass, field
from enum import StrEnum


class Use(StrEnum):
    """What a recording can serve for; the value is what to type."""

    STEREO = "revisit run"
    MONO = "revisit run --mono"
    PLACES = "revisit places"


DRIVING = (Use.STEREO, Use.MONO)
EVERYTHING = tuple(Use)


class MapUse(StrEnum):
    """What a saved map can serve for."""

    LOCATE = "revisit locate"
    RESUME = "revisit run --resume"


class Status(StrEnum):
    """How bad a finding is."""

    GOOD = "ok"
    DOUBTFUL = "warning"
    BAD = "fault"


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        topic: what, in a word or two.
        status: how bad.
        text: what was found, and a remedy where it is not good.
        figures: the numbers behind it, SI units and pixels.
        forbids: what cannot be done, because of it.
    """

    topic: str
    status: Status
    text: str
    figures: dict[str, object] = field(default_factory=dict)
    forbids: tuple[StrEnum, ...] = ()


def good(topic: str, text: str, **figures: object) -> Finding:
    """A finding that nobody needs to worry about."""
    return Finding(topic, Status.GOOD, text, figures)


def doubtful(topic: str, text: str, **figures: object) -> Finding:
    """A finding that makes results worse."""
    return Finding(topic, Status.DOUBTFUL, text, figures)


def bad(topic: str, text: str, forbids: tuple[StrEnum, ...], **figures: object) -> Finding:
    """A finding that makes something impossible."""
    return Finding(topic, Status.BAD, text, figures, forbids)


@dataclass(frozen=True)
class Inspection:
    """All findings about a recording or a map.

    Attributes:
        source: path, as it was named.
        kind: layout.
        findings: in the order in which they would be mended.
        uses: what such things are for.
    """

    source: str
    kind: str
    findings: tuple[Finding, ...]
    uses: tuple[StrEnum, ...] = EVERYTHING

    def hindrances(self, use: StrEnum) -> list[str]:
        """Why it cannot serve for something; empty where it can."""
        return [finding.text for finding in self.findings if use in finding.forbids]

    @property
    def serves(self) -> tuple[StrEnum, ...]:
        """What it can serve for."""
        return tuple(use for use in self.uses if not self.hindrances(use))
