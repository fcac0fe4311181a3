"""For the tests of other packages: does a reader keep what `ingest.readers.Reader` promises?

    from ingest.reader_kit import check_reader
    check_reader(READER, path, {"force": [0.1, 0.2, 0.3]}, units={"force": "N"})

Whatever is wrong is an `AssertionError` that says so. Damaged copies of the file are read as well.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ingest.columns import ColumnFile, Numbers, OwnTime
from ingest.mapping import ColumnMapping, FileMapping
from ingest.mapping_keys import RECORDING
from ingest.readers import Reader
from schemas.errors import DealabError, RefusedError

_CUTS = (0, 1, 7, 64, 0.5, 0.9)
"""Bytes, or share, of a file after which it is cut."""


def check_reader(
    reader: Reader,
    path: Path,
    columns: Mapping[str, Sequence[float]],
    *,
    units: Mapping[str, str] | None = None,
    options: Mapping[str, Any] | None = None,
) -> None:
    """Reads a good file and damaged copies of it.

    Parameters
    ----------
    reader : the object that is registered
    path : a good file
    columns : what it holds, NaN where a cell has no number
    units : units that the file itself gives, by column
    options : of the format's own table in a mapping

    Raises
    ------
    AssertionError
        The reader does not keep a promise.
    """
    _demand(all(s.startswith(".") and s == s.lower() for s in reader.suffixes), "suffixes are to be like .ldat")
    _demand(path.suffix.lower() in reader.suffixes, f"{path.suffix} is none of its suffixes")
    unknown = set(options or {}) - set(reader.options)
    _demand(not unknown, f"options {sorted(unknown)} are not declared")
    mapping = FileMapping(
        kind=RECORDING,
        format=None,
        options=dict(options or {}),
        time=None,
        columns={name: ColumnMapping(name) for name in columns},
        recording={},
        rig={},
    )
    before = path.read_bytes()
    for _ in range(2):
        _check_columns(reader.read(path, mapping), columns, units or {})
    _demand(path.read_bytes() == before, "the file was changed")
    _check_damage(reader, path, mapping, before)


def _check_columns(file: ColumnFile, columns: Mapping[str, Sequence[float]], units: Mapping[str, str]) -> None:
    names = file.names()
    _demand(set(columns) <= set(names), f"names() are {names}, not with all of {sorted(columns)}")
    for name, values in columns.items():
        found = file.numbers(name)
        _demand(isinstance(found, Numbers), f"numbers({name!r}) is a {type(found).__name__}")
        expected = np.asarray(values, dtype=np.float64)
        same = found.values.shape == expected.shape and np.allclose(found.values, expected, 1e-12, 0, equal_nan=True)
        _demand(same, f"numbers({name!r}) are {found.values}, not {expected}")
        _demand(found.empty.shape == expected.shape, f"numbers({name!r}).empty has the shape {found.empty.shape}")
        _demand(len(file.cells(name)) == expected.size, f"cells({name!r}) are {len(file.cells(name))}")
        _demand(file.unit(name) == units.get(name), f"unit({name!r}) is {file.unit(name)!r}, not {units.get(name)!r}")
        own, frequency = file.own_time(name), file.own_frequency(name)
        _demand(own is None or isinstance(own, OwnTime), f"own_time({name!r}) is a {type(own).__name__}")
        _demand(frequency is None or len(frequency) == expected.size, f"own_frequency({name!r}) has another length")
    for texts in (file.problems, file.notes):
        _demand(isinstance(texts, tuple) and all(isinstance(t, str) for t in texts), "problems and notes are texts")
    missing = "no such column"
    try:
        file.numbers(missing)
    except RefusedError as error:
        told = f"{error} {error.expected}"
        _demand(any(name in told for name in names), "the error for a missing column does not name those there are")
    else:
        raise AssertionError("a column that is not there is read")


def _check_damage(reader: Reader, path: Path, mapping: FileMapping, content: bytes) -> None:
    """Cut and scrambled copies are read, in part or not at all, or refused: nothing else."""
    copies = [content[: int(cut * len(content)) if isinstance(cut, float) else cut] for cut in _CUTS]
    middle = len(content) // 2
    copies += [bytes(len(content)), content[:middle] + bytes(b ^ 0xFF for b in content[middle:])]
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        for damaged in copies:
            copy.write_bytes(damaged)
            try:
                file = reader.read(copy, mapping)
                for name in mapping.columns:
                    file.numbers(name)
            except DealabError:
                continue
            except Exception as error:
                raise AssertionError(
                    f"a damaged file ({len(damaged)} bytes) ends in {type(error).__name__}: {error}, not in a RefusedError"
                ) from error


def _demand(holds: bool, otherwise: str) -> None:
    if not holds:
        raise AssertionError(otherwise)
