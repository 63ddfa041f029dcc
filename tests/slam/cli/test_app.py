"""What a person meets first: help, exit codes, and one line for whatever is wrong."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slam.apps import doctor
from slam.apps.doctor import Check
from slam.cli import app
from slam.errors import ConfigError, DataError, RevisitError

runner = CliRunner()


def exit_code(arguments: list[str]) -> int:
    return app._exit_code(lambda: app.app(arguments))


@pytest.mark.parametrize("command", ["demo", "simulate", "run", "doctor", "evaluate", "optimize", "benchmark"])
def test_help_names_every_command(command: str):
    assert command in runner.invoke(app.app, ["--help"]).output


def test_no_arguments_show_the_help():
    assert "Usage" in runner.invoke(app.app, []).output


@pytest.mark.parametrize(
    ("error", "code"), [(RevisitError("x"), 1), (DataError("x"), 1), (ConfigError("x"), 2), (KeyboardInterrupt(), 130)]
)
def test_each_kind_of_failure_has_its_exit_code(error: BaseException, code: int):
    def fails() -> None:
        raise error

    assert app._exit_code(fails) == code


def test_a_bug_keeps_its_traceback():
    def breaks() -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        app._exit_code(breaks)


def test_an_unknown_option_is_a_usage_error():
    assert exit_code(["run", "somewhere", "--out", "x", "--fast"]) == 2


def test_a_missing_folder_is_one_line_that_names_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out"
    assert exit_code(["run", str(tmp_path / "nowhere"), "--out", str(out)]) == 1
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert message.startswith(f"revisit: {tmp_path / 'nowhere'}")
    assert not out.exists()


@pytest.mark.parametrize(
    ("option", "value", "known"),
    [("--paradigm", "guess", "tracked-words"), ("--robust", "hope", "gnc"), ("--view", "hologram", "native")],
)
def test_an_unknown_name_is_a_usage_error_that_lists_the_known_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str, known: str
):
    assert exit_code(["run", str(tmp_path), "--out", str(tmp_path / "out"), option, value]) == 2
    assert known in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_doctor_finds_this_machine_well():
    assert exit_code(["doctor"]) == 0


def test_a_script_can_ask_the_doctor(monkeypatch: pytest.MonkeyPatch):
    ill = [Check("python", "3.11.7"), Check("libnowhere.so", "", "cannot be loaded: [Errno 2] <none>", "make it")]
    monkeypatch.setattr(doctor, "check_machine", lambda: ill)
    asked = runner.invoke(app.app, ["doctor", "--json"])
    assert [Check(**row) for row in json.loads(asked.output)] == ill
    assert asked.exit_code == runner.invoke(app.app, ["doctor"]).exit_code == 1
    assert "missing  libnowhere.so cannot be loaded: [Errno 2] <none>\n" in runner.invoke(app.app, ["doctor"]).output
    assert len(json.loads(runner.invoke(app.app, ["doctor", "--licences", "--json"]).output)) > 10
