"""Every command that a page or a help shows can be typed, and every command's help shows one."""

import inspect
import re
from collections.abc import Callable
from typing import Any, get_args

import pytest
from typer.testing import CliRunner

from slam import cli

from .command_lines import APP, EXAMPLE, Shown, commands, find, lines, mentions

COMMANDS = [pytest.param(names, command, id=" ".join(names)) for names, command in commands()]
WIDE = {"COLUMNS": "200"}
# What numbers are measured in, or count; a seed is neither.
UNITS = re.compile(
    "metre|second|degree|pixel|image|frame|lap|cars|words|how many|descriptor|column|process|seed|random", re.IGNORECASE
)


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
    """The parameters of a command that are numbers, each with what its help says."""
    parameters = inspect.signature(function).parameters.values()
    hints = {parameter.name: get_args(parameter.annotation) for parameter in parameters}
    return {name: told.help for name, (kind, told, *_) in hints.items() if {int, float} & {kind, *get_args(kind)}}


@pytest.mark.parametrize(("names", "command"), COMMANDS)
def test_a_help_teaches(names: tuple[str, ...], command: Any):
    """It has a command to copy, says what everything is, and the unit of every number."""
    examples = EXAMPLE.findall(command.help)
    assert examples
    assert all(example.startswith(" ".join(names)) for example in examples)
    assert [one.name for one in command.params if not one.help] == []
    assert {name: told for name, told in numbers(command.callback).items() if not UNITS.search(told)} == {}


@pytest.mark.parametrize(("names", "command"), COMMANDS)
def test_a_help_in_a_pipe_is_plain_text_with_the_defaults(names: tuple[str, ...], command: Any):
    said = CliRunner().invoke(cli.app, [*names, "--help"], env=WIDE).output
    assert "\x1b" not in said
    for one in command.params:
        if isinstance(one.default, str | int | float) and not isinstance(one.default, bool):
            assert f"[default: {one.default}" in said, one.name


def test_the_shell_can_be_taught_to_complete():
    assert "--install-completion" in CliRunner().invoke(cli.app, ["--help"], env=WIDE).output
    asks = {"_REVISIT_COMPLETE": "complete_bash", "COMP_WORDS": "revisit e", "COMP_CWORD": "1"}
    completed = CliRunner().invoke(cli.app, [], prog_name="revisit", env=asks)
    assert {"explain", "export", "evaluate"} <= set(completed.output.split())
