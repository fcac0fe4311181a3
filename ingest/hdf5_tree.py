"""What an HDF5 file holds: its arrays by path, the fields of tables, MATLAB's structures, cells and objects.

Everything here runs in the child process of `ingest.hdf5_reader` and needs h5py. MATLAB v7.3 keeps structure arrays and
cells as references to a hidden group; their elements are listed as `name.0`, `name.1`, …
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import h5py
import numpy as np

from ingest.hdf5_cut import read_left, without_lost
from ingest.packing import Packing, packing_of
from ingest.since import with_calendar

_DEPTH = 16
"""Deepest nesting of groups and structures that is looked into."""
_MOST = 20_000
"""Arrays of a file that are listed."""
_PLAIN_CLASSES = ("", "double", "single", "logical", "char", "int8", "int16", "int32", "int64")
_OBJECTS = ("function_handle", "table", "timetable", "datetime", "duration", "string", "categorical")
_UNITS = ("unit", "units", "unit_string", "engineering_units")
_LINKS = 16
"""Soft links in a row that HDF5 follows."""
_CODES = 8
"""Codes of an enumeration that are told."""
_IN_OTHER_FILES = "an array whose values stand in other files"


@dataclass(frozen=True)
class Listed:
    """One entry of the list: where the object stands, the fields that lead into its rows, and what `Held` has."""

    address: str
    fields: tuple[str, ...] = ()
    shape: tuple[int, ...] = ()
    unit: str | None = None
    packing: Packing | None = None
    refusal: str = ""
    remedy: str = ""
    is_text: bool = False


def list_arrays(file: Any) -> dict[str, Listed]:
    """All arrays of an open file by path, `/` between its parts; what is no array says what it is."""
    found: dict[str, Listed] = {}
    for name, listed in _below(file, file, "", frozenset(), 0):
        if len(found) >= _MOST:
            break
        found.setdefault(name, listed)
    return found


def read_array(file: Any, listed: Listed, *, matlab: bool, there: int | None = None) -> Any:
    """The values of an entry, matrices as MATLAB shows them where `matlab`; of a cut file `there` is how many bytes are left.

    Raises `ValueError` where texts are lost; lost numbers are NaN.
    """
    dataset = file[listed.address]
    if h5py.check_string_dtype(dataset.dtype) and not listed.fields:
        if there is not None and read_left(dataset, there)[1].any():
            raise ValueError("part of it is lost, and it holds no numbers")
        return np.asarray(dataset.asstr(errors="replace")[()])
    lost = None
    if there is None:
        values = dataset[listed.fields[0]] if listed.fields else dataset[()]
    else:
        values, lost = read_left(dataset, there)
        values = values[listed.fields[0]] if listed.fields else values
    for name in listed.fields[1:]:
        values = values[name]
    if values.dtype.names is not None:
        real, imaginary = values.dtype.names
        values = values[real] + 1j * values[imaginary]
    if _text(dataset.attrs.get("MATLAB_class")) == "logical" and values.dtype.kind == "u":
        values = values.astype(bool)
    values = values if lost is None else without_lost(values, lost)
    if matlab and not listed.fields:
        values = values.T
    return np.array(["".join(map(chr, row)) for row in np.atleast_2d(values)]) if listed.is_text else values


def _below(file: Any, group: Any, path: str, above: frozenset[Any], depth: int) -> Iterator[tuple[str, Listed]]:
    """The arrays below a group. A group that contains itself through a link is entered once."""
    identity = h5py.h5o.get_info(group.id).addr
    if depth > _DEPTH or identity in above:
        return
    for key in group:
        if not isinstance(key, str) or (not path and key.startswith("#")):
            continue  # MATLAB's hidden groups; a name that is no UTF-8 comes as bytes, and no mapping can name it
        name = f"{path}/{key}" if path else key
        link = group.get(key, getlink=True)
        if isinstance(link, h5py.ExternalLink) or (
            isinstance(link, h5py.SoftLink) and _leads_out(file, _address(group.name, link.path))
        ):
            yield name, Listed("", refusal="a link to another file", remedy="Copy its content into this file")
            continue
        try:
            item = group[key]
        except (KeyError, OSError, RuntimeError):
            yield name, Listed("", refusal="a link that leads nowhere")
            continue
        yield from _item(file, item, name, above | {identity}, depth + 1)


def _leads_out(file: Any, address: str, links: int = 0) -> bool:
    """Whether a path in the file leads through a link to another file, which is asked without following it.

    A soft link may lead to an external one, or through one; a chain of soft links is followed as far as HDF5 does.
    """
    if links > _LINKS:
        return False  # HDF5 gives up there, and says so
    here = "/"
    parts = [part for part in address.split("/") if part not in ("", ".")]
    for place, part in enumerate(parts):
        if here not in file:
            return False
        link = file[here].get(part, getlink=True) if isinstance(file[here], h5py.Group) else None
        if isinstance(link, h5py.ExternalLink):
            return True
        if isinstance(link, h5py.SoftLink):
            return _leads_out(file, "/".join([_address(here, link.path), *parts[place + 1 :]]), links + 1)
        here = f"{here.rstrip('/')}/{part}"
    return False


def _address(group: str, path: str) -> str:
    """Where a soft link in a group leads."""
    return path if path.startswith("/") else f"{group}/{path}"


def _item(file: Any, item: Any, name: str, above: frozenset[Any], depth: int) -> Iterator[tuple[str, Listed]]:
    attributes = _attributes(item)
    matlab_class = _text(attributes.get("MATLAB_class")) or ""
    if item.name is None:
        yield name, Listed("", refusal="something that stands nowhere in the file", remedy="Save it under a name")
    elif "MATLAB_sparse" in attributes:
        yield name, Listed(item.name, refusal="a sparse matrix", remedy="Save it as full(…)")
    elif matlab_class in _OBJECTS or ("MATLAB_object_decode" in attributes and matlab_class not in _PLAIN_CLASSES):
        yield name, object_of(item.name, matlab_class)
    elif isinstance(item, h5py.Group):
        yield from _below(file, item, name, above, depth)
    elif isinstance(item, h5py.Dataset):
        yield from _dataset(file, item, name, attributes, above, depth)


def _attributes(item: Any) -> dict[str, Any]:
    """What a group or an array says of itself, each read once: that takes most of the time of a file of many small arrays."""
    return {str(key): value for key, value in item.attrs.items()}


def object_of(address: str, matlab_class: str) -> Listed:
    """The entry for an object of MATLAB: the file holds a handle in its place, or a form that only MATLAB reads."""
    return Listed(
        address,
        refusal=f"a MATLAB object of class {matlab_class}",
        remedy="Save it as plain numbers: seconds(…) of durations, double(…), table2struct(…, 'ToScalar', true)",
    )


def _dataset(
    file: Any, dataset: Any, name: str, attributes: Mapping[str, Any], above: frozenset[Any], depth: int
) -> Iterator[tuple[str, Listed]]:
    matlab_class = _text(attributes.get("MATLAB_class"))
    try:
        dtype, shape = dataset.dtype.base, (*(dataset.shape or ()), *dataset.dtype.shape)
    except (TypeError, ValueError) as error:  # types of HDF5 that numpy has not: times, odd floats
        yield name, Listed(dataset.name, refusal=f"an array of a type that is not read ({str(error)[:80]})")
        return
    plain = Listed(dataset.name, (), shape[::-1] if matlab_class else shape, unit_of(attributes))
    if dataset.is_virtual or dataset.external:
        yield name, replace(plain, refusal=_IN_OTHER_FILES, remedy="Copy them into one file")
    elif h5py.check_ref_dtype(dtype) is not None:
        is_cell = matlab_class == "cell"
        yield (
            name,
            replace(plain, refusal=_elements(name, shape, "a cell array" if is_cell else "an array of references")),
        )
        if h5py.check_ref_dtype(dtype) is h5py.Reference and math.prod(shape) <= _MOST and depth <= _DEPTH:
            yield from _referenced(file, dataset, name, is_cell, above, depth)
    elif lacking := _lacking_filter(dataset):
        remedy = "Save it with gzip"
        yield name, replace(plain, refusal=f"compressed with {lacking}, which is not installed", remedy=remedy)
    elif "MATLAB_empty" in attributes or dataset.shape is None:
        yield name, replace(plain, refusal="empty")
    elif dtype.names is not None and not _is_complex(dtype):
        fields = ", ".join(dtype.names[:20])
        yield (
            name,
            replace(plain, refusal=f"a table with the fields {fields}", remedy=f"Name one: {name}/{dtype.names[0]}"),
        )
        yield from _fields(attributes, dtype, plain, name)
    else:
        yield name, _typed(plain, dtype, attributes, is_text=matlab_class == "char")


def _lacking_filter(dataset: Any) -> str:
    """The first compression of a dataset that this installation cannot undo; empty where it can."""
    filters = dataset.id.get_create_plist()
    for i in range(filters.get_nfilters()):
        number, _, _, name = filters.get_filter(i)
        if not h5py.h5z.filter_avail(number):
            return f"{name.decode('utf-8', 'replace')[:40] or 'a filter'} (filter {number})"
    return ""


def _referenced(
    file: Any, dataset: Any, name: str, is_cell: bool, above: frozenset[Any], depth: int
) -> Iterator[tuple[str, Listed]]:
    """The elements of a cell or structure array, in MATLAB's order. `data/0` of field data is listed as `0/data`."""
    parent, _, last = name.rpartition("/")
    for i, reference in enumerate(np.asarray(dataset[()]).reshape(-1)):
        if not reference:
            continue
        place = f"{name}/{i}" if is_cell or not parent else f"{parent}/{i}/{last}"
        target = file[reference]
        if isinstance(target, h5py.Group | h5py.Dataset):
            yield from _item(file, target, place, above, depth + 1)


