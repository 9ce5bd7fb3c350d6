"""The command line. A command's file is imported when the command is named, what it needs when it runs."""

from __future__ import annotations

import importlib
import sys
from typing import IO, Any

import click

COMMANDS = {
    "sweep": "wobblesim.commands.sweep",
    "status": "wobblesim.commands.status",
    "verify": "wobblesim.commands.verify",
    "compact": "wobblesim.commands.compact",
    "rerun": "wobblesim.commands.rerun",
    "stats": "wobblesim.commands.stats",
    "plot": "wobblesim.commands.plot",
    "report": "wobblesim.commands.report",
    "replay": "wobblesim.commands.replay",
    "check": "wobblesim.commands.check",
    "schema": "wobblesim.commands.schema",
    "accuracy": "wobblesim.commands.accuracy",
    "stability": "wobblesim.commands.stability",
    "explain": "wobblesim.commands.explain",
    "bench": "wobblesim.commands.bench",
    "warmup": "wobblesim.commands.warmup",
}
"""Where each command lives: a module with a `command`."""

INTERRUPTED = 130

REFUSED = (("study.errors", "StoreError"), ("study.plan", "PlanError"), ("analysis.errors", "FigureError"))
"""Errors, by module and name, whose message is one sentence for the user."""


class LazyGroup(click.Group):
    """Commands by name, imported when needed; what users can put right ends in one sentence instead of a traceback."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of a name."""
        return importlib.import_module(COMMANDS[cmd_name]).command if cmd_name in COMMANDS else None

    def invoke(self, ctx: click.Context) -> object:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except KeyboardInterrupt:
            ctx.exit(INTERRUPTED)
        except Exception as error:
            if refusal := _in_one_sentence(error):
                raise refusal from error
            raise


def _in_one_sentence(error: Exception) -> click.ClickException | None:
    """What a mistake of the user, or a full disk, is told as; other errors are ours and have a traceback."""
    if _is(error, "config.errors", "ConfigError"):
        return _Refusal(error.report())  # type: ignore[attr-defined]
    if _is(error, "study.errors", "WriteError"):
        return _NotWritten(str(error))
    if any(_is(error, *refused) for refused in REFUSED):
        return _Refusal(str(error))
    return None


def _is(error: Exception, module: str, name: str) -> bool:
    """Whether an error is of a class of the package, without importing it: who raised it has."""
    home = sys.modules.get(f"wobblesim.{module}")
    return home is not None and isinstance(error, getattr(home, name))


class _Refusal(click.ClickException):
    """A message shown as it is, so that FILE:LINE:COLUMN stands first."""

    exit_code = 2

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the message on stderr."""
        click.echo(self.message, file=file, err=True)


class _NotWritten(_Refusal):
    exit_code = 1


def _show_version(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    if asked:
        from wobblesim.study.provenance import version_of

        click.echo(f"wobblesim {version_of('wobblesim')}")
        ctx.exit()


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_version,
    help="Show the version and exit.",
)
def main() -> None:
    """Does oscillating a robot's morphology while it learns make it learn better?

    \b
    Begin with
        wobblesim sweep configs/quickstart.yaml

    Results go to stdout, everything else to stderr. Exit codes: 0 done, 1 internal error, 2 bad usage or
    configuration, 3 done but some runs failed, 4 stopped early (the same command goes on), 130 second Ctrl-C.
    """  # noqa: D301 - click reads the backspace
