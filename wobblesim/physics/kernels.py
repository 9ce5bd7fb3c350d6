"""How kernels are compiled: one decorator, and a cache folder that can hold no stale kernel.

Numba's own cache notices a change of the file that holds a function, but not of the files it calls into. Here the
cache folder carries a hash of every source file of this package and of the compiler's versions, so an edited
kernel never meets an old one's machine code.
"""

from __future__ import annotations

import functools
import hashlib
import os
import sys
import warnings
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np

_config: Any = numba.config
_njit: Any = numba.njit


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


def cache_folder() -> Path:
    """Where compiled kernels are kept: below NUMBA_CACHE_DIR if it is set, else in the user's cache folder."""
    if base := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(base) / f"wobblesim-{kernel_hash()}"
    if sys.platform == "win32":
        root = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        root = Path.home() / "Library" / "Caches"
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return root / "wobblesim" / kernel_hash()


def is_warm() -> bool:
    """Whether some kernels have been compiled on this machine before."""
    return any(cache_folder().glob("**/*.nbi"))


def _use_cache_folder() -> bool:
    """Point Numba at the folder; without a writable one, kernels are compiled anew in every process."""
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError as error:
        warnings.warn(f"kernels are not cached: {folder}: {error.strerror}", RuntimeWarning, stacklevel=2)
        return False
    _config.CACHE_DIR = str(folder)
    return os.access(folder, os.W_OK)


# No fast-math: see lanes.py. nogil: blocks of lanes run on threads of their own. _nrt=False: kernels allocate
# nothing, so Numba need not count references to their arrays (counted in the inner loops, they cost half the time).
kernel = _njit(nogil=True, cache=_use_cache_folder(), _nrt=False)

# For the small pieces of a step: their code is put in the caller's place before LLVM sees it.
inlined = _njit(nogil=True, inline="always", _nrt=False)
