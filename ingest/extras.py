"""What to do where a package is missing that only some labs need: an extra of `pyproject.toml`."""

from __future__ import annotations

EXTRAS = {
    "cluster": ("distributed",),
    "hdf5": ("h5py",),
    "mdf": ("asammdf",),
    "remote": ("fsspec", "s3fs"),
    "tdms": ("nptdms",),
    "uff": ("pyuff",),
}
"""Packages of each extra, as `pip` knows them: dealab itself is on no index, so that its extras cannot be named there."""


def advise_install(extra: str) -> str:
    """The command that installs what an extra needs, as a sentence."""
    return f"Install it where dealab is installed: `pip install {' '.join(EXTRAS[extra])}`"
