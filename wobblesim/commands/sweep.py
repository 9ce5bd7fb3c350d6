"""`wobblesim sweep`: compute what is missing of a study, then say what came out."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.options import config_options, echo_json, json_option, plural, print_table, table

if TYPE_CHECKING:
    import pandas as pd

    from wobblesim.commands.display import Display
    from wobblesim.config import SweepConfig
    from wobblesim.study.execute import Outcome

SOME_FAILED, STOPPED = 3, 4

FIGURE = Path("figures", "learning-curve.png")


@click.command("sweep")
@config_options
@click.option(
    "--out", metavar="DIR", type=click.Path(path_type=Path), help="Folder of the results.  [default: results/NAME]"
)
@click.option("--threads", type=click.IntRange(min=1), help="Threads at most.  [default: one for each processor]")
@click.option(
    "--progress",
    type=click.Choice(["auto", "rich", "plain", "none"]),
    default="auto",
    show_default=True,
    help="Bars, plain lines or nothing on stderr; auto: bars on a terminal.",
)
@click.option("-n", "--dry-run", is_flag=True, help="Say what would be computed, and compute nothing.")
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    config: str,
    settings: tuple[str, ...],
    seeds: str | None,
    out: Path | None,
    threads: int | None,
    progress: str,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Compute the missing runs of a study, then print its summary and draw its learning curves.

    Ctrl-C ends it after the epoch in progress; the same command goes on from there, with the same results, bit for
    bit. So does the same command with more seeds or more conditions.

    \b
    Examples:
        wobblesim sweep configs/quickstart.yaml
        wobblesim sweep study.yaml --set learning.epochs=100 --seeds 0..3 --out results/try
        wobblesim sweep study.yaml --dry-run
    """  # noqa: D301 - click reads the backspace
    from wobblesim.config import load_config, remarks

    loaded = load_config(config, settings, seeds)
    for remark in remarks(loaded):
        click.echo(f"note: {remark}", err=True)
    _warn_of_unsafe_wobbles(loaded)
    folder = out or Path("results", loaded.name)
    if dry_run:
        _preview(loaded, folder, as_json)
        return
    outcome = _run(loaded, folder, threads, progress)
    _report(outcome, as_json)
    if outcome.stopped:
        click.echo(f"stopped; to go on: {_same_command(ctx)}", err=True)
        ctx.exit(STOPPED)
    if outcome.failed:
        click.echo(
            f"{plural(outcome.failed, 'run')} failed: see `wobblesim status {shlex.quote(str(folder))}`", err=True
        )
        ctx.exit(SOME_FAILED)


def _warn_of_unsafe_wobbles(config: SweepConfig) -> None:
    """Say which conditions leave the region where the integrator is known to be stable, and the step that would do."""
    from wobblesim.numerics.safety import remarks
    from wobblesim.study.plan import study

    warned: dict[str, list[str]] = {}
    for condition, setup in study(config).setups.items():
        for remark in remarks(setup):
            warned.setdefault(remark, []).append(condition)
    for remark, conditions in warned.items():
        others = f" and {plural(len(conditions) - 1, 'other')}" if len(conditions) > 1 else ""
        click.echo(f"warning: {conditions[0]}{others}: {remark}", err=True)


def _run(config: SweepConfig, folder: Path, threads: int | None, progress: str) -> Outcome:
    from wobblesim.commands.display import display
    from wobblesim.commands.stopping import stop_on_signals
    from wobblesim.physics.kernels import is_warm
    from wobblesim.study.execute import sweep

    with display(progress) as shown, stop_on_signals(lambda: _promise_to_stop(shown), shown.close) as stop:
        if not is_warm():
            shown.say("compiling kernels, once on this machine: the first epoch takes some seconds more")
        return sweep(config, folder, threads=threads, progress=shown, stop=stop)


def _promise_to_stop(shown: Display) -> None:
    shown.say("stopping after this epoch, with a checkpoint; Ctrl-C again leaves at once")


def _same_command(ctx: click.Context) -> str:
    """The command line that was given, as it can be typed again."""
    root = ctx.find_root().info_name or ""
    words = [f"python {root}" if root.endswith(".py") else root, ctx.info_name or ""]
    for option in ctx.command.params:
        value = ctx.params.get(option.name or "")
        given = option.opts[-1] if isinstance(option, click.Option) else None
        if value is None or value is False or value == option.get_default(ctx):
            continue
        for item in value if isinstance(value, tuple) else (value,):
            words += [word for word in (given, None if value is True else shlex.quote(str(item))) if word]
    return " ".join(words)


