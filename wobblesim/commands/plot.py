"""`wobblesim plot`: the figures of a study, each with the table behind it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.options import echo_json, json_option, print_table, table

if TYPE_CHECKING:
    from wobblesim.analysis.figures.registry import Choice
    from wobblesim.analysis.figures.style import Drawing
    from wobblesim.analysis.tables import Results

FORMATS = ("png", "svg", "pdf")
NOTHING_DRAWN = 2


@click.command("plot")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.argument("names", metavar="[NAME]...", nargs=-1)
@click.option(
    "--format",
    "formats",
    type=click.Choice(FORMATS),
    multiple=True,
    help="Of the pictures; may be given again.  [default: all]",
)
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path), help="Where to write.  [default: DIR/figures]")
@click.option("--baseline", metavar="ID", help="Condition to compare with.  [default: fixed, else the first]")
@click.option(
    "--condition",
    "conditions",
    metavar="ID",
    multiple=True,
    help="Show only this one; may be given again.  [default: all]",
)
@click.option(
    "--seed", metavar="N", type=int, help="Run to show where single runs are shown.  [default: a typical one]"
)
@click.option(
    "--list", "listing", is_flag=True, help="Say what there is and what the study lacks for it; draw nothing."
)
@json_option
def command(
    folder: Path,
    names: tuple[str, ...],
    formats: tuple[str, ...],
    out: Path | None,
    baseline: str | None,
    conditions: tuple[str, ...],
    seed: int | None,
    listing: bool,
    as_json: bool,
) -> None:
    """Draw figures of the results in DIR, also while a sweep is writing there: each as picture and as table (CSV).

    NAME is a figure of `--list`, or figure-2, figure-3, figure-4 or all. Of several, those are drawn that the study has
    the data for, and the reason is said for the others.

    \b
    Examples:
        wobblesim plot results/study
        wobblesim plot results/study figure-3b --format pdf --out paper
        wobblesim plot results/study --list
    """  # noqa: D301 - click reads the backspace
    from wobblesim.analysis.figures.registry import Choice, expand
    from wobblesim.analysis.tables import load, remembered

    chosen = expand(names or ("all",))
    results = remembered(load(folder))
    choice = Choice(baseline, conditions or None, seed)
    choice.shown(results)
    choice.reference(results)
    if listing:
        _list(chosen, results, choice, as_json)
        return
    home = out or folder / "figures"
    told = [_attempt(name, results, choice, home, formats or FORMATS, quiet=as_json) for name in chosen]
    if as_json:
        echo_json({"figures": told})
    refused = {str(figure["name"]) for figure in told if figure["reason"]}
    if refused.intersection(names) or len(refused) == len(chosen):
        click.get_current_context().exit(NOTHING_DRAWN)


def _attempt(
    name: str, results: Results, choice: Choice, home: Path, formats: tuple[str, ...], *, quiet: bool
) -> dict[str, Any]:
    """Draw and write a figure, and say its files on stdout; or say on stderr why it cannot be drawn."""
    from wobblesim.analysis.figures.style import files_of

    drawing = _drawing(name, results, choice)
    if isinstance(drawing, str):
        click.echo(f"{name}: {drawing}", err=True)
        return {"name": name, "files": [], "reason": drawing}
    written = write(home, files_of(drawing, name, formats))
    if not quiet:
        click.echo("\n".join(map(str, written)))
    return {"name": name, "files": [str(path) for path in written], "reason": None}


def _drawing(name: str, results: Results, choice: Choice) -> Drawing | str:
    """A figure, or why there is none."""
    from wobblesim.analysis.errors import FigureError
    from wobblesim.analysis.figures.registry import draw
    from wobblesim.study.errors import StoreError

    try:
        return draw(name, results, choice)
    except (FigureError, StoreError) as error:
        return str(error)


def write(home: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Write files into a folder, each whole or not at all; return their paths.

    Raises
    ------
    WriteError
        If the system refuses: no space, no permission, no folder.
    """
    from wobblesim.study.errors import not_written
    from wobblesim.study.files import make_folder, write_atomically

    try:
        make_folder(home)  # one that cannot be made is told by its own name, not by that of the first file
    except OSError as error:
        raise not_written(home, error) from error
    for name, content in files.items():
        write_atomically(home / name, home, content)
    return [home / name for name in files]


def _list(names: tuple[str, ...], results: Results, choice: Choice, as_json: bool) -> None:
    """Say of each figure what it shows, and what keeps it from being drawn."""
    from wobblesim.analysis.figures.registry import FIGURES, lacking

    found = {name: lacking(name, results, choice) for name in names}
    if as_json:
        rows = [{"name": name, "shows": FIGURES[name].says, "reason": reason} for name, reason in found.items()]
        echo_json({"figures": rows})
        return
    made = table(
        ["figure", "shows", "lacks"], [(name, FIGURES[name].says, reason or "") for name, reason in found.items()]
    )
    for column in made.columns:
        column.justify = "left"
    print_table(made)
