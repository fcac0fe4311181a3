"""MATLAB files: v4 to v7 through scipy, v7.3 through `ingest.hdf5_reader`. A column is `structure.field` or a variable.

Matrices are as MATLAB shows them: samples down the rows unless the mapping says `transpose`, `index` the column from 0.
Elements of structure arrays and cells are counted from 0 (`ch.1.data`), or from 1 as MATLAB writes them (`ch(2).data`).
"""

from __future__ import annotations

import functools
import io
import warnings
from collections.abc import Iterator, Mapping, Sequence
from numbers import Number
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque
from scipy.sparse import issparse

from ingest.apart import apart
from ingest.arrays import ArrayFile, Held
from ingest.hdf5_reader import read_hdf5
from ingest.mapping import FileMapping
from ingest.matlab_cut import complete
from schemas.errors import RefusedError

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_DEPTH = 8
"""Deepest nesting of structures that is looked into."""
_MOST = 10_000
"""Elements of a structure array or cell that are looked into."""


def read_matlab(path: Path, mapping: FileMapping) -> ArrayFile:
    """The arrays of a MATLAB file. Raises `RefusedError` for a damaged file, `MissingExtraError` for v7.3 without h5py."""
    with path.open("rb") as file:
        start = file.read(520)
    if start[512:520] == _HDF5_SIGNATURE or start.startswith(_HDF5_SIGNATURE):
        return read_hdf5(path, mapping, matlab=True)
    try:
        found, problems = apart(path, _found, path)
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
        held={name: _held(value) for name, value in found.items()},
        separator=".",
        root=mapping.options.get("root", ""),
        transpose=mapping.options.get("transpose", False),
        problems=problems,
    )


class _Refused(str):
    """What a variable is that is no array."""


_REMEDIES = (("a sparse", "Save it as full(…)"), ("a MATLAB object", "Save it as plain numbers"))


def _held(value: Any) -> Held:
    if isinstance(value, _Refused):
        return Held(
            lambda: None, refusal=str(value), remedy=next((r for start, r in _REMEDIES if value.startswith(start)), "")
        )
    array = np.atleast_1d(np.asarray(value))
    return Held(functools.partial(np.asarray, array), array.shape)


def _found(path: Path) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Arrays, and what is none, by path; and what is lost of a cut file."""
    left = complete(path.read_bytes())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        content = loadmat(io.BytesIO(left.content), squeeze_me=True, struct_as_record=True)
    found = _leaves_of(content)
    found.update(_truths(left.content, [name for name, value in found.items() if _may_be_truths(value)]))
    return found, left.problems


def _leaves_of(content: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in content.items():
        if not name.startswith("__") or not isinstance(value, bytes | str | list):
            found.update(_leaves(name or "None", value, 0))
    return found


def _may_be_truths(value: Any) -> bool:
    """Whether an array can be a logical one: those are stored in bytes of 0 and 1."""
    array = np.asarray(value)
    if array.dtype.kind == "O":
        return any(type(cell) is int and cell in (0, 1) for cell in array.reshape(-1))
    return array.dtype == np.uint8 and bool(array.size) and array.max() <= 1


def _truths(content: bytes, names: Sequence[str]) -> dict[str, Any]:
    """Of arrays that may be logical those that are, as true and false.

    The file's types are read a second time and of their variables alone: all other numbers would take eight bytes each.
    """
    if not names:
        return {}
    wanted = sorted({name.partition(".")[0] for name in names})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        typed = loadmat(
            io.BytesIO(content), squeeze_me=True, struct_as_record=True, mat_dtype=True, variable_names=wanted
        )
    leaves = _leaves_of(typed)
    return {name: leaves[name] for name in names if name in leaves and np.asarray(leaves[name]).dtype.kind in "bO"}


def _leaves(name: str, value: Any, depth: int) -> Iterator[tuple[str, Any]]:
    """What stands at and below a variable, by path."""
    if issparse(value):
        yield name, _Refused(f"a sparse matrix, {_size(value.shape)}")
    elif isinstance(value, MatlabOpaque | MatlabObject | MatlabFunction):
        yield name, _Refused(f"a MATLAB object of class {_class_of(value)}")
    elif isinstance(value, np.ndarray | np.void) and value.dtype.names is not None:
        yield from _structure(name, np.asarray(value), depth)
    elif isinstance(value, np.ndarray) and value.dtype.kind == "O":
        yield from _cell(name, value, depth)
    elif value is None or (isinstance(value, np.ndarray) and not value.size):
        yield name, _Refused("empty")
    elif isinstance(value, np.ndarray | Number | str):
        yield name, value
    else:
        yield name, _Refused(f"a value of type {type(value).__name__}")


def _structure(name: str, value: np.ndarray, depth: int) -> Iterator[tuple[str, Any]]:
    """The fields of a structure, or of each element of a structure array."""
    fields = value.dtype.names or ()
    if value.shape:
        yield (
            name,
            _Refused(
                f"a structure array, {_size(value.shape)}: its elements are {name}.0 to {value.size - 1}, each with "
                + (", ".join(fields[:20]) or "no fields")
            ),
        )
    if depth >= _DEPTH or value.size > _MOST:
        return
    for i, element in enumerate(value.reshape(-1, order="F")):
        place = f"{name}.{i}" if value.shape else name
        for field in fields:
            yield from _leaves(f"{place}.{field}", element[field], depth + 1)


def _cell(name: str, value: np.ndarray, depth: int) -> Iterator[tuple[str, Any]]:
    """The elements of a cell array; one of single numbers and texts is a column as well."""
    elements: Sequence[Any] = value.reshape(-1, order="F").tolist()
    if not value.shape:
        yield from _leaves(name, value.item(), depth + 1)
        return
    if elements and all(isinstance(e, Number | str) or _is_empty(e) for e in elements) and value.ndim == 1:
        column = np.empty(len(elements), dtype=object)
        column[:] = [None if _is_empty(e) else e for e in elements]
        yield name, column
    else:
        yield (
            name,
            _Refused(f"a cell array, {_size(value.shape)}: its elements are {name}.0 to {max(value.size - 1, 0)}"),
        )
    if depth < _DEPTH and value.size <= _MOST:
        for i, element in enumerate(elements):
            if not isinstance(element, Number | str):
                yield from _leaves(f"{name}.{i}", element, depth + 1)


def _is_empty(element: Any) -> bool:
    return isinstance(element, np.ndarray) and element.dtype.names is None and not element.size


def _size(shape: tuple[int, ...]) -> str:
    return " × ".join(map(str, shape)) if len(shape) > 1 else f"1 × {shape[0]}"


def _class_of(value: Any) -> str:
    """The class of an object, where the file says it."""
    if isinstance(value, MatlabFunction):
        return "function_handle"
    named = getattr(value, "classname", None)
    if named is None and value.dtype.names and "s2" in value.dtype.names:
        named = value["s2"].item() if value.shape else value[()]["s2"]
    return (named.decode("utf-8", "replace") if isinstance(named, bytes) else str(named))[:60]
