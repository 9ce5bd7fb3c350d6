"""`wobblesim bench`: what a simulated second costs on this machine."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.options import echo_json, json_option, print_table, table

if TYPE_CHECKING:
    from wobblesim.numerics.throughput import Throughput


@click.command("bench")
@click.option(
    "--integrator", "integrators", multiple=True, metavar="NAME", help="Only this integrator; may be given again."
)
@click.option(
    "--seconds", type=click.FloatRange(0.01), default=0.5, show_default=True, help="Length of each timed run."
)
@click.option(
    "--repeats", type=click.IntRange(1), default=5, show_default=True, help="Timed runs of which the best counts."
)
@click.option("--threads", type=click.IntRange(min=1), help="Threads instead of all.")
@json_option
def command(integrators: tuple[str, ...], seconds: float, repeats: int, threads: int | None, as_json: bool) -> None:
    """Time every integrator in every precision on this machine.

    A lane-step is one step of one robot. The starfish lies on the floor and moves at random, contacts active; kernels
    are compiled first, and each figure is the best of several runs. "Scalar" is the same source compiled for one
    lane. The last column projects a full run of the paper: 4000 epochs of 20 behaviours of 60 s on all threads.
    """
    from wobblesim.numerics.throughput import conditions, measure
    from wobblesim.physics.registry import INTEGRATORS

    for name in integrators:
        if name not in INTEGRATORS:
            raise click.BadParameter(f"{name!r} is not one of {', '.join(INTEGRATORS)}", param_hint="--integrator")
    if not as_json:
        click.echo("compiling kernels, then timing: about a minute", err=True)
    rows = list(measure(integrators or None, seconds=seconds, repeats=repeats, threads=threads))
    if as_json:
        echo_json({"conditions": conditions(), "throughput": [_as_data(row) for row in rows]})
        return
    made = table(
        ["integrator", "precision", "dt [s]", "lanes", "1 thread [M/s]", f"{rows[0].threads} threads [M/s]", "speed-up",
         "scalar [M/s]", "lanes / scalar", "full run"],
        [_as_text(row) for row in rows],
        title="Lane-steps per second",
    )  # fmt: skip
    print_table(made)
    click.echo(", ".join(f"{name} {value}" for name, value in conditions().items()))


def _as_data(row: Throughput) -> dict[str, Any]:
    return {**asdict(row), "speed_up": row.speed_up, "vector_gain": row.vector_gain, "full_run_s": row.full_run}


def _as_text(row: Throughput) -> list[str]:
    return [
        row.integrator,
        row.precision,
        f"{row.dt:g}",
        f"{row.width}",
        f"{row.one_thread / 1e6:.3f}",
        f"{row.all_threads / 1e6:.3f}",
        f"{row.speed_up:.2f}",
        f"{row.scalar / 1e6:.3f}",
        f"{row.vector_gain:.1f}",
        _duration(row.full_run),
    ]


def _duration(seconds: float) -> str:
    if seconds < 600:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 36_000 else f"{seconds / 3600:.0f} h"
