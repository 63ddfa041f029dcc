"""Run a command and write what it used into a file: a process between `peers.py` and the program that it measures.

    python benchmarks/child_cost.py FILE COMMAND...

FILE becomes a line of JSON: seconds of wall-clock and processor time, peak resident memory in megabytes, exit code. The
peak of a new process on Linux begins at the size of the process that has started it, so this one must be small: it
imports nothing else. A command that cannot be started has the exit code 127.
"""

import json
import os
import sys
import time

BYTES_PER_KB, BYTES_PER_MB = 1024, 1e6  # Linux counts the memory in kilobytes
NOT_STARTED = 127


def measure(command: list[str]) -> dict[str, float]:
    """Run a command to its end and return what it and its children used."""
    start = time.perf_counter()
    try:
        child = os.posix_spawnp(command[0], command, os.environ)
    except OSError as error:
        print(f"{command[0]}: {error.strerror}", flush=True)
        return {"exit_code": NOT_STARTED}
    _, status, usage = os.wait4(child, 0)
    return {
        "wall_s": time.perf_counter() - start,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "peak_mb": usage.ru_maxrss * BYTES_PER_KB / BYTES_PER_MB,
        "exit_code": os.waitstatus_to_exitcode(status),
    }


if __name__ == "__main__":
    if len(sys.argv) < 3 or sys.argv[1] == "--help":
        print(f"usage: child_cost.py FILE COMMAND...\n\n{__doc__}")
        sys.exit(sys.argv[1:] != ["--help"])
    used = measure(sys.argv[2:])
    with open(sys.argv[1], "w") as file:  # noqa: PTH123, pathlib alone would be a third of this process
        file.write(json.dumps(used))
