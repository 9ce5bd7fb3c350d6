"""The dask engine: a worker a group of runs, in processes of this machine or wherever a scheduler has some.

What comes in over dask's connections is unpickled, which is to say run. So every connection is encrypted, and both of
its ends show a certificate: one made for the moment if the workers are started here (loopback is open to all users of a
machine), the user's own if a scheduler is given.
"""

from __future__ import annotations

import ipaddress
import logging
import multiprocessing
import os
import signal
import socket
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import dask
from distributed import Client, LocalCluster, Security

from wobblesim.physics.kernels import available_threads
from wobblesim.physics.simulate import Trials, simulate
from wobblesim.study.engines import worker
from wobblesim.study.engines.dispatch import Dispatch, threads_of
from wobblesim.study.errors import StoreError, first_line, reason
from wobblesim.study.work import Beat, Job, Receipt

LOOPBACK = "127.0.0.1"

CONNECT_PATIENCE = 10.0
"""s to reach a scheduler, and to see a first worker there."""

CLOSE_PATIENCE = 30.0
"""s for local workers to end by themselves; they take less than one, but one may just be starting."""


@dataclass(frozen=True)
class Certificates:
    """Files in PEM format that this process shows, and believes, on connections to a scheduler.

    Attributes
    ----------
    ca : path
        Of the authority that all of the cluster's certificates are signed by.
    cert, key : path
        This process's certificate, and its private key.
    """

    ca: str | Path
    cert: str | Path
    key: str | Path


@dataclass(frozen=True)
class Cluster:
    """Computes jobs on the workers of a scheduler; made by `cluster`.

    Attributes
    ----------
    client : Client
    simulate : callable
    workers, threads : int
        Workers that are expected, and threads of each.
    fixed_threads : bool
        Whether workers are to use `threads` whatever they have been given themselves.
    is_local : bool
        Whether the workers are processes of this machine, started by this one.
    said : callable
        Told, in a sentence, of what a user might want to know.
    """

    client: Client
    simulate: Callable[..., Trials]
    workers: int
    threads: int
    fixed_threads: bool
    is_local: bool
    said: Callable[[str], None]

    def __call__(
        self, jobs: Iterable[Job], heard: Callable[[Beat], None], stop: Callable[[], bool]
    ) -> Iterator[Receipt]:
        """Compute jobs, one a worker at a time."""
        threads = self.threads if self.fixed_threads else None
        dispatch = Dispatch(self.client, self.simulate, threads, self.is_local, self.said, jobs, heard, stop)
        return dispatch.receipts()


