"""What came of the inputs that were tried."""

from dataclasses import dataclass, field


@dataclass
class Tally:
    """Counts of one process, or of several.

    Attributes:
        inputs: tried.
        accepted: of these; the others were refused, or failed.
        slowest_ms: of all calls.
        peak_mb: memory of a process.
        failures: of each kind, the first file and how many there were.
    """

    inputs: int = 0
    accepted: int = 0
    slowest_ms: float = 0.0
    peak_mb: float = 0.0
    failures: dict[str, tuple[str, int]] = field(default_factory=dict)

    def fail(self, kind: str, file: str, count: int = 1) -> None:
        """Count a failure; the file of the first of its kind is kept."""
        first, before = self.failures.get(kind, (file, 0))
        self.failures[kind] = (first, before + count)

    def add(self, other: "Tally") -> None:
        """Take in what another process found."""
        self.inputs += other.inputs
        self.accepted += other.accepted
        self.slowest_ms = max(self.slowest_ms, other.slowest_ms)
        self.peak_mb = max(self.peak_mb, other.peak_mb)
        for kind, (file, count) in other.failures.items():
            self.fail(kind, file, count)

    @property
    def failed(self) -> int:
        """Inputs that failed."""
        return sum(count for _, count in self.failures.values())

    @property
    def refused(self) -> int:
        """Inputs that were refused as they should be."""
        return max(self.inputs - self.accepted - self.failed, 0)
