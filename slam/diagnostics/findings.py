"""Findings about a dataset or a map, and the uses that they rule out."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from slam.errors import DataError


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


_WHOLE = ("opening", "images")  # topics whose text is a whole message, of the file that cannot be read


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

    @property
    def sentence(self) -> str:
        """The text after its topic, for where it does not stand in a table."""
        is_whole = self.topic in _WHOLE or self.text.startswith(self.topic)
        return self.text if is_whole else f"{self.topic}: {self.text}"


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


def remarks_for(use: StrEnum, source: Path, findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return what a use of a dataset has to be told; what makes it impossible is an error in the same words.

    Args:
        use: the use.
        source: path of the dataset, for the error.
        findings: findings about it.

    Raises:
        DataError: a finding makes the use impossible.
    """
    faults = [finding.sentence for finding in findings if use in finding.forbids]
    if faults:
        line = "; ".join(faults)
        raise DataError(line if line.startswith(str(source)) else f"{source}: {line}")
    return tuple(finding.sentence for finding in findings if finding.status is not Status.OK)
