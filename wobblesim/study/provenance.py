"""Where a result comes from: the versions and the machine that made it."""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import platform
import sys
from functools import cache
from pathlib import Path


@cache
def provenance() -> dict[str, str]:
    """Versions of what computes, the machine, and the hash of the kernels' source."""
    return {
        "version": version_of("wobblesim"),
        "python": platform.python_version(),
        **{package: version_of(package) for package in ("numba", "llvmlite", "numpy")},
        "platform": f"{sys.platform} {platform.machine()}",
        "cpu": cpu(),
        "kernel": kernel_hash(),
    }


def version_of(package: str) -> str:
    """Version of a Python package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        # A checkout that was never installed knows its version only from the package itself.
        return str(getattr(importlib.import_module(package), "__version__", "unknown"))


def cpu() -> str:
    """Name of the processor, as its maker sells it where the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


@cache
def kernel_hash() -> str:
    """Hash of all that decides a result besides the settings: kernels, compiler, robot and learning.

    It is taken of the sources as they are, so that editing a comment changes it too: refusing too much is safe, mixing
    the results of two simulators is not.
    """
    from wobblesim.physics import kernels

    digest = hashlib.sha256(kernels.kernel_hash().encode())
    package = Path(__file__).parent.parent
    for part in ("robot", "learning"):
        for source in sorted((package / part).glob("*.py")):
            digest.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
