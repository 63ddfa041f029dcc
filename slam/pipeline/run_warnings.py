"""Warnings of a run: said on the screen and in run.log as they come, and kept for metrics.json and the report."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from rich.console import Console

from slam.errors import RevisitError

Result = TypeVar("Result")

_MAX_REASON_LENGTH = 300  # characters: a library may print a page

log = logging.getLogger("revisit")


@dataclass(frozen=True)
class RunWarnings:
    """Collects the warnings of a run.

    Attributes:
        messages: console on which they are shown.
        staging: folder whose path is left out of the reasons, as the results leave it.
        texts: the warnings so far, a sentence each.
    """

    messages: Console
    staging: Path | None = None
    texts: list[str] = field(default_factory=list)

    def add(self, text: str) -> None:
        """Add a warning, unless it is known."""
        if text in self.texts:
            return
        self.texts.append(text)
        log.warning("%s", text)
        self.messages.print(f"warning: {text}", markup=False, highlight=False, soft_wrap=True)

    def extend(self, texts: Iterable[str]) -> None:
        """Add several warnings."""
        for text in texts:
            self.add(text)

    def attempt(self, what: str, compute: Callable[[], Result], otherwise: Callable[[str], Result]) -> Result:
        """Return a result that a run can do without, or a substitute for it and a warning.

        Whatever fails after the last frame costs its own result alone, even by a bug: the drive cannot be repeated. Its
        traceback stands in run.log.

        Args:
            what: name of the result.
            compute: computes it.
            otherwise: makes the substitute from the reason of the failure.
        """
        try:
            return compute()
        except Exception as error:
            reason = describe_error(error).replace(f"{self.staging}/", "")
            log.info("traceback of the failure of: %s", what, exc_info=True)
            self.add(f"{what}: left out, {reason}")
            return otherwise(reason)

    def attempt_to(self, what: str, act: Callable[[], None]) -> bool:
        """Do something that a run can do without, such as to write a picture; whether it succeeded."""

        def succeed() -> bool:
            act()
            return True

        return self.attempt(what, succeed, lambda _reason: False)


def describe_error(error: Exception) -> str:
    """Return the reason of a failure as one line."""
    words = " ".join(str(error).split())
    is_explained = words and isinstance(error, RevisitError | OSError | RuntimeError)
    line = words if is_explained else f"{type(error).__name__}: {words}"
    return line if len(line) <= _MAX_REASON_LENGTH else f"{line[:_MAX_REASON_LENGTH]} ..."
