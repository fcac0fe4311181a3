"""HDF5 and MATLAB v7.3 through h5py, an optional extra. A column is the path of a dataset, `/` between its parts.

A field of a table (a compound dataset) is `dataset/field`. MATLAB v7.3 keeps its matrices transposed; they are given back
as MATLAB shows them, with `.` between structure and field. What the file holds is listed in `ingest.hdf5_tree`; how
packed numbers are read is in `ingest.packing`. Does not belong here: MATLAB v5 (`ingest.matlab_reader`).
"""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ingest.apart import Apart
from ingest.arrays import ArrayFile, Held
from ingest.columns import CELL_LIMIT
from ingest.extras import advise_install
from ingest.hdf5_cut import find_declared_size
from ingest.mapping import FileMapping
from schemas.errors import MissingExtraError, RefusedError

if TYPE_CHECKING:
    from ingest.hdf5_tree import Listed

_DAMAGED = (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError, OverflowError)
"""What h5py raises for damaged files."""


def read_hdf5(path: Path, mapping: FileMapping, *, matlab: bool = False) -> ArrayFile:
    """The datasets of a file. Raises `MissingExtraError` without h5py, `RefusedError` for a damaged file."""
    try:
        import h5py  # noqa: F401 - in this process, so that no child has to
    except ImportError:
        raise MissingExtraError(
            "HDF5 files (MATLAB v7.3 too) need the package h5py, which is not installed",
            where=path.name,
            remedy=advise_install("hdf5"),
        ) from None
    declared, there = find_declared_size(path), path.stat().st_size
    parsed = Apart(path)
    found = parsed(_listed, path)
    separator = "." if matlab else "/"
    return ArrayFile(
        where=path.name,
        held={
            name.replace("/", separator): Held(
                functools.partial(parsed, _read, path, name, listed, matlab),
                listed.shape,
                listed.unit,
                listed.packing,
                listed.refusal,
                listed.remedy,
            )
            for name, listed in found.items()
        },
        separator=separator,
        root=mapping.options.get("root", ""),
        transpose=mapping.options.get("transpose", False),
        problems=() if declared is None else (f"the file is cut: {there} of {declared} bytes are there",),
    )


def _listed(path: Path) -> dict[str, Listed]:
    from ingest.hdf5_cut import open_left
    from ingest.hdf5_tree import list_arrays

    try:
        with open_left(path) as (file, _):
            return list_arrays(file)
    except _DAMAGED as error:
        raise _unreadable(path, error) from None


def _read(path: Path, name: str, listed: Listed, matlab: bool) -> Any:
    from ingest.hdf5_cut import open_left
    from ingest.hdf5_tree import read_array

    if math.prod(listed.shape) > CELL_LIMIT:
        raise RefusedError(
            f"dataset {name} has {math.prod(listed.shape)} values", where=path.name, expected=f"at most {CELL_LIMIT}"
        )
    try:
        with open_left(path) as (file, there):
            return read_array(file, listed, matlab=matlab, there=there)
    except _DAMAGED as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> RefusedError:
    return RefusedError(
        f"the file cannot be read as HDF5: {str(error)[:200]}",
        where=path.name,
        expected="a whole HDF5 file",
        remedy="Copy the file again; close it in the program that writes it",
    )
