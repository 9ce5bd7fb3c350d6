"""What a sweep says while it runs, on stderr: bars on a terminal, plain lines elsewhere."""

from __future__ import annotations

import os
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TextIO

import click

from wobblesim.commands.options import plural

if TYPE_CHECKING:
    from wobblesim.study.progress import Progress

SAY_AT_LEAST_EVERY = 30.0
"""s without a line, at most, where there are no bars."""


class _Stderr:
    """Standard error, which may be gone: a closed terminal or pipe must not cost a checkpoint."""

    def __init__(self) -> None:
        self._stream = sys.stderr

    def write(self, text: str) -> int:
        """Write, if anybody reads."""
        return self._try(lambda: self._stream.write(text)) or len(text)

    def flush(self) -> None:
        """Flush, if anybody reads."""
        self._try(self._stream.flush)

    def _try(self, call: Callable[[], Any]) -> Any:
        try:
            return call()
        except OSError:
            _let_go(self._stream, sys.stdout)
            return None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _let_go(*streams: TextIO) -> None:
    """Have what is written to streams that nobody reads any more go nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in streams:
        if _is_gone(stream):
            os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _is_gone(stream: TextIO) -> bool:
    """Whether writing to a stream fails."""
    try:
        stream.flush()
        os.write(stream.fileno(), b"")
    except ValueError:  # it has no file, or is closed
        return False
    except OSError:
        return True
    return False


def _say(line: str) -> None:
    click.echo(line, file=_Stderr())  # type: ignore[arg-type]


class Display(ABC):
    """Shows the progress of a sweep while it is entered."""

    def __enter__(self) -> Display:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        _let_go(sys.stderr, sys.stdout)

    @abstractmethod
    def close(self) -> None:
        """Leave the terminal as it was."""

    @abstractmethod
    def say(self, message: str) -> None:
        """Show one sentence."""

    @abstractmethod
    def __call__(self, progress: Progress) -> None:
        """Show where the sweep stands."""


class Silent(Display):
    """Says only what went wrong."""

    def close(self) -> None:
        """Nothing is open."""

    def say(self, message: str) -> None:
        """Say nothing."""

    def __call__(self, progress: Progress) -> None:
        """Show failures and notes."""
        if progress.kind in ("failure", "note"):
            _say(progress.message)


class Plain(Display):
    """One line for each finished run, and one at least every 30 s."""

    def __init__(self, every: float = SAY_AT_LEAST_EVERY) -> None:
        self.every = every
        self._last: Progress | None = None
        self._spoke = threading.Event()
        self._closed = False
        self._speaker = threading.Thread(target=self._speak, daemon=True)
        self._speaker.start()

    def _speak(self) -> None:
        while not self._closed:
            if self._spoke.wait(self.every):
                self._spoke.clear()
            elif self._last is not None:
                self._echo(f"{self._last.group}, epoch {self._last.epoch} of {self._last.epochs}: {where(self._last)}")

    def close(self) -> None:
        """Say no more."""
        self._closed = True
        self._spoke.set()
        self._speaker.join()

    def _echo(self, line: str) -> None:
        _say(line)

    def say(self, message: str) -> None:
        """Write a line."""
        self._echo(message)
        self._spoke.set()

    def __call__(self, progress: Progress) -> None:
        """Write a line for all but single epochs."""
        self._last = progress
        if progress.kind == "begin":
            self.say(where(progress))
        elif progress.kind == "run":
            self.say(f"{progress.message} ({where(progress)})")
        elif progress.kind in ("failure", "note"):
            self.say(progress.message)


class Bars(Display):
    """Two bars, the whole sweep and the runs in progress; notes and failures scroll above them."""

    def __init__(self) -> None:
        from rich import progress as bars
        from rich.console import Console

        self._console = Console(file=_Stderr(), highlight=False)  # type: ignore[arg-type]
        self._bars = bars.Progress(
            bars.TextColumn("{task.description}"),
            bars.BarColumn(bar_width=30),
            bars.TextColumn("{task.percentage:>3.0f} %"),
            bars.TextColumn("{task.fields[where]}"),
            console=self._console,
        )
        self._sweep = self._bars.add_task("sweep", total=1.0, where="")
        self._group = self._bars.add_task("", total=None, where="", visible=False)
        self._bars.start()

    def close(self) -> None:
        """Stop drawing and show the cursor again."""
        self._bars.stop()

    def say(self, message: str) -> None:
        """Show a sentence above the bars."""
        self._console.print(message, markup=False)

    def __call__(self, progress: Progress) -> None:
        """Move the bars."""
        if progress.kind in ("failure", "note"):
            self.say(progress.message)
        self._bars.update(self._sweep, completed=progress.fraction, where=where(progress))
        shown: dict[str, Any] = {"visible": progress.kind != "end" and progress.epochs > 0}
        self._bars.update(
            self._group,
            description=progress.group,
            completed=progress.epoch,
            total=progress.epochs or None,
            where=f"epoch {progress.epoch} of {progress.epochs}",
            **shown,
        )


def where(progress: Progress) -> str:
    """Where a sweep stands, in words."""
    parts = [f"{progress.present + progress.done} of {plural(progress.wanted, 'run')} done"]
    if progress.kind == "begin" and progress.present:
        parts[0] += " before"
    parts.append(f"{progress.failed} failed")
    parts.append(f"{plural(progress.diverged, 'trial')} diverged, {progress.refined:,} refined")
    if progress.remaining is not None and progress.kind != "end":
        parts.append(f"{duration(progress.remaining)} left")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """Say a time in words, to two digits or so."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    if seconds < 3600:
        return f"{seconds / 60:.0f} min"
    hours = seconds / 3600
    return f"{hours:.1f} h" if hours < 48 else f"{hours / 24:.1f} days"


def display(kind: str) -> Display:
    """The display of a name: auto, rich, plain or none."""
    is_terminal = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
    if kind == "rich" or (kind == "auto" and is_terminal):
        return Bars()
    return Silent() if kind == "none" else Plain()
