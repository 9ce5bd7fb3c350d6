"""Options that several commands share, and what they print alike."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from rich.table import Table

Command = TypeVar("Command", bound=Callable[..., Any])

PLAIN_WIDTH = 200
"""Columns of a table that goes to a file or a pipe, where nothing breaks a line."""


def config_options(command: Command) -> Command:
    """CONFIG, --set and --seeds."""
    for decorate in (
        click.option(
            "--seeds", metavar="SEEDS", help="Seeds instead of the file's, such as 0..9 (both included) or 0,3,7."
        ),
        click.option(
            "--set",
            "settings",
            metavar="KEY=VALUE",
            multiple=True,
            help="Change a setting by dotted key, such as physics.dt=0.005; may be given again.",
        ),
        click.argument("config", metavar="CONFIG", type=click.Path()),
    ):
        command = decorate(command)
    return command


def json_option(command: Command) -> Command:
    """--json."""
    return click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")(command)


def echo_json(data: Mapping[str, Any]) -> None:
    """Print data as JSON; what is not a number is null, for JSON has no NaN."""
    click.echo(json.dumps(_without_nan(data), indent=2))


def _without_nan(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {key: _without_nan(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_without_nan(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> Table:
    """A table whose first column is words and whose others are numbers."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    made = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", pad_edge=False, padding=(0, 1, 0, 0))
    for place, name in enumerate(columns):
        made.add_column(escape(name), justify="right" if place else "left", no_wrap=place == 0)
    for row in rows:
        made.add_row(*row)
    return made


def print_table(made: Table) -> None:
    """Print a table on stdout."""
    from rich.console import Console

    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=PLAIN_WIDTH)
    with console.capture() as captured:
        console.print(made)
    # A no-break space has done its work once the lines are broken.
    lines = captured.get().replace("\N{NO-BREAK SPACE}", " ").splitlines()
    click.echo("\n".join(line.rstrip() for line in lines))


def plural(count: int, noun: str) -> str:
    """Say a number of things."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"
