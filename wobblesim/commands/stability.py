"""`wobblesim stability`: where each integrator breaks, by theory and as measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from wobblesim.commands.options import echo_json, json_option, print_table, table

if TYPE_CHECKING:
    from wobblesim.numerics.stability import Effort, Tables


@click.command("stability")
@click.option("--short", is_flag=True, help="A smoke test of every part, in less than a minute.")
@click.option(
    "--out", metavar="DIR", type=click.Path(path_type=Path, file_okay=False), help="Write tables and pictures here."
)
@click.option(
    "--page", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False),
    help="Write the page of the documentation, with pictures in _static beside it.",
)  # fmt: skip
@click.option(
    "--write-safe", is_flag=True, help="Replace the table by which `sweep` warns; for those who change kernels."
)
@json_option
def command(short: bool, out: Path | None, page: Path | None, write_safe: bool, as_json: bool) -> None:
    """Measure where each integrator breaks: stiff, light, heavy, fast.

    One spring beside its theory, heavy chains, the box of mass, stiffness and size at several steps, safe wobbles of
    each dimension, impacts, starts inside the floor. Takes some minutes. What the words mean: docs/stability.md.

    \b
    Examples:
        wobblesim stability --short
        wobblesim stability --out results/stability
        wobblesim stability --page docs/stability.md --write-safe
    """  # noqa: D301 - click reads the backspace
    if short and write_safe:
        raise click.BadParameter("the short form measures too little for it", param_hint="--write-safe")
    from wobblesim.numerics import stability

    effort = stability.short() if short else stability.full()
    tables = stability.measure(effort, (lambda _: None) if as_json else (lambda what: click.echo(what, err=True)))
    try:
        written = _write(tables, effort, out, page, write_safe)
    except OSError as error:
        raise click.ClickException(
            f"cannot write {error.filename}: {(error.strerror or str(error)).lower()}"
        ) from error
    if as_json:
        _print_json(tables)
        return
    _print(tables)
    for path in written:
        click.echo(f"written: {path}", err=True)


def _write(tables: Tables, effort: Effort, out: Path | None, page: Path | None, write_safe: bool) -> list[Path]:
    """Write what was asked for; returns the places."""
    from wobblesim.numerics import safety, stability, stability_page, stability_safe

    written, drawn = [], None
    if out:
        stability.write_tables(tables, out)
        drawn = stability_page.draw(tables, out)
        written.append(out)
    if page:
        stability_page.write(tables, effort, page, drawn)
        written.append(page)
    if write_safe:
        path = Path(safety.__file__).with_name(safety.FILE)
        safety.write(stability_safe.table_of(tables["safe"], effort.safe_trying, effort.factors), path)
        written.append(path)
    return written


def _print_json(tables: Tables) -> None:
    from wobblesim.numerics.throughput import conditions

    # The curves are theory, and many.
    shown = {name: frame.to_dict("records") for name, frame in tables.items() if name != "curves"}
    echo_json({"conditions": conditions(), **shown})


def _print(tables: Tables) -> None:
    from wobblesim.numerics.stability_text import texts

    for text in texts(tables):
        print_table(table(text.columns, text.rows, title=text.title))
