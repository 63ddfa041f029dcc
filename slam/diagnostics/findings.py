"""Findings about a dataset or a map, and the uses that they rule out."""

from dataclasses import dataclass, field
from enum import StrEnum


class Use(StrEnum):
    """Uses of a dataset; the value is the command."""

    STEREO = "revisit run"
    MONO = "revisit run --mono"
    PLACES = "revisit places"


SLAM_USES = (Use.STEREO, Use.MONO)
ALL_USES = tuple(Use)


class MapUse(StrEnum):
    """Uses of a saved map; the value is the command."""

    LOCATE = "revisit locate"
    RESUME = "revisit run --resume"


class Status(StrEnum):
    """Severity of a finding: no effect, worse results, or an impossible use."""

    OK = "ok"
    WARNING = "warning"
    FAULT = "fault"


@dataclass(frozen=True)
class Finding:
    """Result of one check.

    Attributes:
        topic: subject of the check, in a word or two.
        status: severity.
        text: what was found, and a remedy unless the status is OK.
        figures: measured numbers, SI units and pixels.
        forbids: uses that the finding makes impossible.
    """

    topic: str
    status: Status
    text: str
    figures: dict[str, object] = field(default_factory=dict)
    forbids: tuple[StrEnum, ...] = ()


def report_ok(topic: str, text: str, **figures: object) -> Finding:
    """Return a finding without consequences."""
    return Finding(topic, Status.OK, text, figures)


def report_warning(topic: str, text: str, **figures: object) -> Finding:
    """Return a finding that makes results worse."""
    return Finding(topic, Status.WARNING, text, figures)


def report_fault(topic: str, text: str, forbids: tuple[StrEnum, ...], **figures: object) -> Finding:
    """Return a finding that makes some uses impossible."""
    return Finding(topic, Status.FAULT, text, figures, forbids)


@dataclass(frozen=True)
class Inspection:
    """All findings about a dataset or a map.

    Attributes:
        source: path, as the user gave it.
        format: name of the dataset format, or "map".
        findings: results of all checks, those to be corrected first at the beginning.
        uses: all uses of a dataset or of a map.
    """

    source: str
    format: str
    findings: tuple[Finding, ...]
    uses: tuple[StrEnum, ...] = ALL_USES

    def reasons_against(self, use: StrEnum) -> list[str]:
        """Texts of the findings that make a use impossible; empty if it is possible."""
        return [finding.text for finding in self.findings if use in finding.forbids]

    @property
    def possible_uses(self) -> tuple[StrEnum, ...]:
        """Uses that no finding makes impossible."""
        return tuple(use for use in self.uses if not self.reasons_against(use))
