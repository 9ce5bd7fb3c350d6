"""`wobblesim sweep`: compute what is missing of a study, then say what came out."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.engine import EngineChoice, engine_options
from wobblesim.commands.options import config_options, echo_json, json_option, plural, print_table, table

if TYPE_CHECKING:
    import pandas as pd

    from wobblesim.commands.display import Display
    from wobblesim.config import SweepConfig
    from wobblesim.study.execute import Outcome
    from wobblesim.study.lock import Shard

SOME_FAILED, STOPPED = 3, 4

FIGURE = Path("figures", "learning-curve.png")


@click.command("sweep")
@config_options
@click.option(
    "--out", metavar="DIR", type=click.Path(path_type=Path), help="Folder of the results.  [default: results/NAME]"
)
@click.option(
    "--fork",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Store in DIR instead, beginning with the runs of --out whose settings are unchanged.",
)
@click.option(
    "--shard",
    metavar="K/N",
    help="Compute the K-th of N parts of the runs, beside other processes that compute the others.",
)
@click.option(
    "--checkpoint-seconds",
    type=click.FloatRange(min=0.0),
    default=30.0,
    show_default=True,
    help="Wall time between two checkpoints of a run.",
)
@click.option("--checkpoint-epochs", type=click.IntRange(min=1), help="Epochs between two checkpoints, at most.")
@engine_options
@click.option(
    "--progress",
    type=click.Choice(["auto", "rich", "plain", "none"]),
    default="auto",
    show_default=True,
    help="Bars, plain lines or nothing on stderr; auto: bars on a terminal.",
)
@click.option("-n", "--dry-run", is_flag=True, help="Say what would be computed and what it takes; compute nothing.")
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    config: str,
    settings: tuple[str, ...],
    seeds: str | None,
    out: Path | None,
    fork: Path | None,
    shard: str | None,
    checkpoint_seconds: float,
    checkpoint_epochs: int | None,
    engine: EngineChoice,
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
        wobblesim sweep study.yaml --engine dask --workers 8
    """  # noqa: D301 - click reads the backspace
    from wobblesim.config import load_config, remarks
    from wobblesim.study.work import Interval

    loaded = load_config(config, settings, seeds)
    part = _shard(shard)
    for remark in remarks(loaded):
        click.echo(f"note: {remark}", err=True)
    _warn_of_unsafe_wobbles(loaded)
    home = out or Path("results", loaded.name)
    if dry_run:
        from wobblesim.commands.dry_run import show

        workers, threads = engine.layout()
        show(loaded, fork or home, as_json, threads, workers, part)
        return
    options = {"checkpoint": Interval(checkpoint_seconds, checkpoint_epochs), "shard": part}
    outcome = _run(loaded, fork or home, engine, progress, fork_of=home if fork else None, **options)
    _report(outcome, as_json, part)
    if outcome.stopped:
        click.echo(f"stopped; to go on: {_same_command(ctx)}", err=True)
        ctx.exit(STOPPED)
    if outcome.failed:
        click.echo(
            f"{plural(outcome.failed, 'run')} failed: see `wobblesim status {shlex.quote(str(outcome.folder))}`",
            err=True,
        )
        ctx.exit(SOME_FAILED)


def _shard(text: str | None) -> Shard | None:
    from wobblesim.study.lock import Shard

    try:
        return Shard.of(text) if text else None
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--shard") from error


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


def _run(config: SweepConfig, folder: Path, engine: EngineChoice, progress: str, **options: Any) -> Outcome:
    from wobblesim.commands.display import display
    from wobblesim.commands.stopping import stop_on_signals
    from wobblesim.physics.kernels import is_warm
    from wobblesim.study.execute import sweep

    with display(progress) as shown, stop_on_signals(lambda: _promise_to_stop(shown), shown.close) as stop:
        if not is_warm():
            shown.say("compiling kernels, once on this machine: the first epoch takes some seconds more")
        opened = engine.opened(shown.say)
        return sweep(config, folder, threads=engine.threads, engine=opened, progress=shown, stop=stop, **options)


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


def _report(outcome: Outcome, as_json: bool, part: Shard | None) -> None:
    """Print the summary and draw the figure of what is there, be it a part; of a shard, which sees a part, neither."""
    from wobblesim.analysis.statistics import baseline, summary
    from wobblesim.analysis.tables import load
    from wobblesim.study.manifest import read_manifest

    told: dict[str, Any] = {name: getattr(outcome, name) for name in TOLD} | {"results": str(outcome.folder)}
    if part or not read_manifest(outcome.folder).runs:
        if as_json:
            echo_json(told | ({} if part else {"conditions": []}))
        elif part:
            runs = outcome.present + outcome.done
            click.echo(f"shard {part.number}/{part.count}: {runs:,} of {plural(outcome.wanted, 'run')} done")
            click.echo(f"results: {outcome.folder}")
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


def draw(folder: Path) -> Path:
    """Draw the learning curves of the results in a folder; return the path of the picture.

    Raises
    ------
    WriteError
        If the picture cannot be written.
    """
    from wobblesim.analysis.figures.registry import draw as drawing_of
    from wobblesim.analysis.figures.style import as_bytes
    from wobblesim.analysis.tables import load
    from wobblesim.commands.plot import write
    from wobblesim.study.errors import WriteError

    picture = as_bytes(drawing_of("figure-2b", load(folder)).figure, "png")
    path = folder / FIGURE
    try:
        write(path.parent, {path.name: picture})
    except WriteError as error:
        raise WriteError(f"the results are safe, their picture is not: {error}") from error
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
