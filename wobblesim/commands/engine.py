"""Options that say where runs are computed: in this process, on worker processes here, or on a cluster's."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from wobblesim.study.engines.contract import Engine

Command = TypeVar("Command", bound=Callable[..., Any])


@dataclass(frozen=True)
class EngineChoice:
    """The engine that was asked for, one attribute an option."""

    engine: str
    threads: int | None
    workers: int | None
    scheduler: str | None
    tls_ca: Path | None
    tls_cert: Path | None
    tls_key: Path | None
    insecure_tcp: bool
    dashboard: int | None

    def opened(self, said: Callable[[str], None]) -> AbstractContextManager[Engine] | None:
        """The engine; None for that of this process.

        Parameters
        ----------
        said : callable
            Told, in a sentence, of lost workers and the like.
        """
        if self.engine == "local":
            return None
        from wobblesim.study.engines.cluster import Certificates, cluster

        files = self.tls_ca, self.tls_cert, self.tls_key
        return _refused_as_usage(
            cluster(
                self.workers,
                self.threads,
                scheduler=self.scheduler,
                certificates=Certificates(*files) if all(files) else None,  # type: ignore[arg-type]
                insecure_tcp=self.insecure_tcp,
                dashboard=self.dashboard,
                said=said,
            )
        )

    def layout(self) -> tuple[int, int]:
        """Workers, and threads of each, that a sweep on this machine would have."""
        from wobblesim.physics.kernels import available_threads

        workers = self.workers or (available_threads() if self.engine == "dask" else 1)
        return workers, self.threads or max(1, available_threads() // workers)

    def check(self) -> None:
        """Refuse options that mean nothing together.

        Raises
        ------
        click.UsageError
            With the remedy.
        """
        of_dask = {"--workers": self.workers, "--scheduler": self.scheduler, "--dashboard": self.dashboard}
        given = [name for name, value in of_dask.items() if value is not None]
        if self.engine == "local" and given:
            raise click.UsageError(f"{given[0]} needs --engine dask")
        certificates = [file is not None for file in (self.tls_ca, self.tls_cert, self.tls_key)]
        if any(certificates) and not all(certificates):
            raise click.UsageError("--tls-ca, --tls-cert and --tls-key belong together; give all three")
        if (any(certificates) or self.insecure_tcp) and not self.scheduler:
            raise click.UsageError("certificates and --insecure-tcp are for a --scheduler; give its address")


@contextmanager
def _refused_as_usage(engine: AbstractContextManager[Engine]) -> Iterator[Engine]:
    """Open an engine; what it refuses of the options is told as such."""
    with ExitStack() as stack:
        try:
            opened = stack.enter_context(engine)
        except ValueError as error:
            raise click.UsageError(str(error)) from error
        yield opened


def engine_options(command: Command) -> Command:
    """Options of the engine, handed to the command as one argument `engine`."""

    @functools.wraps(command)
    def with_choice(*arguments: Any, **options: Any) -> Any:
        choice = EngineChoice(**{field.name: options.pop(field.name) for field in fields(EngineChoice)})
        choice.check()
        return command(*arguments, engine=choice, **options)

    pem = click.Path(exists=True, dir_okay=False, path_type=Path)
    made: Any = with_choice
    for decorate in reversed(
        (
            click.option(
                "--engine",
                type=click.Choice(["local", "dask"]),
                default="local",
                show_default=True,
                help="Compute in this process, or on the worker processes of dask.",
            ),
            click.option(
                "--threads",
                type=click.IntRange(min=1),
                help="Threads at most, of each worker.  [default: one for each processor]",
            ),
            click.option(
                "--workers", type=click.IntRange(min=1), help="Worker processes.  [default: one for each processor]"
            ),
            click.option(
                "--scheduler", metavar="ADDRESS", help="Use the workers of a running scheduler, tls://HOST:PORT."
            ),
            click.option("--tls-ca", metavar="FILE", type=pem, help="Certificate of the cluster's authority."),
            click.option("--tls-cert", metavar="FILE", type=pem, help="Our certificate for the scheduler."),
            click.option("--tls-key", metavar="FILE", type=pem, help="Its private key."),
            click.option(
                "--insecure-tcp",
                is_flag=True,
                help="Allow tcp:// to another machine: whoever reaches that scheduler can run code as you.",
            ),
            click.option(
                "--dashboard", metavar="PORT", type=click.IntRange(0, 65535), help="Show dask's dashboard on loopback."
            ),
        )
    ):
        made = decorate(made)
    return made
