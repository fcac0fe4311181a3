"""HDF5 and MATLAB v7.3 through h5py, an optional extra. A column is the path of a dataset, `/` between its parts.

MATLAB v7.3 keeps its matrices transposed; they are given back as MATLAB shows them, with `.` between structure and
field. A dataset's attribute `unit` or `units` is its unit. Does not belong here: MATLAB v5 (`ingest.matlab_reader`).
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

from ingest.apart import Apart
from ingest.arrays import ArrayFile
from ingest.columns import CELL_LIMIT
from ingest.mapping import FileMapping
from schemas.errors import MissingExtraError, RefusedError


def read_hdf5(path: Path, mapping: FileMapping, *, matlab: bool = False) -> ArrayFile:
    """The datasets of a file. Raises `MissingExtraError` without h5py, `RefusedError` for a damaged file."""
    try:
        import h5py  # noqa: F401 - in this process, so that no child has to
    except ImportError:
        raise MissingExtraError(
            "HDF5 files (MATLAB v7.3 too) need the package h5py, which is not installed",
            where=path.name,
            remedy="Install it: pip install dealab[hdf5]",
        ) from None
    parsed = Apart(path)
    found = parsed(_datasets, path)
    separator = "." if matlab else "/"
    return ArrayFile(
        where=path.name,
        arrays={
            name.replace("/", separator): functools.partial(parsed, _dataset, path, name, matlab) for name in found
        },
        separator=separator,
        root=mapping.options.get("root", ""),
        transpose=mapping.options.get("transpose", False),
        units={name.replace("/", separator): unit for name, unit in found.items() if unit is not None},
    )


def _datasets(path: Path) -> dict[str, str | None]:
    """Names of all datasets and their units."""
    import h5py

    found: dict[str, str | None] = {}

    def visit(name: str | bytes, item: Any) -> None:
        # a name that is no UTF-8 comes as bytes; no mapping can name it
        if isinstance(item, h5py.Dataset) and isinstance(name, str) and not name.startswith("#"):
            unit = item.attrs.get("unit", item.attrs.get("units"))
            text = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
            found[name] = str(text) if isinstance(text, str) else None

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise _unreadable(path, error) from None
    return found


def _dataset(path: Path, name: str, matlab: bool) -> Any:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            dataset = file[name]
            if dataset.size is None or dataset.size > CELL_LIMIT:
                raise RefusedError(
                    f"dataset {name} has {dataset.size} values", where=path.name, expected=f"at most {CELL_LIMIT}"
                )
            if dataset.dtype.kind == "O":
                return np.asarray(dataset.asstr()[()]) if h5py.check_string_dtype(dataset.dtype) else dataset[()]
            return dataset[()].T if matlab else dataset[()]
    except (OSError, RuntimeError, KeyError, ValueError, MemoryError) as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> RefusedError:
    return RefusedError(
        f"the file cannot be read as HDF5: {str(error)[:200]}",
        where=path.name,
        expected="a whole HDF5 file",
        remedy="Copy the file again; close it in the program that writes it",
    )