# --- what came out -------------------------------------------------------------------------------------------------


def _report(outcome: Outcome, as_json: bool) -> None:
    """Print the summary and draw the figure of what is there, be it a part."""
    from wobblesim.analysis.statistics import baseline, summary
    from wobblesim.analysis.tables import load
    from wobblesim.study.store import read_manifest

    told: dict[str, Any] = {name: getattr(outcome, name) for name in TOLD} | {"results": str(outcome.folder)}
    if not read_manifest(outcome.folder).runs:
        if as_json:
            echo_json(told | {"conditions": []})
        return
    results = load(outcome.folder)
    figure = draw(outcome.folder)
    found = summary(results)
    if as_json:
        echo_json(told | {"figure": str(figure), "conditions": found.to_dict("records")})
        return
    print_summary(found, baseline(results.conditions))
    click.echo(f"results: {outcome.folder}\npicture: {figure}")


TOLD = ("wanted", "present", "done", "failed", "stopped", "seconds")


def draw(folder: Path, path: Path | None = None) -> Path:
    """Draw the learning curves of the results in a folder; return the path of the picture.

    Raises
    ------
    WriteError
        If the picture cannot be written.
    """
    from wobblesim.analysis.figures.learning import learning_curves, save
    from wobblesim.analysis.tables import load
    from wobblesim.study.store import WriteError

    figure, path = learning_curves(load(folder)), path or folder / FIGURE
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save(figure, path)
    except OSError as error:
        raise WriteError(
            f"cannot write {path}: {(error.strerror or str(error)).lower()}; the results are safe"
        ) from error
    return path


def print_summary(found: pd.DataFrame, reference: str) -> None:
    """Print one row a condition."""
    columns = [
        "condition", "runs", "body lengths", "median", "path before", "path after", "diverged", "refined",
        "limited", f"minus {reference}",
    ]  # fmt: skip
    made = table(columns, [_cells(row) for row in found.to_dict("records")])
    made.caption = (
        "± 99 % confidence of the mean; path: search distance before and after the end of the wobble;\n"
        f"diverged, refined, limited: trials; minus {reference}: mean difference of runs with the same seed"
    )
    made.caption_justify = "left"
    print_table(made)


def _cells(row: dict[str, Any]) -> list[str]:
    excluded = f" ({row['excluded']} excluded)" if row["excluded"] else ""
    return [
        row["condition"],
        f"{row['runs']}{excluded}",
        _interval(row["mean"], row["half_width"]),
        _number(row["median"]),
        _interval(row["path_before"], row["path_before_half_width"], digits=2),
        _interval(row["path_after"], row["path_after_half_width"], digits=2),
        *(f"{row[status]:,}" for status in ("diverged", "refined", "limited")),
        _interval(row["difference"], row["difference_half_width"], sign="+"),
    ]


def _interval(mean: float, half_width: float, sign: str = "", digits: int = 3) -> str:
    """Mean ± half width; without the latter if there is none, a dash if there is neither."""
    if mean != mean:
        return "–"
    # The no-break space keeps ± with its number in a narrow terminal.
    width = f" ±\N{NO-BREAK SPACE}{half_width:.{digits}f}" if half_width == half_width else ""
    return f"{mean:{sign}.{digits}f}{width}"


def _number(value: float) -> str:
    return f"{value:.3f}" if value == value else "–"


# --- what would be computed ----------------------------------------------------------------------------------------


def _preview(config: SweepConfig, folder: Path, as_json: bool) -> None:
    from wobblesim.study.preview import preview

    seen = preview(config, folder)
    total = {name: sum(row[name] for row in seen) for name in ("wanted", "present", "missing", "lane_steps")}
    if as_json:
        echo_json({"results": str(folder), **total, "conditions": seen})
        return
    rows = [[row["condition"], *(f"{row[name]:,}" for name in total)] for row in (*seen, {"condition": "all"} | total)]
    print_table(table(["condition", "runs", "present", "missing", "lane-steps to do, at most"], rows))
    click.echo(f"results: {folder}")
