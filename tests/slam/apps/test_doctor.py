"""The doctor names what is missing and the command that installs it."""

import pytest

from slam.apps import doctor


def test_a_machine_that_runs_the_tests_is_well():
    assert [check for check in doctor.check_machine() if check.problem] == []


def test_a_missing_library_is_named_with_its_package(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(doctor, "SYSTEM_LIBRARIES", {"libnowhere.so.9": "libnowhere9"})
    (check,) = (check for check in doctor.check_machine() if check.problem)
    assert check.name == "libnowhere.so.9"
    assert check.remedy.endswith("apt-get install --yes --no-install-recommends libnowhere9")


def test_without_rights_the_command_is_printed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr(doctor, "SYSTEM_LIBRARIES", {"libnowhere.so.9": "libnowhere9"})
    monkeypatch.setattr(doctor.os, "geteuid", lambda: 1000)
    assert doctor.install_libraries() == 1
    assert "sudo apt-get install --yes --no-install-recommends libnowhere9" in capsys.readouterr().err


def test_nothing_is_installed_where_nothing_is_missing(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(doctor.subprocess, "run", lambda *_args, **_kwargs: pytest.fail("ran a command"))
    monkeypatch.setattr(doctor.shutil, "which", lambda program: f"/usr/bin/{program}")
    assert doctor.install_libraries() == 0
    assert doctor.install_browser() == 0


def test_a_browser_that_cannot_be_installed_is_named_and_fails_nothing_else(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(doctor.shutil, "which", lambda _program: None)
    assert doctor.install_browser() == 1
    assert "apt-get install --yes --no-install-recommends chromium chromium-driver" in capsys.readouterr().err
    assert not any("chrom" in check.name for check in doctor.check_machine())
