"""MATLAB files: v4 to v7 through scipy, v7.3 through `ingest.hdf5_reader`. A column is `structure.field` or a variable.

Matrices are as MATLAB shows them: samples down the rows unless the mapping says `transpose`, `index` the column from 0.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from ingest.apart import apart
from ingest.arrays import ArrayFile
from ingest.hdf5_reader import read_hdf5
from ingest.mapping import FileMapping
from schemas.errors import RefusedError

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_DEPTH = 8
"""Deepest nesting of structures that is looked into."""


def read_matlab(path: Path, mapping: FileMapping) -> ArrayFile:
    """The arrays of a MATLAB file. Raises `RefusedError` for a damaged file, `MissingExtraError` for v7.3 without h5py."""
    with path.open("rb") as file:
        start = file.read(520)
    if start[512:520] == _HDF5_SIGNATURE or start.startswith(_HDF5_SIGNATURE):
        return read_hdf5(path, mapping, matlab=True)
    try:
        arrays = apart(path, _arrays, path)
    except RefusedError:
        raise
    except Exception as error:  # scipy raises a dozen kinds for damaged files, zlib's and struct's among them
        raise RefusedError(
            f"the file cannot be read as MATLAB: {str(error)[:200] or type(error).__name__}",
            where=path.name,
            expected="a whole MATLAB file",
            remedy="Copy the file again, or save it anew",
        ) from None
    return ArrayFile(
        where=path.name,
        arrays={name: functools.partial(np.asarray, value) for name, value in arrays.items()},
        separator=".",
        root=mapping.options.get("root", ""),
        transpose=mapping.options.get("transpose", False),
    )


def _arrays(path: Path) -> dict[str, Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        content = loadmat(path, simplify_cells=True)
    arrays: dict[str, Any] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            arrays.update(_leaves(name, value, 0))
    return arrays


def _leaves(name: str, value: Any, depth: int) -> Iterator[tuple[str, Any]]:
    """Arrays below a variable, by path; cells and lists of structures are not looked into."""
    if isinstance(value, dict):
        if depth < _DEPTH:
            for key, below in value.items():
                yield from _leaves(f"{name}.{key}", below, depth + 1)
    elif isinstance(value, np.ndarray | int | float | str):
        yield name, np.atleast_1d(np.asarray(value))
