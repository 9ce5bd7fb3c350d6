"""`wobblesim rerun`: does a stored run come out the same, bit for bit?"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.options import echo_json, json_option, plural, print_table, table

if TYPE_CHECKING:
    from wobblesim.study.rerun import Difference, StoredRun, Verdict

DIFFERENT, INTERRUPTED = 3, 130

MOST_LETTERS = 150
"""Of a value in a table."""


@click.command("rerun")
@click.argument("file", metavar="FILE", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--seed", type=click.IntRange(min=0), help="Which run of a compacted file, which holds several.")
@click.option("--epochs", type=click.IntRange(min=1), help="Repeat only so many epochs, from the first.")
@click.option("--threads", type=click.IntRange(min=1), help="Threads at most.  [default: one for each processor]")
@json_option
@click.pass_context
def command(
    ctx: click.Context, file: Path, seed: int | None, epochs: int | None, threads: int | None, as_json: bool
) -> None:
    """Repeat the run of a Parquet file from its metadata alone, and say whether the bits agree.

    FILE is any file of a results folder; it may have been copied elsewhere. If the bits do not agree, the columns that
    differ are listed, with the first row that does, and what has changed since: version, kernel, commit, processor.
    Exit codes: 0 the bits agree, 3 they do not, 2 the file is cut, altered or not one of ours.

    \b
    Examples:
        wobblesim rerun results/quickstart/epochs/condition=wobbling/seed-0.parquet
        wobblesim rerun seed-0.parquet --epochs 10 --json
    """  # noqa: D301 - click reads the backspace
    from wobblesim.study.rerun import read_run

    verdict = _repeat(read_run(file, seed), epochs, threads)
    if as_json:
        echo_json(_as_data(verdict))
    else:
        _print(verdict)
    if not verdict.agree:
        ctx.exit(DIFFERENT)


def _repeat(run: StoredRun, epochs: int | None, threads: int | None) -> Verdict:
    from wobblesim.commands.display import display
    from wobblesim.commands.stopping import stop_on_signals
    from wobblesim.physics.kernels import is_warm
    from wobblesim.study.rerun import rerun

    with display("plain") as shown, stop_on_signals(_leave, _leave):
        if not is_warm():
            shown.say("compiling kernels, once on this machine: the first epoch takes some seconds more")
        return rerun(run, epochs, threads=threads, progress=shown)


def _leave() -> None:
    """End at once: nothing is being written that would have to be finished."""
    os._exit(INTERRUPTED)


# --- what came out -------------------------------------------------------------------------------------------------


def _print(verdict: Verdict) -> None:
    run = verdict.run
    click.echo(
        f"{run.condition}, seed {run.seed}: {plural(verdict.epochs, 'epoch')} repeated, "
        f"{plural(verdict.rows, 'row')} of {verdict.columns} columns of {run.table} compared"
    )
    if verdict.agree:
        click.echo("the bits agree")
    else:
        where = _place(verdict, min(it.first for it in verdict.differences))
        what = plural(len(verdict.differences), "column")
        click.echo(f"the bits do not agree: in {what}{where and ', from '}{where}{where and ' on'}")
        titles = ["column", "rows that differ", "first in", "stored", "here", "largest difference"]
        print_table(table(titles, [_cells(verdict, it) for it in verdict.differences]))
    _print_provenance(verdict)


def _print_provenance(verdict: Verdict) -> None:
    if verdict.changed:
        click.echo("What computed the run, and what has computed it now, where that differs:")
        rows = [[name, *map(_cell, _apart(name, *pair))] for name, pair in verdict.changed.items()]
        print_table(table(["", "stored", "here"], rows))
    elif not verdict.agree:
        click.echo("The same versions computed it on the same processor: the file is altered, or wobblesim at fault.")


def _apart(name: str, stored: str, here: str) -> tuple[str, str]:
    """What to show of two values: of many features those that the other does not have."""
    if name != "features":
        return stored, here
    there, now = stored.split(), here.split()
    return " ".join(it for it in there if it not in now), " ".join(it for it in now if it not in there)


def _cells(verdict: Verdict, it: Difference) -> list[str]:
    return [
        _cell(it.column),
        f"{it.rows:,} of {verdict.rows:,}",
        _place(verdict, it.first) or "the run",
        _cell(it.stored),
        _cell(it.here),
        "–" if it.largest is None else f"{it.largest:.3g}",
    ]


def _cell(value: object) -> str:
    """A value of a file that anybody may have written, for a terminal."""
    from rich.markup import escape

    from wobblesim.config.errors import one_line

    text = one_line(str(value))
    return escape(text if len(text) <= MOST_LETTERS else f"{text[:MOST_LETTERS]}...")


def _place(verdict: Verdict, row: int) -> str:
    """A row in words; nothing for the row of a run."""
    return ", ".join(f"{name} {number}" for name, number in verdict.place(row).items())


def _as_data(verdict: Verdict) -> dict[str, Any]:
    run = verdict.run
    return {
        "file": str(run.path),
        "table": run.table,
        "condition": run.condition,
        "seed": run.seed,
        "epochs": verdict.epochs,
        "rows": verdict.rows,
        "columns": verdict.columns,
        "agree": verdict.agree,
        "differences": [_difference_as_data(verdict, it) for it in verdict.differences],
        "provenance": {name: {"stored": there, "here": here} for name, (there, here) in verdict.provenance.items()},
    }


def _difference_as_data(verdict: Verdict, it: Difference) -> dict[str, Any]:
    values = {"stored": it.stored, "here": it.here, "largest": it.largest}
    return {"column": it.column, "rows": it.rows, "first": verdict.place(it.first), **values}
