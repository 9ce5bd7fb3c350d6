"""`wobblesim warmup`: compile the kernels now, so that a sweep starts at once."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from wobblesim.commands.options import echo_json, json_option, plural

if TYPE_CHECKING:
    from wobblesim.numerics.warmup import Warmed


@click.command("warmup")
@click.option("--integrator", "integrators", multiple=True, metavar="NAME", help="This integrator; may be given again.")
@click.option(
    "--precision",
    "precisions",
    multiple=True,
    type=click.Choice(["float32", "float64"]),
    help="This precision; may be given again.",
)
@click.option("--all", "everything", is_flag=True, help="All integrators in both precisions, with and without floor.")
@json_option
def command(integrators: tuple[str, ...], precisions: tuple[str, ...], everything: bool, as_json: bool) -> None:
    """Compile the kernels that a sweep needs, once on a machine.

    Without options those of the default integrator and precision on the floor, in every lane width; a sweep with
    them then starts in about a second. Kernels are kept in the user's cache folder, or below NUMBA_CACHE_DIR.
    """
    from wobblesim.numerics.warmup import SCENES, warm_up
    from wobblesim.physics.kernels import FOLDER
    from wobblesim.physics.registry import INTEGRATORS
    from wobblesim.physics.scene import Physics

    for name in integrators:
        if name not in INTEGRATORS:
            raise click.BadParameter(f"{name!r} is not one of {', '.join(INTEGRATORS)}", param_hint="--integrator")
    if "NUMBA_DISABLE_JIT" in os.environ and os.environ["NUMBA_DISABLE_JIT"] != "0":
        raise click.ClickException("NUMBA_DISABLE_JIT is set: nothing is compiled")
    if FOLDER is None:
        raise click.ClickException("kernels cannot be kept, so warming up is of no use: see the warning above")
    default = Physics()
    integrators = integrators or (tuple(INTEGRATORS) if everything else (default.integrator,))
    precisions = precisions or (("float32", "float64") if everything else (default.precision,))
    warmed = []
    for kernel in warm_up(integrators, precisions, tuple(SCENES) if everything else ("floor",)):
        click.echo(_as_text(kernel), err=True)
        warmed.append(kernel)
    size = _size(FOLDER)
    if as_json:
        echo_json({"folder": str(FOLDER), "bytes": size, "kernels": [asdict(kernel) for kernel in warmed]})
        return
    compiled = sum(kernel.compiled for kernel in warmed)
    click.echo(
        f"{plural(len(warmed), 'kernel')}: {compiled} compiled, {len(warmed) - compiled} were there; "
        f"{size / 1e6:.1f} MB in {FOLDER}"
    )


def _as_text(kernel: Warmed) -> str:
    done = "compiled" if kernel.compiled else "there already, loaded"
    return (
        f"{kernel.integrator} {kernel.precision}, {kernel.scene}, {plural(kernel.width, 'lane')}: "
        f"{done} in {kernel.seconds:.2f} s"
    )


def _size(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*.nbc"))
