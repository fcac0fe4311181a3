"""The version of this software, as every result carries it."""

from __future__ import annotations

import functools

_PACKAGES = ("schemas", "ingest", "pipeline", "reports")
_COMPUTING = ("numpy", "scipy", "pyarrow", "scikit-fem")
"""Distributions that results may differ with."""


@functools.cache
def software_version() -> str:
    """The installed version; read once, since that means parsing a file."""
    from importlib import metadata

    return metadata.version("dealab")


def describe_software() -> dict[str, str]:
    """What results depend on, by name: our version with a hash of our code, Python, and the libraries that compute.

    Raises
    ------
    importlib.metadata.PackageNotFoundError
        One of them is not installed.
    """
    import hashlib
    import sys
    from importlib import metadata
    from pathlib import Path

    root = Path(__file__).resolve().parents[1]
    hasher = hashlib.sha256()
    for path in sorted(file for package in _PACKAGES for file in (root / package).rglob("*.py")):
        hasher.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    libraries = {name: metadata.version(name) for name in _COMPUTING}
    python = ".".join(map(str, sys.version_info[:2]))
    return {"dealab": f"{software_version()} ({hasher.hexdigest()[:12]})", "Python": python, **libraries}
