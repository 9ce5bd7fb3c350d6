"""How kernels are compiled and kept: one decorator, and a folder on disk that holds no stale, torn or foreign kernel.

Numba's own cache notices a change of the file that holds a function, but not of the files it calls into; it crashes
on a file that was cut short; and processes that compile at once can leave an index that names each other's code.
Here the folder's name carries the version, a hash of every source file of this package and of the compiler's versions,
and the processor, so that a home shared by several machines works; each kernel is a file of its own, replaced at once
and checked by a checksum. As a kernel is a pickle, nothing is read that another user may have written.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import os
import pickle
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import llvmlite
import numba
import numpy as np
from llvmlite import binding
from numba.core import caching
from numba.core.serialize import dumps

_config: Any = numba.config
_njit: Any = numba.njit
_user: Callable[[], int] = getattr(os, "geteuid", lambda: 0)  # Windows knows no such number: all files seem ours
CHECKSUM_BYTES = hashlib.sha256().digest_size
WRITABLE_BY_OTHERS = 0o022


def available_threads() -> int:
    """Threads that Numba may use: the cores this process may run on, or NUMBA_NUM_THREADS."""
    return int(_config.NUMBA_NUM_THREADS)


@functools.cache
def kernel_hash() -> str:
    """Hash of the kernels' sources and of the compiler's versions: equal hashes mean equal kernels."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
    digest.update(f"{numba.__version__} {llvmlite.__version__} {np.__version__}".encode())
    return digest.hexdigest()[:16]


# --- the folder -----------------------------------------------------------------------------------------------


def processor() -> str:
    """What kernels are compiled for: the processor's name to LLVM, and a hash of its features."""
    features = _config.CPU_FEATURES
    if features is None:
        features = binding.get_host_cpu_features().flatten()
    return f"{_config.CPU_NAME or binding.get_host_cpu_name()}-{hashlib.sha256(features.encode()).hexdigest()[:8]}"


def cache_folder() -> Path:
    """Where compiled kernels are kept: below NUMBA_CACHE_DIR if it is set, else in the user's cache folder."""
    # By name: an import of the whole package would tie physics to all that the package offers.
    version = importlib.import_module(__name__.partition(".")[0]).__version__
    name = f"{version}-{kernel_hash()}-{processor()}"
    if base := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(base) / f"wobblesim-{_user()}-{name}"  # others may use the same place
    if sys.platform == "win32":
        root = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        root = Path.home() / "Library" / "Caches"
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return root / "wobblesim" / name


def is_warm() -> bool:
    """Whether some kernels have been compiled on this machine before."""
    return FOLDER is not None and any(FOLDER.glob("*/*.nbc"))


def _usable_folder() -> Path | None:
    """The folder, made if need be; None, with a warning, where it cannot be made or others could change it."""
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        found = folder.stat()
    except (OSError, RuntimeError) as error:  # RuntimeError: there is no home
        _warn(f"kernels are not cached: {error}")
        return None
    if found.st_uid != _user() or (os.name == "posix" and found.st_mode & WRITABLE_BY_OTHERS):
        _warn(f"kernels are not cached: others may write to {folder}; remove it")
        return None
    return folder


@functools.cache  # once: Numba's compiler makes Python forget which warnings it has shown
def _warn(what: str) -> None:
    warnings.warn(what, RuntimeWarning, stacklevel=2)


# --- the files ------------------------------------------------------------------------------------------------


class _Files:
    """The kernels of one function on disk, by Numba's key (types, processor, code): a checksum and a pickle each."""

    def __init__(self, folder: Path, name: str, stamp: Any) -> None:
        self._folder, self._name, self._stamp = folder, name, stamp

    def load(self, key: Any) -> Any:
        """What was saved under a key; None if nothing was, or if it cannot be trusted."""
        content = _read_own(self._path(key))
        if content is None:
            return None
        checksum, data = content[:CHECKSUM_BYTES], content[CHECKSUM_BYTES:]
        if hashlib.sha256(data).digest() != checksum:
            _warn(f"damaged kernels in {self._folder} are compiled anew")
            return None
        saved_key, kernel = pickle.loads(data)  # noqa: S301 - the user's own file in a folder of the user's own
        return kernel if saved_key == key else None

    def save(self, key: Any, kernel: Any) -> None:
        """Keep a kernel, in one stroke; a full or read-only disk costs the next process time, and this one nothing."""
        data = dumps((key, kernel))
        try:
            _replace(self._path(key), hashlib.sha256(data).digest() + data)
        except OSError as error:
            _warn(f"kernels are not cached: {self._folder}: {error.strerror}")

    def _path(self, key: Any) -> Path:
        digest = hashlib.sha256(repr((key, self._stamp)).encode()).hexdigest()
        return self._folder / f"{self._name}.{digest[:16]}.nbc"


def _read_own(path: Path) -> bytes | None:
    """Content of a file of the user's own; None if there is none."""
    try:
        with path.open("rb") as file:
            return file.read() if os.fstat(file.fileno()).st_uid == _user() else None
    except OSError:
        return None


def _replace(path: Path, content: bytes) -> None:
    """Write a file that nobody ever sees half written."""
    path.parent.mkdir(exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file, contextlib.ExitStack() as undo:
        undo.callback(os.unlink, file.name)
        file.write(content)
        file.close()
        Path(file.name).replace(path)
        undo.pop_all()


# --- Numba's side ---------------------------------------------------------------------------------------------


class _Locator(caching.UserProvidedCacheLocator):
    """Finds our folder, and leaves Numba's setting of the whole process alone."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._cache_path = str(cache_folder() / self.get_suitable_cache_subpath(py_file))

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> _Locator:
        """A locator for any function."""
        return cls(py_func, py_file)

    def ensure_cache_path(self) -> None:
        """Nothing yet: what cannot be made or written is found out, and survived, when a kernel is saved."""


class _Results(caching.CompileResultCacheImpl):
    _locator_classes: ClassVar = [_Locator]


class _KernelCache(caching.FunctionCache):
    """Numba's cache of a function, with files of our own."""

    _impl_class = _Results

    def __init__(self, py_func: Any) -> None:
        super().__init__(py_func)
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _Files(Path(self._cache_path), self._impl.filename_base, stamp)


FOLDER = _usable_folder()
"""Where kernels are kept; None where they cannot be."""


def kernel(function: Any) -> Any:
    """Compile a function when it is first called with arguments of some types, and keep it on disk.

    No fast-math: see lanes.py. nogil: blocks of lanes run on threads of their own. _nrt=False: kernels allocate
    nothing, so Numba need not count references to their arrays (counted in the inner loops, they cost half the time).
    """
    compiled = _njit(nogil=True, _nrt=False)(function)
    if FOLDER and hasattr(compiled, "_cache"):  # without Numba it is the function itself
        compiled._cache = _KernelCache(function)
    return compiled


# For the small pieces of a step: their code is put in the caller's place before LLVM sees it.
inlined = _njit(nogil=True, inline="always", _nrt=False)
