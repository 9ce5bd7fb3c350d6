"""`wobblesim explain`: what a sweep leaves out, and the time, memory and disk that it needs."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.display import duration
from wobblesim.commands.options import config_options, echo_json, json_option, plural, print_table, table

if TYPE_CHECKING:
    from wobblesim.config import SweepConfig
    from wobblesim.numerics.explain import Explanation, SceneCosts, Work
    from wobblesim.numerics.explain_terms import Term

STATES = {"in": "compiled in", "left out": "left out", "no code": "no code of its own"}

COSTS = """\
A cost is the time of a lane-step with the term, but too weak to move anything, minus that of the same scene
without it; for the floor it is the scene as it is minus free flight, for recording every 10th step is kept.
Full blocks, one thread. Two timings of one kernel differ by {noise:.3f} µs here; two kernels may differ by a percent
or so, either way, for how they happen to be compiled. –: has no code of its own here, or cannot move without.
"""

REUSE = "Of the missing runs. A kept behaviour is not tried again while its robot rests: the outcome is known."


@click.command("explain")
@config_options
@click.option(
    "--out", metavar="DIR", type=click.Path(path_type=Path), help="Folder of the results.  [default: results/NAME]"
)
@click.option("--threads", type=click.IntRange(min=1), help="Threads at most.  [default: one for each processor]")
@click.option(
    "--seconds", type=click.FloatRange(0.01), default=5.0, show_default=True, help="How long to time the terms."
)
@json_option
def command(
    config: str, settings: tuple[str, ...], seeds: str | None, out: Path | None, threads: int | None,
    seconds: float, as_json: bool,
) -> None:  # fmt: skip
    """Say what a sweep leaves out, and the time, memory and disk it needs.

    A term that a scene does not need is not compiled in. What each term costs, and the time of the whole, is measured
    on this machine, as busy as it is now; a lane-step is one step of one robot. Nothing of the sweep is computed, and
    nothing is written to its folder.
    """
    from wobblesim.config import columns, load_config
    from wobblesim.numerics.explain import explain
    from wobblesim.physics.kernels import available_threads
    from wobblesim.study.plan import study

    loaded = load_config(config, settings, seeds)
    laid_out, folder = study(loaded), out or Path("results", loaded.name)
    present = _present(loaded, folder)
    if not as_json:
        click.echo("timing each term: some seconds, a minute more where kernels have to be compiled", err=True)
    stored = {name: columns(parameters) for name, parameters in laid_out.conditions.items()}
    found = explain(laid_out, present, stored, threads or available_threads(), seconds)
    if as_json:
        echo_json({"results": str(folder), **_as_data(found)})
        return
    for scene in found.scenes:
        _print_scene(scene)
    _print_work(found)
    _print_needs(found, folder)


def _present(config: SweepConfig, folder: Path) -> dict[str, int]:
    """Runs of each condition that are there; none, with a note, if a sweep would refuse the folder."""
    from wobblesim.study.errors import StoreError
    from wobblesim.study.preview import preview

    try:
        return dict(preview(config, folder).present)
    except StoreError as error:
        click.echo(f"note: a sweep would be refused: {error}", err=True)
        return {}


def _as_data(found: Explanation) -> dict[str, Any]:
    work = [asdict(work) | {"simulated": work.simulated} for work in found.work]
    memory = asdict(found.memory) | {"total": found.memory.total}
    return asdict(found) | {"work": work, "memory": memory, "seconds": found.seconds}


# --- tables ----------------------------------------------------------------------------------------------------


def _print_scene(scene: SceneCosts) -> None:
    names, costs = scene.conditions, scene.costs
    of = ", ".join(names) if len(names) < 4 else f"{names[0]} and {plural(len(names) - 1, 'condition')} like it"
    how = f"{scene.integrator}, {scene.precision}, {plural(costs.lanes, 'lane')}"
    made = table(
        ["term", "in this sweep", "scene", "cost [µs]", "cost [%]"],
        [_cells(term) for term in costs.terms],
        title=f"{of}: {costs.lane_step:.3f} µs a lane-step ({how})",
    )
    for column in made.columns[1:3]:
        column.justify = "left"
    print_table(made)
    click.echo(COSTS.format(noise=costs.noise))


def _cells(term: Term) -> list[str]:
    cost = "–" if term.cost is None else f"{term.cost:.3f}"
    return [term.name, STATES[term.state], term.why, cost, "–" if term.percent is None else f"{term.percent:.1f}"]


def _print_work(found: Explanation) -> None:
    columns = ["condition", "runs", "present", "missing", "trials", "simulated", "reused", "reused [%]", "lane-steps"]
    print_table(table([*columns, "time"], [_row(work) for work in found.work], title="Work"))
    click.echo(f"{REUSE}\n")


def _row(work: Work) -> list[str]:
    counts = (work.wanted, work.present, work.missing, work.trials, work.simulated, work.reused)
    share = f"{100 * work.reused / work.trials:.1f}" if work.trials else "–"
    time = how_long(work.physics + work.learning)
    return [work.condition, *(f"{count:,}" for count in counts), share, f"{work.lane_steps:,}", time]


def _print_needs(found: Explanation, folder: Path) -> None:
    memory, disk = found.memory, found.disk
    learning = sum(work.learning for work in found.work)
    wanted, present = (sum(getattr(work, name) for work in found.work) for name in ("wanted", "present"))
    click.echo(
        f"time    {how_long(found.seconds)} on {plural(found.threads, 'thread')}, "
        f"{how_long(learning)} of it for learning, logging and storing; start and picture come on top\n"
        f"memory  {amount(memory.total)}: {amount(memory.program)} program and libraries, {amount(memory.trials)} "
        f"trials, {amount(memory.tables)} tables\n"
        f"disk    {amount(disk.results)} of results besides pictures, at most {amount(disk.checkpoints)} of "
        f"checkpoints meanwhile\n"
        f"results {folder}: {present:,} of {plural(wanted, 'run')} there"
    )


def how_long(seconds: float) -> str:
    """Say a time in words, a short one too."""
    return f"{seconds:.2g} s" if seconds < 10 else duration(seconds)


def amount(count: int) -> str:
    """Say a number of bytes with two digits or more."""
    for size, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= size:
            return f"{count / size:.2g} {unit}" if count < 10 * size else f"{count / size:.0f} {unit}"
    return f"{count} B"
