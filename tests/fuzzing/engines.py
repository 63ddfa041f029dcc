"""Three ways to make inputs: damage valid files, put together, or be guided by the lines that are reached."""

import random
from pathlib import Path
from typing import Protocol

from hypothesis import HealthCheck, Phase, given, seed, settings

from .mutations import MOST_BYTES, mutated
from .readers import Reader

_IN_ONE_GO = 2000  # of hypothesis, which repeats itself in long runs


class Trial(Protocol):
    """Tries inputs on a reader."""

    reader: Reader

    def __call__(self, data: bytes) -> None:
        """Try one."""

    def finish(self) -> None:
        """Write down what came of them, and end the process."""


def damaged(trial: Trial, count: int, start: int) -> None:
    """Try valid files that were damaged."""
    rng, seeds = random.Random(start), trial.reader.seeds()
    for _ in range(count):
        trial(mutated(rng, seeds))


def put_together(trial: Trial, count: int, start: int) -> None:
    """Try what hypothesis makes of a strategy."""
    for part, first in enumerate(range(0, count, _IN_ONE_GO)):
        run = given(trial.reader.generated)(trial.__call__)
        few = settings(
            max_examples=min(_IN_ONE_GO, count - first), database=None, deadline=None, phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )  # fmt: skip
        seed(start + part)(few(run))()


def guided(trial: Trial, count: int, start: int) -> None:
    """Try what atheris changes so that it reaches new lines. Ends the process, as libFuzzer does."""
    import atheris

    corpus, left = Path("corpus"), count
    corpus.mkdir()
    for index, data in enumerate(trial.reader.seeds()):
        (corpus / str(index)).write_bytes(data)

    def one(data: bytes) -> None:
        nonlocal left
        trial(data)
        left -= 1
        if left <= 0:
            trial.finish()

    def changed(data: bytes, most: int, number: int) -> bytes:
        rng = random.Random(number)
        return mutated(rng, [data])[:most] if rng.random() < 0.5 else atheris.Mutate(data, most)

    limits = [f"-max_len={MOST_BYTES}", f"-seed={start + 1}", "-rss_limit_mb=4096", "-timeout=60", "-verbosity=0"]
    atheris.Setup(["fuzz", f"-runs={2 * count + 1000}", *limits, str(corpus)], one, custom_mutator=changed)
    atheris.Fuzz()


ENGINES = {"damaged": damaged, "generated": put_together, "guided": guided}
