"""What `wobblesim sweep --dry-run` prints: what would be computed, and what it takes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.explain import amount, how_long
from wobblesim.commands.options import echo_json, plural, print_table, table

if TYPE_CHECKING:
    from wobblesim.config import SweepConfig
    from wobblesim.numerics.probe import Forecast
    from wobblesim.study.lock import Shard
    from wobblesim.study.preview import Preview

COUNTS = ("wanted", "present", "missing", "lane_steps")

MOST, FIRST = 24, 12
"""Conditions that are all shown, and of more than that how many."""

CAVEAT = """\
Timed just now, as busy as the machine is. On a busy one, 18 sweeps took 0.6 to 1.8 times as long as foreseen.
Trials that need a smaller step are tried again, which comes on top; so do the start and the picture."""


def show(config: SweepConfig, folder: Path, as_json: bool, threads: int, workers: int, shard: Shard | None) -> None:
    """Print what a sweep, or a shard of it, would compute, and what that takes; nothing is written.

    Parameters
    ----------
    config : SweepConfig
    folder : Path
        Of the results.
    as_json : bool
    threads, workers : int
        Workers, and threads of each.
    shard : Shard or None
    """
    from wobblesim.config import columns
    from wobblesim.numerics.probe import forecast
    from wobblesim.physics.kernels import is_warm
    from wobblesim.study.preview import preview

    seen = preview(config, folder, shard, workers, threads)
    if seen.plan and not is_warm():
        click.echo("compiling kernels, to time them: some seconds", err=True)
    found = forecast(seen, lambda name: columns(seen.study.conditions[name]), workers, threads)
    rows = [row | {"core_hours": found.core_seconds.get(row["condition"], 0.0) / 3600} for row in seen.rows()]
    total: dict[str, Any] = {name: sum(row[name] for row in rows) for name in (*COUNTS, "core_hours")}
    if as_json:
        how = {"workers": workers, "threads": threads, "shard": shard and f"{shard.number}/{shard.count}"}
        echo_json({"results": str(folder), **how, **total, **_needs(found), "conditions": rows})
        return
    print_table(_table(rows, total))
    if seen.plan:
        click.echo(_in_words(seen, found, workers, threads, total["core_hours"]))
    part = f", shard {shard.number}/{shard.count}" if shard else ""
    click.echo(f"results {folder}{part}: {total['present']:,} of {plural(total['wanted'], 'run')} there")
    if seen.plan:
        click.echo(f"\n{CAVEAT}")


def _needs(found: Forecast) -> dict[str, Any]:
    return {
        "seconds": found.seconds,
        "disk": {"results": found.results, "checkpoints": found.checkpoints},
        "memory": found.memory,
        "kinds": found.kinds,
        "timed": found.timed,
    }


def _table(rows: list[dict[str, Any]], total: dict[str, Any]) -> Any:
    """All conditions if they are few; else the first, and the others together."""
    shown = rows
    if len(rows) > MOST:
        others: dict[str, Any] = {name: sum(row[name] for row in rows[FIRST:]) for name in total}
        shown = [*rows[:FIRST], others | {"condition": f"and {plural(len(rows) - FIRST, 'other')}"}]
    whole: dict[str, Any] = total | {"condition": "all"}
    cells = [
        [row["condition"], *(f"{row[name]:,}" for name in COUNTS), _hours(row["core_hours"])] for row in [*shown, whole]
    ]
    return table(["condition", "runs", "present", "missing", "lane-steps to do, at most", "core-hours"], cells)


def _hours(hours: float) -> str:
    return f"{hours:,.0f}" if hours >= 100 else f"{hours:.2g}"


def _in_words(seen: Preview, found: Forecast, workers: int, threads: int, core_hours: float) -> str:
    where = f"{plural(workers, 'worker')} of " * (workers > 1) + plural(threads, "thread")
    groups = f"{plural(len(seen.plan), 'group')} of at most {plural(seen.plan.size, 'seed')}"
    kernels = f"timed for {found.timed} of {found.kinds} kinds of conditions" * (found.timed < found.kinds)
    return (
        f"time    {how_long(found.seconds)} on {where}: {_hours(core_hours)} core-hours, {groups}\n"
        + f"        {kernels}\n" * bool(kernels)
        + f"disk    {amount(found.results)} of results besides pictures, at most {amount(found.checkpoints)} of "
        f"checkpoints meanwhile\n"
        f"memory  {amount(found.memory)}"
    )
