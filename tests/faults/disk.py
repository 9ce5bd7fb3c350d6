"""The calls by which a process changes the disk: counted, made to fail or to be the last ones, recorded.

`Disk` stands between the program and the functions of Python that call the system (`os.replace`, `os.fsync`, `open`,
...), not between functions of the program: whatever the program comes to do with files is seen. A write is two calls,
one for each half of its bytes. fsync is noted, and left out: nothing here dies with the machine.

`Model` plays a record back as a disk may hold it after a power cut: of what was not flushed, anything may be missing.
"""

from __future__ import annotations

import builtins
import errno
import io
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

CHANGES = ("open", "write", "fsync", "truncate", "replace", "mkdir", "rmdir", "unlink", "link")


class Death(BaseException):
    """The process ends here: nothing that it still does on its way out reaches the disk."""


@dataclass(frozen=True)
class Call:
    """A call that changes the disk, or one that begins to read.

    Attributes
    ----------
    kind : str
        "open" (for writing), "write", "fsync", "truncate", "replace", "mkdir", "rmdir", "unlink", "link", "read", or
        "mark", which is none: something that the program was heard to say.
    path : str
    more : tuple
        What `Model` needs besides.
    """

    kind: str
    path: str
    more: tuple[Any, ...] = ()


@dataclass
class Disk:
    """The calls below a folder while it is entered.

    Attributes
    ----------
    root : Path
    before : callable
        Called before each with its number, from 1, and the call; what it raises is what the call raises.
    tried, calls : list of Call
        All of them; those that took place, with the marks among them.
    dead : bool
    """

    root: Path
    before: Callable[[int, Call], None] = lambda number, call: None
    tried: list[Call] = field(default_factory=list)
    calls: list[Call] = field(default_factory=list)
    dead: bool = False

    def __enter__(self) -> Disk:
        self._names: dict[int, str] = {}
        self._one_at_a_time, self._aside = threading.RLock(), 0
        self._stack = ExitStack()
        for name, made in self._replacements().items():
            self._stack.enter_context(mock.patch.object(os, name, made))
        for module in (builtins, io):
            self._stack.enter_context(mock.patch.object(module, "open", self._open))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def mark(self, *what: Any) -> None:
        """Note something in the record."""
        if not self.dead:
            self.calls.append(Call("mark", "", what))

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Look at the folder without being counted or refused."""
        with self._one_at_a_time:
            self._aside += 1
            yield
            self._aside -= 1

    def _do(self, real: Callable[[], Any], kind: str, path: str, *more: Any) -> Any:
        """Let a call take place, or not."""
        with self._one_at_a_time:
            if self._aside:
                return real()
            if self.dead:
                raise Death
            call = Call(kind, path, more)
            self.tried.append(call)
            try:
                self.before(len(self.tried), call)
            except Death:
                self.dead = True
                raise
            done = real()
            self.calls.append(call)
            return done

    def _is_mine(self, path: str) -> bool:
        return path == str(self.root) or path.startswith(f"{self.root}{os.sep}")

    def _path(self, path: Any, dir_fd: int | None = None) -> str:
        if isinstance(path, int):
            return self._names.get(path, "")
        base = Path(self._names.get(dir_fd, ".")) if dir_fd is not None else Path.cwd()
        return str(base / path)

    # --- names -----------------------------------------------------------------------------------------------------

    def _replacements(self) -> dict[str, Any]:
        one = {name: self._of_one_path(name) for name in ("mkdir", "rmdir", "unlink", "truncate")}
        two = {name: self._of_two_paths(name, kind) for name, kind in TWO_PATHS.items()}
        return one | two | {"remove": one["unlink"], "ftruncate": one["truncate"]} | {
            "open": self._os_open,
            "write": self._os_write,
            "fsync": self._fsync,
            "fdatasync": self._fsync,
            "sendfile": _no_sendfile,
        }  # fmt: skip

    def _of_one_path(self, name: str) -> Any:
        real = getattr(os, name)

        def call(path: Any, *rest: Any, dir_fd: int | None = None, **options: Any) -> Any:
            where = self._path(path, dir_fd)
            options |= {"dir_fd": dir_fd} if dir_fd is not None else {}
            if not self._is_mine(where):
                return real(path, *rest, **options)
            return self._do(lambda: real(path, *rest, **options), name, where, *rest[:1])

        return call

    def _of_two_paths(self, name: str, kind: str) -> Any:
        real = getattr(os, name)

        def call(source: Any, target: Any, **options: Any) -> Any:
            if not self._is_mine(self._path(target)):
                return real(source, target, **options)
            return self._do(lambda: real(source, target, **options), kind, self._path(target), self._path(source))

        return call

    # --- content ---------------------------------------------------------------------------------------------------

    def _os_open(self, path: Any, flags: int, *rest: Any, dir_fd: int | None = None) -> int:
        where = self._path(path, dir_fd)
        assert not (self._is_mine(where) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)), "not modelled"
        handle = OS_OPEN(path, flags, *rest, dir_fd=dir_fd)
        self._names[handle] = where
        return handle

    def _open(self, path: Any, mode: str = "r", buffering: int = -1, *text: Any, **options: Any) -> Any:
        where = "" if isinstance(path, int) else self._path(os.fspath(path))
        if not self._is_mine(where):
            return OPEN(path, mode, buffering, *text, **options)
        if not set(mode) & set("wax+"):
            return self._do(lambda: OPEN(path, mode, buffering, *text, **options), "read", where)
        if "w" in mode or not Path(where).exists():
            return self._do(lambda: self._file(where, mode, *text, **options), "open", where)
        return self._file(where, mode, *text, **options)

    def _file(self, where: str, mode: str, encoding: str | None = None, errors: Any = None, newline: Any = None) -> Any:
        raw = _File(self, where, mode.replace("b", "").replace("t", ""))
        buffered = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        return buffered if "b" in mode else io.TextIOWrapper(buffered, encoding, errors, newline)

    def _os_write(self, handle: int, data: Any) -> int:
        where = self._names.get(handle, "")
        if not self._is_mine(where):
            return OS_WRITE(handle, data)
        return self.write(where, os.fstat(handle).st_size, bytes(data), lambda part: OS_WRITE(handle, part))

    def write(self, where: str, offset: int, data: bytes, real: Callable[[bytes], int]) -> int:
        """Write, half of the bytes first."""
        half = len(data) // 2
        for start, part in ((0, data[:half]), (half, data[half:])):
            if part:
                done = self._do(partial(real, part), "write", where, offset + start, part)
                assert done == len(part)
        return len(data)

    def _fsync(self, handle: Any) -> None:
        where = self._names.get(handle if isinstance(handle, int) else handle.fileno(), "")
        if self._is_mine(where):
            self._do(lambda: None, "fsync", where)

    def named(self, handle: int, where: str) -> None:
        """Know what a file handle stands for."""
        self._names[handle] = where


OPEN, OS_OPEN, OS_WRITE = io.open, os.open, os.write

TWO_PATHS = {"replace": "replace", "rename": "replace", "link": "link"}


def _no_sendfile(*_: Any, **__: Any) -> int:
    """Have `shutil` copy by reads and writes."""
    raise OSError(errno.ENOTSOCK, "there is no sendfile here")


class _File(io.FileIO):
    """A file that is written to under the eyes of a disk."""

    def __init__(self, disk: Disk, where: str, mode: str) -> None:
        super().__init__(where, mode)
        self._disk, self._where, self._appends = disk, where, "a" in mode
        disk.named(self.fileno(), where)

    def write(self, data: Any) -> int:
        data = bytes(data)
        if self._disk.dead:  # what Python still flushes when it throws a file away
            return len(data)
        offset = os.fstat(self.fileno()).st_size if self._appends else self.tell()
        return self._disk.write(self._where, offset, data, super().write)


# --- what to do at a call ------------------------------------------------------------------------------------------


def die_at(number: int) -> Callable[[int, Call], None]:
    """Die before the call of a number."""

    def before(now: int, call: Call) -> None:
        if now == number:
            raise Death

    return before


def fail_at(number: int, code: int, kinds: frozenset[str], *, forever: bool) -> Callable[[int, Call], None]:
    """Refuse the call of a number, if it is of one of the kinds; all later ones as well if it is for ever."""

    def before(now: int, call: Call) -> None:
        if call.kind in kinds and (now == number or (forever and now > number)):
            raise OSError(code, os.strerror(code), call.path)

    return before


# --- what is left after a power cut --------------------------------------------------------------------------------


@dataclass(eq=False)
class FileNode:
    """A file: what is on the disk, and what was done to it since."""

    durable: bytes = b""
    pending: list[tuple[int, bytes] | int] = field(default_factory=list)

    def content(self, keep: Callable[[str], str]) -> bytes:
        """What may be left of it; `keep` says of each change "all", "half", "zeros" or "none"."""
        content = bytearray(self.durable)
        for change in self.pending:
            kept = keep("bytes")
            if kept == "none":
                continue
            if isinstance(change, int):
                content = content[:change].ljust(change, b"\0")
                continue
            offset, data = change
            part = {"all": data, "half": data[: len(data) // 2], "zeros": bytes(len(data))}[kept]
            content = content.ljust(offset, b"\0")
            content[offset : offset + len(part)] = part
        return bytes(content)

    def flush(self) -> None:
        """fsync."""
        self.durable, self.pending = self.content(lambda _: "all"), []


@dataclass(eq=False)
class FolderNode:
    """A folder: the names that are on the disk, and those given and taken since."""

    durable: dict[str, FileNode | FolderNode] = field(default_factory=dict)
    pending: list[tuple[str, FileNode | FolderNode | None]] = field(default_factory=list)

    def names(self, keep: Callable[[str], str]) -> dict[str, FileNode | FolderNode]:
        """What may be left of the names."""
        names: dict[str, FileNode | FolderNode | None] = dict(self.durable)
        names |= {name: node for name, node in self.pending if keep("names") != "none"}
        return {name: node for name, node in names.items() if node is not None}

    def flush(self) -> None:
        """fsync."""
        self.durable, self.pending = self.names(lambda _: "all"), []


@dataclass
class Model:
    """A folder as it is on the disk and in the mind of the system.

    Parameters
    ----------
    root : Path
        Its content now is on the disk.
    """

    root: Path

    def __post_init__(self) -> None:
        self._top = _node_of(self.root)
        assert isinstance(self._top, FolderNode)

    def play(self, call: Call, root: Path) -> None:
        """Let a call that was recorded in a copy of the folder take place."""
        if call.kind in CHANGES:
            change: Callable[..., None] = getattr(self, f"_{call.kind}")
            paths = [str(what).replace(str(root), str(self.root)) for what in (call.path, *call.more[:1])]
            change(*(paths if call.kind in ("replace", "link") else (paths[0], *call.more)))

    def left(self, keep: Callable[[str], str]) -> dict[str, bytes | None]:
        """What may be left: the content of each file by its path, None for a folder."""
        return dict(_left(self._top, "", keep))

    def _node(self, path: str) -> FileNode | FolderNode:
        node: FileNode | FolderNode = self._top
        for part in Path(path).relative_to(self.root).parts:
            assert isinstance(node, FolderNode)
            node = node.names(lambda _: "all")[part]
        return node

    def _name(self, path: str, node: FileNode | FolderNode | None) -> None:
        folder = self._node(str(Path(path).parent))
        assert isinstance(folder, FolderNode)
        folder.pending.append((Path(path).name, node))

    def _file(self, path: str) -> FileNode:
        node = self._node(path)
        assert isinstance(node, FileNode)
        return node

    def _open(self, path: str) -> None:
        try:
            self._file(path).pending.append(0)
        except KeyError:
            self._name(path, FileNode())

    def _write(self, path: str, offset: int, data: bytes) -> None:
        self._file(path).pending.append((offset, data))

    def _truncate(self, path: str, length: int) -> None:
        self._file(path).pending.append(length)

    def _fsync(self, path: str) -> None:
        self._node(path).flush()

    def _replace(self, target: str, source: str) -> None:
        node = self._node(source)
        self._name(target, node)
        self._name(source, None)

    def _link(self, target: str, source: str) -> None:
        self._name(target, self._node(source))

    def _mkdir(self, path: str, *_: int) -> None:
        self._name(path, FolderNode())

    def _unlink(self, path: str) -> None:
        self._name(path, None)

    def _rmdir(self, path: str) -> None:
        self._name(path, None)


def _node_of(path: Path) -> FileNode | FolderNode:
    if path.is_dir():
        return FolderNode({entry.name: _node_of(entry) for entry in path.iterdir()})
    return FileNode(path.read_bytes())


def _left(node: FileNode | FolderNode, path: str, keep: Callable[[str], str]) -> Iterator[tuple[str, bytes | None]]:
    if isinstance(node, FileNode):
        yield path, node.content(keep)
        return
    yield path, None
    for name, child in node.names(keep).items():
        yield from _left(child, f"{path}/{name}", keep)


def build(left: Mapping[str, bytes | None], target: Path) -> None:
    """Write what is left to a folder that is not there."""
    for path, content in left.items():
        if content is None:
            (target / path.lstrip("/")).mkdir()
        else:
            (target / path.lstrip("/")).write_bytes(content)


@contextmanager
def without_fsync() -> Iterator[None]:
    """Spare the disk of this machine."""
    with mock.patch.object(os, "fsync", return_value=None):
        yield
