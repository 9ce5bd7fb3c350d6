"""Where a result comes from: the versions, the checkout and the processor that made it, and nothing of who or where."""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import os
import platform
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parent.parent

VECTOR = ("sse4.2", "avx", "fma", "neon", "sve")
"""How the processor features begin that decide which instructions a kernel is made of."""


@cache
def provenance() -> dict[str, str]:
    """What computes: versions, commit, processor, and the hash of the simulator's source.

    All is the same for every run of a process, and no word names a user, a machine or a folder.
    """
    from wobblesim.physics import kernels

    return {
        "version": version_of("wobblesim"),
        "git": git_state(),
        "kernel": kernel_hash(),
        "python": platform.python_version(),
        **{package: version_of(package) for package in ("numba", "llvmlite", "numpy", "pyarrow")},
        "libc": " ".join(platform.libc_ver()).strip(),
        "platform": f"{sys.platform} {platform.machine()}",
        "cpu": cpu(),
        "target": kernels.processor(),
        "features": " ".join(vector_features()),
    }


def version_of(package: str) -> str:
    """Version of a Python package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        # A checkout that was never installed knows its version only from the package itself.
        return str(getattr(importlib.import_module(package), "__version__", "unknown"))


@cache
def kernel_hash() -> str:
    """Hash of all that decides a result besides the settings: kernels, compiler, robot and learning.

    It is taken of the sources as they are, so that editing a comment changes it too: refusing too much is safe, mixing
    the results of two simulators is not.
    """
    from wobblesim.physics import kernels

    digest = hashlib.sha256(kernels.kernel_hash().encode())
    for part in ("robot", "learning"):
        for source in sorted((PACKAGE / part).glob("*.py")):
            digest.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


# --- the processor -------------------------------------------------------------------------------------------------


def cpu() -> str:
    """Name of the processor, as its maker sells it where the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def vector_features() -> list[str]:
    """Features of the processor that kernels are compiled for, as LLVM calls them: those of `VECTOR`."""
    import numba
    from llvmlite import binding

    told = numba.config.CPU_FEATURES  # type: ignore[attr-defined]
    every = binding.get_host_cpu_features().flatten() if told is None else told
    return sorted(name[1:] for name in every.split(",") if name[:1] == "+" and name[1:].startswith(VECTOR))


# --- the checkout --------------------------------------------------------------------------------------------------

GIT_PATIENCE = 1.0
"""s for an answer of git: a disk that hangs must not hang a sweep."""

NO_NETWORK = {"GIT_ALLOW_PROTOCOL": "none", "GIT_TERMINAL_PROMPT": "0", "GIT_OPTIONAL_LOCKS": "0"}


def git_state(package: Path = PACKAGE) -> str:
    """Commit of the checkout that a package runs from, ``-dirty`` behind it if the package differs from the commit.

    Empty if it is no checkout, or if git is missing, silent or refuses (it does where the checkout is another user's).
    Git is asked for the commit and for its list of files only, and the files are hashed here. So no hook, filter or
    file monitor of anybody's configuration runs, and no lock is taken.
    """
    git = shutil.which("git")
    # Only a checkout of this package: an environment may lie within the checkout of something else.
    if git is None or not (package.parent / ".git").exists():
        return ""
    try:
        commit = _git(git, package.parent, "rev-parse", "--verify", "HEAD^{commit}").strip()
        listed = _git(git, package.parent, "ls-tree", "-r", "-z", commit, "--", f"{package.name}/")
        return commit if _is_as_listed(package.parent, package, listed) else f"{commit}-dirty"
    except (OSError, subprocess.SubprocessError, ValueError):
        return ""


def _git(git: str, folder: Path, *arguments: str) -> str:
    """What a git command says; it sees nothing of a git that has called this process (a hook's GIT_DIR)."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    environment |= NO_NETWORK | {"GIT_CEILING_DIRECTORIES": str(folder.parent)}
    return subprocess.run(  # noqa: S603 - no shell, and no argument comes from outside
        [git, *arguments],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=GIT_PATIENCE,
        check=True,
        text=True,
    ).stdout


def _is_as_listed(root: Path, package: Path, listed: str) -> bool:
    """Whether a package's files are those of a commit: all of the listed ones, and no other source file."""
    blobs = {}
    for entry in filter(None, listed.split("\0")):
        about, _, path = entry.partition("\t")
        _mode, _kind, name = about.split(" ")
        blobs[root / path] = name
    return blobs.keys() >= set(package.rglob("*.py")) and all(_is_blob(path, name) for path, name in blobs.items())


def _is_blob(path: Path, name: str) -> bool:
    """Whether git would give a file's content this name."""
    if not path.is_file():
        return False
    content = path.read_bytes()
    kind = "sha1" if len(name) == 40 else "sha256"
    return hashlib.new(kind, b"blob %d\0" % len(content) + content, usedforsecurity=False).hexdigest() == name


# --- nothing of who or where ---------------------------------------------------------------------------------------


def without_places(text: str) -> str:
    """A text, such as a traceback, without the folders in which this machine keeps the package and Python's own."""
    places = {**dict.fromkeys(_libraries(), "lib/"), _home(): "~/", str(PACKAGE.parent): ""}
    for place in sorted(filter(None, places), key=len, reverse=True):
        text = text.replace(f"{place}{os.sep}", places[place])
    return text


def _libraries() -> set[str]:
    return {path.rstrip(os.sep) for path in (*sys.path, sys.prefix, sys.base_prefix) if path}


def _home() -> str:
    try:
        return str(Path.home())
    except RuntimeError:  # a user without one
        return ""
