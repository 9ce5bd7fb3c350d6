"""How far a long read is, on stderr: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

SAY_EVERY = 30.0
"""s between two lines where there is no bar."""


@contextmanager
def reading(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show how many bytes of how many are read, as told to the function that is yielded."""
    if sys.stderr.isatty():
        with _bar(what) as bar:
            yield bar
        return
    said = [time.monotonic()]

    def tell(done: int, total: int) -> None:
        if time.monotonic() - said[0] > SAY_EVERY:
            said[0] = time.monotonic()
            click.echo(f"{what}: {done / 1e6:,.0f} of {total / 1e6:,.0f} MB", err=True)

    yield tell


@contextmanager
def _bar(what: str) -> Iterator[Callable[[int, int], None]]:
    from rich import progress as bars
    from rich.console import Console

    columns = (bars.TextColumn("{task.description}"), bars.BarColumn(bar_width=30), bars.DownloadColumn())
    shown = bars.Progress(
        *columns, bars.TransferSpeedColumn(), bars.TimeRemainingColumn(), console=Console(stderr=True), transient=True
    )
    with shown:
        task = shown.add_task(what, total=None)
        yield lambda done, total: shown.update(task, completed=done, total=total)
