"""Places where people work: read-only packages and homes, no home at all, consoles of other encodings."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from slam import environment
from slam.environment import MATPLOTLIB_CACHE, NUMBA_CACHE, can_create, prepare_caches, private_folder

ROOT = Path(__file__).parents[2]
UNWRITABLE = Path("/dev/null/below")  # to root as well


@pytest.fixture
def read_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Nothing can be written but a temporary folder."""
    monkeypatch.setattr(environment, "_compiled_folders", lambda: [UNWRITABLE])
    monkeypatch.setattr(environment.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setenv("HOME", str(UNWRITABLE))
    for variable in (NUMBA_CACHE, MATPLOTLIB_CACHE, "XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(variable, "")  # so that it is restored
        monkeypatch.delenv(variable)
    return tmp_path


def test_caches_go_to_a_private_temporary_folder(read_only: Path) -> None:
    prepare_caches()
    for variable in (NUMBA_CACHE, MATPLOTLIB_CACHE):
        folder = Path(os.environ[variable])
        assert folder.parent == read_only
        assert folder.stat().st_mode & 0o777 == 0o700
    assert environment.cache_folder().parent == read_only


@pytest.mark.parametrize("writable", ["package", "home", "named"])
def test_a_cache_that_can_be_written_stays_where_it_is(
    read_only: Path, monkeypatch: pytest.MonkeyPatch, writable: str
) -> None:
    if writable == "package":
        monkeypatch.setattr(environment, "_compiled_folders", lambda: [read_only / "__pycache__"])
    if writable == "home":
        monkeypatch.setenv("HOME", str(read_only))
    if writable == "named":
        monkeypatch.setenv(NUMBA_CACHE, str(read_only / "mine"))
    before = os.environ.get(NUMBA_CACHE)
    prepare_caches()
    assert os.environ.get(NUMBA_CACHE) == before


def test_a_folder_in_which_others_may_have_put_code_is_not_trusted(
    read_only: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(environment, "_SHARED_MEMORY", UNWRITABLE)
    folder = private_folder("numba")
    assert folder is not None
    folder.chmod(0o777)
    assert private_folder("numba") is None
    folder.rmdir()
    (read_only / "elsewhere").mkdir(mode=0o700)
    folder.symlink_to(read_only / "elsewhere")
    assert private_folder("numba") is None


def test_without_a_home_no_folder_called_tilde_is_made(read_only: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment.os.path, "expanduser", lambda path: path)  # no HOME, and no entry of the user
    assert not can_create(environment._cache_home())
    prepare_caches()
    assert Path(os.environ[NUMBA_CACHE]).parent == read_only


def printed(text: str, encoding: str) -> str:
    code = f"from slam.environment import prepare_consoles; prepare_consoles(); print({text!r})"
    command = [sys.executable, "-c", code]
    named = os.environ | {"PYTHONIOENCODING": encoding}
    return subprocess.run(command, env=named, cwd=ROOT, capture_output=True, check=True).stdout.decode(encoding)


@pytest.mark.parametrize("encoding", ["latin-1", "ascii"])
def test_a_console_replaces_what_its_encoding_lacks(encoding: str) -> None:
    assert printed("ATE \N{EN DASH}, \N{GREEK SMALL LETTER ALPHA}", encoding) == "ATE -, ?\n"


def test_a_console_that_shows_everything_changes_nothing() -> None:
    assert printed("ATE \N{EN DASH}", "utf-8") == "ATE \N{EN DASH}\n"


def test_a_reader_that_goes_away_costs_no_result(tmp_path: Path) -> None:
    done = tmp_path / "done"
    code = (
        "import pathlib, sys; from rich.console import Console; from slam.environment import outlive_readers;"
        " outlive_readers(); sys.stdin.readline(); Console().print('a'); print('b', flush=True);"
        f" print('c', file=sys.stderr); pathlib.Path({str(done)!r}).touch(); print('d')"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, **pipes) as process:  # type: ignore[call-overload]
        process.stdout.close()
        process.stderr.close()
        process.stdin.write(b"go on\n")
        process.stdin.close()
        assert process.wait(60) == 0
    assert done.exists()


def test_a_reader_that_stays_reads_everything() -> None:
    code = "from slam.environment import outlive_readers; outlive_readers(); print('a'); print('b', end='')"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=True).stdout == b"a\nb"