def _fields(attributes: Mapping[str, Any], dtype: Any, plain: Listed, name: str) -> Iterator[tuple[str, Listed]]:
    """The fields of a table, and of structures within its rows."""
    listed_units = _texts(next((value for key, value in attributes.items() if key.lower() in _UNITS), None))
    for place, field in enumerate(dtype.names):
        inner, inside = dtype[field], dtype[field].base
        own = {
            key[len(field) + 1 :]: value
            for key, value in attributes.items()
            if key.startswith((f"{field}_", f"{field}."))
        }
        unit = unit_of(own) or (listed_units[place] if len(listed_units) == len(dtype.names) else None)
        entry = replace(plain, fields=(*plain.fields, field), shape=(*plain.shape, *inner.shape), unit=unit)
        below = f"{name}/{field}"
        if inside.names is not None and not _is_complex(inside) and len(entry.fields) < _DEPTH:
            yield from _fields(attributes, inside, entry, below)
        else:
            yield below, _typed(entry, inside, own)


def _typed(entry: Listed, dtype: Any, attributes: Mapping[str, Any], *, is_text: bool = False) -> Listed:
    """The entry of an array by what its elements are."""
    if is_text:
        return replace(entry, is_text=True)
    if _is_complex(dtype) or h5py.check_string_dtype(dtype) is not None or dtype.kind in "c":
        return entry
    if h5py.check_vlen_dtype(dtype) is not None:
        return replace(entry, refusal="an array of lists of different lengths", remedy="Save each list as an array")
    if dtype.kind not in "biufSU":
        return replace(entry, refusal=f"an array of {dtype}")
    signed_bits = 8 * dtype.itemsize if dtype.kind == "i" else 0
    packing = packing_of(attributes, whole_numbers=dtype.kind in "iu", signed_bits=signed_bits)
    codes = {} if dtype.kind == "b" else h5py.check_enum_dtype(dtype)
    if codes:
        in_order = sorted(codes.items(), key=lambda code: code[1])
        listed = ", ".join(f"{number} = {name}" for name, number in in_order[:_CODES])
        packing = replace(packing or Packing(), codes=listed)
    return replace(entry, packing=packing)


