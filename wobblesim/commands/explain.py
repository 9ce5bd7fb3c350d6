"""`wobblesim explain`."""

from __future__ import annotations

import click


@click.command("explain")
def command() -> None:
    """What a configuration leaves out, and what it costs."""
