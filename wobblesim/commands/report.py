"""`wobblesim report`: a page on what came out."""

from __future__ import annotations

from pathlib import Path

import click

from wobblesim.commands.options import echo_json, json_option


@click.command("report")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--out", metavar="FILE", type=click.Path(path_type=Path), help="Page to write.  [default: DIR/report.html]"
)
@click.option("--baseline", metavar="ID", help="Condition to compare with.  [default: fixed, else the first]")
@click.option(
    "--no-players", is_flag=True, help="Simulate nothing: leave out robots to watch, and gaits on other bodies."
)
@json_option
def command(folder: Path, out: Path | None, baseline: str | None, no_players: bool, as_json: bool) -> None:
    """Write a page on the results in DIR: the main result, figures, statistics, robots to watch, provenance.

    The page is one file that opens in any browser without network, and says nothing of who made it or where. Works
    while a sweep is writing to DIR: on the runs that are finished. What is being made is told on stderr.

    \b
    Examples:
        wobblesim report results/quickstart
        wobblesim report results/study --baseline size --out study.html
    """  # noqa: D301 - click reads the backspace
    if out and out.suffix.lower() != ".html":
        raise click.BadParameter(f"{out} does not end in .html, and a page is what is written", param_hint="--out")
    from wobblesim.viewing.report import NAME, report

    if not no_players:
        _tell_of_kernels()
    made = report(folder, baseline=baseline, simulate=not no_players, tell=lambda what: click.echo(what, err=True))
    path = made.save(out or folder / NAME)
    size = path.stat().st_size
    if as_json:
        echo_json(
            {
                "file": str(path),
                "bytes": size,
                "headline": made.headline,
                "figures": list(made.figures),
                "left_out": dict(made.left_out),
            }
        )
    else:
        click.echo(f"{path} ({size / 1e6:.2f} MB)")


def _tell_of_kernels() -> None:
    from wobblesim.physics.kernels import is_warm

    if not is_warm():
        click.echo("compiling kernels, once on this machine: this takes some seconds more", err=True)