def _is_complex(dtype: Any) -> bool:
    """Whether a structure is a complex number, as MATLAB (`real`, `imag`) and others (`r`, `i`) store it."""
    names = tuple(name.casefold() for name in dtype.names or ())
    return names in (("real", "imag"), ("r", "i"), ("re", "im"), ("real", "imaginary"))


def _elements(name: str, shape: tuple[int, ...], what: str) -> str:
    size = " × ".join(map(str, reversed(shape)))
    return f"{what}, {size}: its elements are {name.replace('/', '.')}.0 to {max(math.prod(shape) - 1, 0)}"


def unit_of(attributes: Mapping[str, Any]) -> str | None:
    """The unit that attributes give, whatever the case of their names; of times since a date with the calendar behind it."""
    lower = {str(key).casefold(): key for key in attributes}
    calendar = _text(attributes[lower["calendar"]]) if "calendar" in lower else None
    for name in _UNITS:
        if name in lower and (text := _text(attributes[lower[name]])):
            return with_calendar(text, calendar)
    return None


def _text(value: Any) -> str | None:
    found = _texts(value)
    return found[0] if len(found) == 1 else None


def _texts(value: Any) -> tuple[str, ...]:
    """Texts of an attribute: one or several, as text or bytes in UTF-8 or, by older programs, in Latin letters."""
    if isinstance(value, h5py.Empty) or value is None:
        return ()
    cells = np.asarray(value).reshape(-1).tolist()
    if not all(isinstance(cell, str | bytes) for cell in cells):
        return ()
    return tuple(_decoded(cell) for cell in cells)


def _decoded(cell: str | bytes) -> str:
    raw = cell.encode("utf-8", "surrogateescape") if isinstance(cell, str) else cell
    try:
        return raw.decode("utf-8").strip("\x00 ")
    except UnicodeDecodeError:
        return raw.decode("cp1252", "replace").strip("\x00 ")