@contextmanager
def cluster(
    workers: int | None = None,
    threads: int | None = None,
    *,
    scheduler: str | None = None,
    certificates: Certificates | None = None,
    insecure_tcp: bool = False,
    dashboard: int | None = None,
    simulate: Callable[..., Trials] = simulate,
    said: Callable[[str], None] = lambda _: None,
) -> Iterator[Cluster]:
    """Open the dask engine.

    Parameters
    ----------
    workers : int, optional
        Processes to start; one for each processor if not given. With a scheduler, how many workers to lay the groups
        of runs out for; as many as it has now if not given.
    threads : int, optional
        Of each worker. If not given: here, its share of the processors; with a scheduler, as many as the worker was
        started with (``dask worker --nthreads``).
    scheduler : str, optional
        Address of a scheduler to use instead of starting workers here: ``tls://host:port``, or ``tcp://host:port``.
    certificates : Certificates, optional
        For ``tls://``; those of dask's configuration if not given.
    insecure_tcp : bool
        Allows ``tcp://`` to another machine: whoever reaches that scheduler can run any code as this user.
    dashboard : int, optional
        Port, on loopback, of dask's dashboard; 0 for any. There is none if not given.
    simulate : callable
        Called as `wobblesim.simulate` is; another one makes another task of it. It is sent to the workers by pickle.
    said : callable
        Told, in a sentence, of lost workers and the like.

    Raises
    ------
    ValueError
        If the options contradict each other, or the address is refused; one sentence with its remedy.
    StoreError
        If the scheduler cannot be reached, or workers cannot be started.
    """
    with ExitStack() as stack:
        stack.enter_context(_quiet())
        if scheduler is None:
            count = workers or available_threads()
            share = threads or max(1, available_threads() // count)
            client = stack.enter_context(_local(count, share, dashboard, said))
            yield Cluster(client, simulate, count, share, fixed_threads=True, is_local=True, said=said)
            return
        if dashboard is not None:
            raise ValueError("the dashboard of a given scheduler is its own business; leave out --dashboard")
        security = _security(scheduler, certificates, insecure_tcp)
        client = stack.enter_context(_remote(scheduler, security))
        with suppress(TimeoutError):  # they may be a day late: a batch system starts them when it pleases
            client.wait_for_workers(1, timeout=CONNECT_PATIENCE)
        found = threads_of(client)
        share = threads or min(found.values(), default=1)
        yield Cluster(client, simulate, workers or max(1, len(found)), share, threads is not None, False, said)


# --- workers of this machine ---------------------------------------------------------------------------------------


@contextmanager
def _local(workers: int, threads: int, dashboard: int | None, said: Callable[[str], None]) -> Iterator[Client]:
    """Start workers on loopback, which end with this process, whatever ends it."""
    with tempfile.TemporaryDirectory(prefix="wobblesim-") as scratch, _environment_kept(), ExitStack() as stack:
        stack.enter_context(dask.config.set(_settings(scratch, dashboard)))
        try:
            with _signals_blocked():
                made = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    host=LOOPBACK,
                    security=Security.temporary(),
                    scheduler_kwargs={
                        "dashboard": dashboard is not None,
                        "dashboard_address": f"{LOOPBACK}:{dashboard or 0}",
                    },
                    worker_dashboard_address=f"{LOOPBACK}:0",
                    memory_limit=0,
                    silence_logs=logging.CRITICAL,
                    env={"NUMBA_NUM_THREADS": str(threads)},
                )
                stack.callback(_close, made)
                client = stack.enter_context(Client(made, timeout=CONNECT_PATIENCE))
        except (OSError, RuntimeError, ImportError) as error:
            raise StoreError(f"cannot start workers: {first_line(error)}; try --engine local") from error
        if dashboard is not None:
            said(f"dashboard: {made.dashboard_link}")
        yield client


def _settings(scratch: str, dashboard: int | None) -> dict[str, Any]:
    """What dask is to do otherwise than it would."""
    quiet = {"DASK_LOGGING__DISTRIBUTED": "critical"}
    environ = dask.config.get("distributed.nanny.pre-spawn-environ") | quiet
    settings: dict[str, Any] = {
        "temporary-directory": scratch,
        "distributed.nanny.pre-spawn-environ": environ,
        "distributed.scheduler.active-memory-manager.start": False,
        "distributed.scheduler.work-stealing": False,
        "distributed.worker.profile.enabled": False,
        "distributed.worker.preload": [worker.__name__],  # all import at once, and before they are sent anything
        # A worker is started again by its nanny, however long that takes.
        "distributed.deploy.lost-worker-timeout": "1h",
    }
    if dashboard is None:
        settings |= {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}
    return settings


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """Have the threads and processes that are started meanwhile never see what is meant for this process.

    Ctrl-C on a terminal and the end of a session go to all processes of a group, and batch systems send SIGTERM to all
    of a job; the workers are to finish their epoch, and this process tells them so. A blocked signal stays blocked in
    what a thread starts, also when a worker is started again later.
    """
    resource_tracker.ensure_running()  # it would unblock them when started later
    earlier = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, earlier)


