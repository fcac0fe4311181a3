"""The version of this software, as every result carries it."""

from __future__ import annotations

import functools

MISSING = "missing"
_PACKAGES = ("schemas", "ingest", "pipeline", "reports")
_COMPUTING = ("numpy", "scipy", "pyarrow", "scikit-fem")
"""Distributions that results may differ with."""
_READING = (
    "asammdf", "charset-normalizer", "h5py", "lz4", "mcap", "nptdms", "pint", "protobuf", "python-calamine", "pyuff", "zstandard"
)  # fmt: skip
"""Distributions that what is read of a file may differ with; some need not be there."""


@functools.cache
def software_version() -> str:
    """The installed version; read once, since that means parsing a file."""
    from importlib import metadata

    return metadata.version("dealab")


def describe_software() -> dict[str, str]:
    """What results depend on, by name: our version with a hash of our code, Python, and the libraries that compute or read.

    Of those that read, `missing` says that one is not installed: files of its format would be refused.

    Raises
    ------
    importlib.metadata.PackageNotFoundError
        One of those that compute is not installed.
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
    for name in _READING:
        try:
            libraries[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            libraries[name] = MISSING
    python = ".".join(map(str, sys.version_info[:2]))
    return {"dealab": f"{software_version()} ({hasher.hexdigest()[:12]})", "Python": python, **libraries}
