"""Image files and a stopwatch for the benchmarks of place recognition."""

import re
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any


def image_files(folder: Path) -> list[Path]:
    """List the images of a folder, or of the image_0 in it, in the natural order of their names."""
    folder = folder / "image_0" if (folder / "image_0").is_dir() else folder
    files = [f for f in folder.iterdir() if f.suffix.lower() in {".png", ".jpg", ".jpeg"}]
    return sorted(files, key=lambda f: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", f.name)])


class Stopwatch:
    """Measures the time of each call of functions, which it replaces by timed ones.

    Args of the constructor:
        clock: function that returns seconds; `time.process_time` on a machine with other work.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self.milliseconds: dict[str, list[float]] = defaultdict(list)
        self.running = True
        self._watched: list[tuple[Any, str, Any]] = []

    def watch(self, stage: str, owner: Any, name: str) -> None:
        """Measure every call of owner.name from now on."""
        original = getattr(owner, name)
        self._watched.append((owner, name, original))
        setattr(owner, name, self.timed(stage, original))

    def stop(self) -> None:
        """Restore all functions."""
        for owner, name, original in self._watched:
            setattr(owner, name, original)

    def timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap a function so that its calls are timed while the watch runs."""

        def measured(*arguments: Any) -> Any:
            begin = self._clock()
            result = function(*arguments)
            if self.running:
                self.milliseconds[stage].append(1e3 * (self._clock() - begin))
            return result

        return measured
