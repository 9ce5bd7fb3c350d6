"""`wobblesim accuracy`: error against run time."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from wobblesim.commands.options import echo_json, json_option, print_table, table

if TYPE_CHECKING:
    from wobblesim.numerics.accuracy_report import Report


@click.command("accuracy")
@click.option("--scene", "scenes", multiple=True, metavar="NAME", help="Only this scene; may be given again.")
@click.option(
    "--integrator", "integrators", multiple=True, metavar="NAME", help="Only this integrator; may be given again."
)
@click.option("--short", is_flag=True, help="Fewer settings, trials and seconds: does it work? Under a minute.")
@click.option("--threads", type=click.IntRange(min=1), help="Threads for what is not timed, instead of all.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Write accuracy.parquet, accuracy.png and accuracy.svg there.",
)
@click.option(
    "--page",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Write the page of the documentation, and its picture and table into _static beside it.",
)
@json_option
def command(
    scenes: tuple[str, ...],
    integrators: tuple[str, ...],
    short: bool,
    threads: int | None,
    out: Path | None,
    page: Path | None,
    as_json: bool,
) -> None:
    """Measure what each setting gets wrong, and what it costs.

    Every integrator, step, number of iterations, theta and precision on scenes from a damped oscillator to the
    gait: its error against a reference, and the run time of a simulated second of one lane on one thread. In the
    tables "*" marks the front (no cheaper setting is as exact) and "=" the shipped default. The last line names the
    cheapest settings below 1 % and 0.1 % of a body length. The full form takes some minutes.
    """
    from wobblesim.numerics.accuracy_report import make_report
    from wobblesim.numerics.scenes import SCENES
    from wobblesim.physics.registry import INTEGRATORS

    _check_names(scenes, SCENES, "--scene")
    _check_names(integrators, INTEGRATORS, "--integrator")
    for folder, option in ((out, "--out"), (page and page.parent / "_static", "--page")):
        _make_folder(folder, option)
    report = make_report(
        scenes, integrators, short=short, threads=threads, tell=lambda line: click.echo(line, err=True)
    )
    try:
        if out:
            _write_out(report, out)
        if page:
            _write_page(report, page)
    except OSError as error:
        raise click.ClickException(
            f"cannot write {error.filename}: {(error.strerror or str(error)).lower()}"
        ) from error
    if as_json:
        echo_json(report.as_data())
    else:
        _print(report)


def _check_names(given: Sequence[str], known: Collection[str], option: str) -> None:
    for name in given:
        if name not in known:
            raise click.BadParameter(f"{name!r} is not one of {', '.join(known)}", param_hint=option)


def _make_folder(folder: Path | None, option: str) -> None:
    """Before anything is measured: an hour later is too late to say that nothing can be written."""
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise click.BadParameter(f"{folder}: {error.strerror}", param_hint=option) from None


def _write_out(report: Report, folder: Path) -> None:
    from wobblesim.analysis.figures.work_precision import save, work_precision
    from wobblesim.numerics.accuracy import to_frame

    made = to_frame(report.rows)
    made.attrs = {"conditions": report.conditions}
    made.to_parquet(folder / "accuracy.parquet")
    for path in (folder / "accuracy.parquet", *save(work_precision(made), folder, "accuracy")):
        click.echo(f"wrote {path}", err=True)


def _write_page(report: Report, path: Path) -> None:
    from wobblesim.analysis.figures.work_precision import save, work_precision
    from wobblesim.numerics.accuracy import to_frame
    from wobblesim.numerics.accuracy_page import page

    made = to_frame(report.rows)
    static = path.parent / "_static"
    made.to_csv(static / "accuracy.csv", index=False, float_format="%.4g")
    save(work_precision(made), static, "accuracy")
    path.write_text(page(report), encoding="utf-8")
    click.echo(f"wrote {path}", err=True)


def _print(report: Report) -> None:
    from wobblesim.numerics import accuracy_tables as tables
    from wobblesim.numerics.accuracy_page import goal_line
    from wobblesim.numerics.accuracy_verdict import sentence

    for scene in report.scenes:  # rich reads [u] as a mark: units stand in parentheses
        print_table(table(*tables.scene_table(report.rows, scene), title=scene))
        for line in (tables.reference_line(report.rows, scene), *tables.notes(report.rows, scene)):
            click.echo(line)
        click.echo()
    for title, (columns, cells) in (
        ("rigid law against compliant law, displacements in body lengths", tables.agreement_table(report.agreements)),
        ("how far the end of a gait moves, body lengths", tables.sensitivity_table(report.sensitivities)),
    ):
        if cells:
            print_table(table(columns, cells, title=title))
            click.echo()
    click.echo(", ".join(f"{name} {value}" for name, value in report.conditions.items()))
    for line in filter(None, (goal_line(report.rows), sentence(report.rows))):
        click.echo(line)
