"""`wobblesim plot`: draw the learning curves anew."""

from __future__ import annotations

from pathlib import Path

import click


@click.command("plot")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--out",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="PNG to write.  [default: DIR/figures/learning-curve.png]",
)
def command(folder: Path, out: Path | None) -> None:
    """Draw the learning curves of the results in DIR, also while a sweep is writing there."""
    from wobblesim.commands.sweep import draw

    if out and out.suffix.lower() != ".png":
        raise click.BadParameter(f"{out} does not end in .png, and PNG is what is written", param_hint="--out")
    click.echo(draw(folder, out))
