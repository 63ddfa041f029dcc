"""Every command that a page or a help shows can be typed, and every command's help shows one."""

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import pytest
from typer.testing import CliRunner

from slam.cli import app, options
from slam.config import RunConfig
from slam.errors import ConfigError

from .command_lines import APP, EXAMPLE, Shown, commands, find, lines, mentions

COMMANDS = [pytest.param(names, command, id=" ".join(names)) for names, command in commands()]
WIDE = {"COLUMNS": "200"}
# What numbers are measured in, or count; a seed is neither.
UNITS = re.compile(r"metres|seconds?\b|degrees|pixels|images|number of|index of|seed", re.IGNORECASE)
NO_NOUN = re.compile(r"(Of|With|Within|By|For|In|How many|What|Whose|Only)\b")


@pytest.mark.parametrize("shown", lines(), ids=str)
def test_a_shown_command_is_understood(shown: Shown):
    command, rest = find(shown)
    assert not hasattr(command, "commands"), "no such command"
    command.make_context(shown.name, rest)


@pytest.mark.parametrize("shown", mentions(), ids=str)
def test_a_mentioned_command_and_its_options_exist(shown: Shown):
    command, rest = find(shown)
    assert command is not APP, "no such command"
    known = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    assert {word for word in rest if word.startswith("--")} <= known


def test_pages_show_many_commands_and_a_wrong_one_would_be_noticed():
    assert len(lines()) > 30
    assert len({shown.words[0] for shown in lines()}) >= 12
    command, rest = find(Shown("nowhere", ("run", "there", "--out", "x", "--faster")))
    with pytest.raises(Exception, match="No such option: --faster"):
        command.make_context("run", rest)


def numbers(function: Callable[..., Any]) -> dict[str, str]:
    """The parameters of a command that are numbers, each with its help text."""
    parameters = inspect.signature(function).parameters.values()
    hints = {parameter.name: get_args(parameter.annotation) for parameter in parameters}
    return {name: option.help for name, (kind, option, *_) in hints.items() if {int, float} & {kind, *get_args(kind)}}


@pytest.mark.parametrize(("names", "command"), COMMANDS)
def test_a_help_has_an_example_that_begins_with_the_command(names: tuple[str, ...], command: Any):
    examples = EXAMPLE.findall(command.help)
    assert examples
    assert all(example.startswith(" ".join(names)) for example in examples)


@pytest.mark.parametrize(("names", "command"), COMMANDS)
def test_every_option_has_a_help_that_stands_alone(names: tuple[str, ...], command: Any):
    """It is a sentence or a noun phrase: it does not begin with a preposition whose noun is missing."""
    helps = {one.name: one.help or "" for one in command.params}
    assert {name: text for name, text in helps.items() if not re.fullmatch(r"[A-Z].*\.", text)} == {}
    assert {name: text for name, text in helps.items() if NO_NOUN.match(text)} == {}


@pytest.mark.parametrize(("names", "command"), COMMANDS)
def test_the_help_of_every_number_names_its_unit(names: tuple[str, ...], command: Any):
    assert {name: text for name, text in numbers(command.callback).items() if not UNITS.search(text)} == {}


@pytest.mark.parametrize(("names", "command"), COMMANDS)
def test_a_help_in_a_pipe_is_plain_text_with_every_default(names: tuple[str, ...], command: Any):
    text = CliRunner().invoke(app.app, [*names, "--help"], env=WIDE).output
    assert "\x1b" not in text
    valued = [one for one in command.params if not one.required and not getattr(one, "is_flag", False)]
    for one in valued:
        default = f"({one.show_default})" if isinstance(one.show_default, str) else one.default
        assert default is not None, f"{one.name}: the help does not say what happens without it"
        assert f"[default: {default}" in text, one.name


@pytest.mark.parametrize(("names", "command"), COMMANDS)
def test_option_names_are_no_retired_words(names: tuple[str, ...], command: Any):
    words = {word for one in command.params for name in one.opts for word in name.strip("-").split("-")}
    assert not words & {"way", "heading", "alike", "relight", "kind", "clean"}


# The lists of options.py are written by hand so that help answers at once.


def registered(option: str, tmp_path: Path) -> set[str]:
    """The names that a run accepts for an option, as its error message lists them."""
    arguments = ["run", str(tmp_path), "--out", str(tmp_path / "out"), option, "no-such-name"]
    with pytest.raises(ConfigError) as error:
        app.app(arguments, standalone_mode=False)
    message = str(error.value)
    assert "expected one of " in message
    return set(message.split("expected one of ")[1].partition(", found")[0].split(", "))


@pytest.mark.parametrize(
    ("option", "listed"),
    [
        ("--paradigm", options.PARADIGM_NAMES),
        ("--features", options.FEATURE_NAMES),
        ("--preset", options.PRESET_NAMES),
        ("--robust", options.BACK_END_NAMES),
        ("--format", options.FORMAT_NAMES),
    ],
)
def test_help_lists_the_names_that_a_run_accepts(tmp_path: Path, option: str, listed: str):
    assert set(listed.split(", ")) == registered(option, tmp_path)


def test_help_names_the_defaults_of_a_run():
    config = RunConfig()
    assert (config.paradigm, config.robust) == (options.DEFAULT_PARADIGM, options.DEFAULT_BACK_END)
    assert (config.place_recognition.preset, config.seed) == (options.DEFAULT_PRESET, 0)


def test_the_shell_can_be_taught_to_complete():
    assert "--install-completion" in CliRunner().invoke(app.app, ["--help"], env=WIDE).output
    asks = {"_REVISIT_COMPLETE": "complete_bash", "COMP_WORDS": "revisit e", "COMP_CWORD": "1"}
    completed = CliRunner().invoke(app.app, [], prog_name="revisit", env=asks)
    assert {"explain", "export", "evaluate"} <= set(completed.output.split())
