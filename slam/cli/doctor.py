"""The command that checks the installation."""

from collections.abc import Sequence
from dataclasses import asdict
from json import dumps
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from slam.cli.options import EXIT_FAILED, Json

if TYPE_CHECKING:
    from slam.apps.doctor import Check


def doctor(
    licences: Annotated[
        bool, typer.Option("--licences", help="List the installed dependencies with their licences instead.")
    ] = False,
    json: Json = False,
) -> None:
    """Check Python, the installed packages and the system libraries, and print how to install what is missing.

    Example: revisit doctor
    """
    if licences:
        _print_licences(json)
        return
    from slam.apps.doctor import check_machine

    checks = check_machine()
    (_print_json if json else _print_checks)(checks)
    raise typer.Exit(EXIT_FAILED if any(check.problem for check in checks) else 0)


def _print_checks(checks: Sequence["Check"]) -> None:
    from rich.markup import escape

    for check in checks:
        mark = "[red]missing[/red]" if check.problem else "[green]ok[/green]"
        words = escape(f"{check.name} {check.found}{check.problem}")
        Console().print(f"{mark:>8}  {words}", highlight=False, soft_wrap=True)
        if check.remedy:
            Console().print(f"          type: {check.remedy}", markup=False, highlight=False, soft_wrap=True)


def _print_json(rows: Sequence[Any]) -> None:
    """Print dataclasses as a list of objects."""
    Console().print(dumps([asdict(row) for row in rows], indent=2), markup=False, highlight=False, soft_wrap=True)


def _print_licences(as_json: bool) -> None:
    from rich.table import Table

    from slam.apps.doctor import licences

    if as_json:
        _print_json(licences())
        return
    table = Table("package", "version", "licence", "needed by", title="What Revisit is installed with", box=None)
    for one in licences():
        table.add_row(one.package, one.version, one.licence, "Revisit" if one.direct else "another package")
    Console().print(table)
