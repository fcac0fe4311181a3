"""What reads each format: one table, in which ours stand like those of other packages.

Another package adds a format by an object with the attributes of `Reader`, under the entry-point group `dealab.readers`:

    [project.entry-points."dealab.readers"]
    ldat = "our_package.dealab_reader:READER"

`ingest.reader_kit` is what it can hold its reader against in its own tests.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol, TypeAlias

from ingest.columns import ColumnFile
from ingest.formats import find_plugins
from ingest.mapping import FileMapping
from ingest.mapping_keys import Key
from schemas.errors import DealabError, MissingExtraError, RefusedError

Read: TypeAlias = Callable[[Path, FileMapping], ColumnFile]
"""The columns of a file; it raises `RefusedError` for content that it cannot use, and `MissingExtraError` where a library is missing."""


class Reader(Protocol):
    """What another package registers.

    Parameters
    ----------
    suffixes : file endings, such as `(".ldat",)`
    options : keys of the format's own table in a mapping, with the types of their values and what they mean
    """

    suffixes: tuple[str, ...]
    options: Mapping[str, Key]

    def read(self, path: Path, mapping: FileMapping) -> ColumnFile:
        """The columns of a file, of which `mapping.options` are the options. Raises `RefusedError`."""


def _csv() -> Read:
    from ingest.csv_reader import read_csv

    return read_csv


def _excel() -> Read:
    from ingest.excel_reader import read_excel

    return read_excel


def _matlab() -> Read:
    from ingest.matlab_reader import read_matlab

    return read_matlab


def _hdf5() -> Read:
    from ingest.hdf5_reader import read_hdf5

    return read_hdf5


def _tdms() -> Read:
    from ingest.tdms_reader import read_tdms

    return read_tdms


def _arrow() -> Read:
    from ingest.arrow_reader import read_arrow

    return read_arrow


def _numpy() -> Read:
    from ingest.numpy_reader import read_numpy

    return read_numpy


def _mdf() -> Read:
    from ingest.mdf_reader import read_mdf

    return read_mdf


def _lvm() -> Read:
    from ingest.lvm_reader import read_lvm

    return read_lvm


def _trios() -> Read:
    from ingest.trios_reader import read_trios

    return read_trios


def _uff() -> Read:
    from ingest.uff_reader import read_uff

    return read_uff


_OURS: Mapping[str, Callable[[], Read]] = {
    "csv": _csv,
    "excel": _excel,
    "matlab": _matlab,
    "hdf5": _hdf5,
    "tdms": _tdms,
    "uff": _uff,
    "mdf": _mdf,
    "lvm": _lvm,
    "trios": _trios,
    "arrow": _arrow,
    "numpy": _numpy,
}
"""By format: imports its reader. Imports stand in functions, as text, so that the night knows what results depend on."""


def find_reader(name: str) -> Read:
    """What reads a format of columns.

    Raises
    ------
    MissingExtraError
        The reader of another package cannot be used.
    """
    if name in _OURS:
        return _OURS[name]()
    plugin = find_plugins()[name]
    if plugin.reader is None:
        raise MissingExtraError(
            f"the reader of {name} ({plugin.origin}) cannot be used: {plugin.trouble}",
            expected="a reader that can be imported",
            remedy="Mend or remove that package",
        )

    def read(path: Path, mapping: FileMapping) -> ColumnFile:
        try:
            found: ColumnFile = plugin.reader.read(path, mapping)
        except (DealabError, FileNotFoundError, MemoryError):
            raise
        except Exception as error:
            raise RefusedError(
                f"the reader of {name} ({plugin.origin}) failed: {type(error).__name__}: {error}",
                where=path.name,
                expected="columns, or a RefusedError",
                remedy="Tell the authors of that package",
            ) from error
        return found

    return read
