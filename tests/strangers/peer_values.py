"""What other readers make of a file: arrays by the paths that ours have, or cells of sheets. Nothing of ours is used here."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class PeerValues:
    """Arrays by path or number, and the cells of sheets by row and column."""

    arrays: dict[str | int, Any] = field(default_factory=dict)
    sheets: dict[str, dict[tuple[int, int], Any]] = field(default_factory=dict)


def values_by_peer(path: Path, kind: str) -> PeerValues:
    """All that the peer of a format reads in a file; raises whatever the peer raises."""
    return {"matlab": _matlab, "hdf5": _hdf5, "tdms": _tdms, "uff": _uff, "excel": _sheets}[kind](path)


def _matlab(path: Path) -> PeerValues:
    from scipy.io import loadmat

    with path.open("rb") as file:
        start = file.read(520)
    if b"\x89HDF\r\n\x1a\n" in start:
        import mat73

        return PeerValues(dict(_parts_73("", mat73.loadmat(str(path)))))
    content = loadmat(path, struct_as_record=False, squeeze_me=False)
    found: dict[str | int, Any] = {}
    for name, value in content.items():
        if name not in ("__header__", "__version__", "__globals__"):
            found.update(_matlab_leaves(name, value))
    return PeerValues(found)


def _matlab_leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numbers and texts below a variable; elements of structure arrays and cells are counted in MATLAB's order."""
    if type(value) is not np.ndarray or not value.size:
        return  # sparse matrices, objects, functions
    kept = value.reshape(-1, order="F").tolist() if value.dtype.kind == "O" else []
    if kept and hasattr(kept[0], "_fieldnames"):
        for i, element in enumerate(kept):
            place = name if len(kept) == 1 else f"{name}.{i}"
            for key in element._fieldnames:
                yield from _matlab_leaves(f"{place}.{key}", getattr(element, key))
    elif kept:
        single = [_single(element) for element in kept]
        if max(value.shape) == value.size and all(found is not _MANY for found in single):
            yield name, np.array([*single, _MANY], dtype=object)[:-1]
        for i, element in enumerate(kept):
            if isinstance(element, np.ndarray) and (element.size > 1 or element.dtype.kind == "O"):
                yield from _matlab_leaves(name if len(kept) == 1 else f"{name}.{i}", element)
    elif value.dtype.names is None:
        yield name, value.squeeze() if value.ndim > 2 else value


def _parts_73(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numbers and texts in the dictionaries and lists that mat73 makes of structures and cells.

    Elements of cells are counted in MATLAB's order, and a lone one has the name of its cell.
    """
    if isinstance(value, dict):
        for key, below in value.items():
            yield from _parts_73(f"{name}.{key}" if name else key, below)
    elif isinstance(value, list):
        rows = value if value and all(isinstance(v, list) and len(v) == len(value[0]) for v in value) else None
        flat = value if rows is None else [row[j] for j in range(len(rows[0])) for row in rows]
        for i, below in enumerate(flat):
            yield from _parts_73(name if len(flat) == 1 else f"{name}.{i}", below)
    elif value is not None and not (isinstance(value, list | str) and not value):
        yield name, np.atleast_1d(np.asarray(value, dtype=object if isinstance(value, str) else None))


_MANY = object()
"""Stands for more than a number or a text."""


def _single(element: Any) -> Any:
    """The number or text of a cell's element, None where it is empty, `_MANY` where it holds more."""
    if type(element) is not np.ndarray or element.dtype.kind not in "biufcU" or element.size > 1:
        return _MANY
    return element.item() if element.size else None


def _hdf5(path: Path) -> PeerValues:
    import h5py

    found: dict[str | int, Any] = {}

    def fields(name: str, values: Any) -> Iterator[tuple[str, Any]]:
        if values.dtype.names is None:
            yield name, values
        for field_name in values.dtype.names or ():
            yield from fields(f"{name}/{field_name}", values[field_name])

    def take(name: str, item: Any) -> None:
        kind = item.dtype.base.kind
        if h5py.check_string_dtype(item.dtype) and item.shape is not None:
            found[name] = np.asarray(item.asstr(errors="replace")[()], dtype=object)
        elif item.shape is not None and (kind in "biufcS" or item.dtype.names):
            found.update(fields(name, item[()]))

    def walk(group: Any, path: str, above: tuple[Any, ...]) -> None:
        for key, item in group.items():
            name = f"{path}{key}"
            if isinstance(item, h5py.Group) and item.id not in above and item.file == group.file:
                walk(item, f"{name}/", (*above, group.id))
            elif isinstance(item, h5py.Dataset) and item.file == group.file:
                with contextlib.suppress(TypeError, ValueError, OSError):  # types and filters that h5py has not
                    take(name, item)

    with h5py.File(path, "r") as file:
        for key in file:
            if isinstance(file.get(key, getlink=True), h5py.HardLink | h5py.SoftLink) and key in file:
                item = file[key]
                if isinstance(item, h5py.Group):
                    walk(item, f"{key}/", (file.id,))
                else:
                    with contextlib.suppress(TypeError, ValueError, OSError):
                        take(key, item)
    return PeerValues(found)


def _tdms(path: Path) -> PeerValues:
    import nptdms

    with path.open("rb") as content, nptdms.TdmsFile.open(content) as file:
        channels = [channel for group in file.groups() for channel in group.channels()]
        return PeerValues({f"{c.group_name}/{c.name}": c.read_data() for c in channels})


def _uff(path: Path) -> PeerValues:
    import pyuff

    file = pyuff.UFF(str(path))
    sets = [file.read_sets(i) for i, kind in enumerate(file.get_set_types()) if int(kind) == 58]
    names = [str(s["id1"]).strip() for s in sets]
    unique = "" not in names and len(set(names)) == len(names)
    return PeerValues({(names[i] if unique else i): s["data"] for i, s in enumerate(sets)})


def _unescaped(cell: Any) -> Any:
    """A text as it is shown: openpyxl leaves characters that XML cannot hold escaped, `_x001B_`."""
    return re.sub("_x([0-9A-Fa-f]{4})_", lambda found: chr(int(found[1], 16)), cell) if isinstance(cell, str) else cell


def _sheets(path: Path) -> PeerValues:
    import pandas

    engine = {".xlsx": "openpyxl", ".xlsm": "openpyxl", ".xls": "xlrd", ".xlsb": "pyxlsb", ".ods": "odf"}
    kind = engine[path.suffix.lower()]
    # As objects: pandas would turn texts that look like numbers into numbers.
    frames = pandas.read_excel(
        path, sheet_name=None, header=None, engine=kind, keep_default_na=False, na_values=[], dtype=object
    )
    return PeerValues(
        sheets={
            str(name): {
                (r, c): _unescaped(v) if kind == "openpyxl" else v
                for r, row in enumerate(f.itertuples(index=False))
                for c, v in enumerate(row)
            }
            for name, f in frames.items()
        }
    )
