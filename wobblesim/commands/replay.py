"""`wobblesim replay`: watch what robots have learnt."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.options import echo_json, json_option, print_table, table

if TYPE_CHECKING:
    from wobblesim.viewing.recording import Recording
    from wobblesim.viewing.replay import Replay


@click.command("replay")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--condition", metavar="ID", help="Watch a run of this condition.")
@click.option("--seed", type=click.IntRange(min=0), help="Watch the run with this seed.")
@click.option(
    "--epoch",
    type=click.IntRange(min=0),
    help="Watch the best behaviour of this epoch; needs `log: behaviours`.  [default: the last]",
)
@click.option("--best", is_flag=True, help="Watch the run with the highest performance.")
@click.option("--pair", is_flag=True, help="Watch the fixed robot and another one with the same seed, on one clock.")
@click.option(
    "--out",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="A page (.html) or a film (.gif, .mp4).  [default: DIR/replays/NAME.html]",
)
@click.option(
    "--seconds",
    type=click.FloatRange(min=0, min_open=True),
    help="How much of the trial is shown.  [default: all of it; of a GIF 10, of an MP4 30]",
)
@click.option(
    "--fps",
    type=click.FloatRange(min=0, min_open=True, max=120),
    help="Frames a second.  [default: 30; of a GIF 15, and at most 50]",
)
@json_option
def command(
    folder: Path,
    condition: str | None,
    seed: int | None,
    epoch: int | None,
    best: bool,
    pair: bool,
    out: Path | None,
    seconds: float | None,
    fps: float | None,
    as_json: bool,
) -> None:
    """Write a page in which the robots of the results in DIR move as they have learnt to.

    The page needs no network, and no trajectories need be stored: the behaviours are simulated again, and it is said if
    their performance is not, to the last bit, the stored one.

    With none of --condition, --best and --pair, a pair if there is a condition `fixed`, else the best. --best looks
    among the runs with the condition and the seed, if these are given. --pair takes the other condition with the
    highest mean, and the seed in which both differ most nearly by the median, unless they are given.

    \b
    Examples:
        wobblesim replay results/quickstart
        wobblesim replay results/quickstart --condition wobbling --seed 2
        wobblesim replay results/quickstart --best --out best.gif --seconds 5
    """  # noqa: D301 - click reads the backspace
    from wobblesim.viewing.replay import FOLDER, check_name

    if best and pair:
        raise click.UsageError("--best is one run and --pair are two: give one of them")
    if out:
        check_name(out)
    _tell_of_kernels()
    is_film = out is not None and out.suffix.lower() != ".html"
    made = _made(folder, condition, seed, epoch, best, pair, seconds, fps, is_film)
    path = made.save(out or folder / FOLDER / f"{made.name}.html", seconds=seconds, fps=fps)
    if as_json:
        echo_json({"file": str(path), "bytes": path.stat().st_size, "robots": [_as_data(it) for it in made.recordings]})
    else:
        _print(path, made)


def _tell_of_kernels() -> None:
    from wobblesim.physics.kernels import is_warm

    if not is_warm():
        click.echo("compiling kernels, once on this machine: this takes some seconds more", err=True)


def _made(
    folder: Path,
    condition: str | None,
    seed: int | None,
    epoch: int | None,
    best: bool,
    pair: bool,
    seconds: float | None,
    fps: float | None,
    is_film: bool,
) -> Replay:
    """Record at the rate of a page, and so that every frame of a film has one near it."""
    from wobblesim.viewing.recording import FRAMES_PER_SECOND
    from wobblesim.viewing.replay import replay

    rate = fps or FRAMES_PER_SECOND
    return replay(
        folder,
        condition=condition,
        seed=seed,
        epoch=epoch,
        best=best,
        pair=pair,
        seconds=seconds,
        frames_per_second=max(rate, FRAMES_PER_SECOND) if is_film else rate,
    )


def _print(path: Path, made: Replay) -> None:
    click.echo(f"{path} ({path.stat().st_size / 1e6:.2f} MB)")
    titles = ["condition", "seed", "epoch", "body lengths", "trial"]
    print_table(table(titles, [_cells(it) for it in made.recordings]))
    for it in made.recordings:
        for note in it.notes:
            click.echo(f"{it.condition}, {it.run}: {note}")


def _cells(it: Recording) -> list[str]:
    from rich.markup import escape

    score = f"{it.performance:.3f}" if it.performance == it.performance else "diverged"
    return [escape(it.condition), f"{it.seed}", f"{it.epoch:,}", score, f"{it.duration:g} s"]


def _as_data(it: Recording) -> dict[str, Any]:
    return {
        "condition": it.condition,
        "seed": it.seed,
        "epoch": it.epoch,
        "performance": it.performance,
        "stored": it.stored,
        "same_bits": it.is_the_stored_trial,
        "status": it.status,
        "seconds": float(it.times[-1]),
        "frames": len(it.times),
        "notes": it.notes,
    }