@contextmanager
def _environment_kept() -> Iterator[None]:
    """Undo what dask sets in this process's environment for the sake of its workers."""
    earlier = dict(os.environ)
    try:
        yield
    finally:
        for name in os.environ.keys() - earlier.keys():
            del os.environ[name]
        os.environ.update(earlier)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep dask's log off the terminal; what matters is said in a sentence."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client", "tornado", "asyncio")]
    earlier = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.CRITICAL + 1)
        yield
    finally:
        for logger, level in zip(loggers, earlier, strict=True):
            logger.setLevel(level)


def _close(made: LocalCluster) -> None:
    """End the workers, in the end by force: SIGTERM they do not see."""
    nannies, loop = list(made.workers.values()), made.loop
    assert loop is not None
    for nanny in nannies:
        loop.add_callback(nanny.close_gracefully)  # it does not start its worker again
    try:
        with suppress(TimeoutError):
            made.close(timeout=CLOSE_PATIENCE)
    finally:
        mine = {nanny.pid for nanny in nannies}
        for process in multiprocessing.active_children():
            if process.pid in mine:
                process.kill()


# --- a scheduler elsewhere -----------------------------------------------------------------------------------------


def _security(scheduler: str, certificates: Certificates | None, insecure_tcp: bool) -> Security:
    """What to show to a scheduler.

    Raises
    ------
    ValueError
        If the connection would be open to others, or what it needs is not there.
    """
    scheme, host = _parsed(scheduler)
    if scheme == "tls":
        return _tls(certificates)
    if certificates:
        raise ValueError(f"{scheduler} takes no certificates; write tls:// for a scheduler that has its own")
    if not insecure_tcp and not _is_loopback(host):
        raise ValueError(
            f"{scheduler} is not encrypted: whoever reaches it can run code as you; use tls:// with certificates, or "
            "give --insecure-tcp on a network that you trust"
        )
    return Security(require_encryption=False)


def _parsed(scheduler: str) -> tuple[str, str]:
    """Scheme and host of an address."""
    try:
        parts = urlsplit(scheduler)
        if parts.scheme in ("tls", "tcp") and parts.hostname and parts.port:
            return parts.scheme, parts.hostname
    except ValueError:  # a port out of range, brackets that do not match
        pass
    raise ValueError(f"{scheduler!r} is not the address of a scheduler; write tls://host:port")


def _is_loopback(host: str) -> bool:
    """Whether all addresses of a host are on loopback."""
    try:
        found = {entry[4][0] for entry in socket.getaddrinfo(host, None)}
    except OSError as error:
        raise ValueError(f"there is no host {host}: {reason(error)}") from error
    return all(ipaddress.ip_address(address).is_loopback for address in found)


def _tls(certificates: Certificates | None) -> Security:
    """Certificates given, or those of dask's configuration."""
    given = vars(certificates) if certificates else {}
    options = {"ca": "tls_ca_file", "cert": "tls_client_cert", "key": "tls_client_key"}
    security = Security(require_encryption=True, **{options[name]: str(path) for name, path in given.items()})
    if any(getattr(security, option) is None for option in options.values()):
        raise ValueError("tls:// needs certificates; give --tls-ca, --tls-cert and --tls-key")
    try:
        security.get_connection_args("client")
    except OSError as error:  # ssl.SSLError is one
        raise ValueError(f"cannot use the certificates: {reason(error)}") from error
    return security


@contextmanager
def _remote(scheduler: str, security: Security) -> Iterator[Client]:
    try:
        client = Client(scheduler, security=security, timeout=CONNECT_PATIENCE, set_as_default=False)
    except OSError as error:
        raise StoreError(f"cannot reach {scheduler}: {_why(scheduler, error)}") from error
    with client:
        yield client


def _why(scheduler: str, error: OSError) -> str:
    """What keeps this process from talking to a scheduler; dask's words for it depend on who hangs up first."""
    if "Timed out" in str(error):
        return f"nobody answers there within {CONNECT_PATIENCE:.0f} s"
    if scheduler.startswith("tls"):
        return "one side does not believe the other; all certificates of a cluster need the same authority (--tls-ca)"
    return "it hangs up; write tls:// for a scheduler that has certificates"
