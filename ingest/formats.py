"""Which formats there are: ours, and those of other packages, which register a reader under the entry-point group `dealab.readers`.

A reader of another package is looked for only here; it is imported as soon as the first mapping or file ending is asked about.
Does not belong here: what reads a format (`ingest.readers`).
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any

from ingest.mapping_keys import FORMATS, OPTIONS, Key

GROUP = "dealab.readers"


UNREAD: Mapping[str, str] = {
    **dict.fromkeys((".zst", ".7z", ".rar", ".tar", ".tgz"), "unpack it"),
    **dict.fromkeys((".gz", ".bz2", ".xz"), "unpack it: of compressed files only texts are read, such as .csv.gz"),
    ".zip": "unpack it; `dealab add FILE` maps one that holds a single text",
    ".nc": "export it as HDF5 or CSV",
    **dict.fromkeys((".pkl", ".pickle"), "export it as CSV, NumPy or HDF5: who opens a pickle runs what is in it"),
    **dict.fromkeys((".prn", ".tab"), 'text: a mapping with format = "csv" reads it'),
    **dict.fromkeys((".tdm", ".tdx"), "export it as TDMS"),
    **dict.fromkeys((".rda", ".rdata", ".rds"), "R data: export it as CSV, with write.csv"),
    **dict.fromkeys(
        (".sav", ".zsav", ".por", ".xpt", ".sas7bdat", ".dta"), "data of a statistics program: export it as CSV"
    ),
    **dict.fromkeys(
        (".opj", ".opju", ".pxp", ".ibw", ".pzfx", ".jnb"), "a project of a plotting program: export it as CSV"
    ),
    **dict.fromkeys(
        (".tri", ".rdm", ".zs2", ".zse", ".is_tens", ".is_tcyclic", ".is_trelax", ".mss"),
        "the machine's own format: export it as CSV or text",
    ),
    **dict.fromkeys((".mdb", ".accdb"), "a database: export its tables as CSV"),
    ".mpl": "material data of a finite element program: what was fitted, no measurement",
    **dict.fromkeys(
        (".dxd", ".wfm", ".isf", ".trc", ".sie", ".wav", ".bin", ".raw", ".abf", ".edf", ".smr", ".spc", ".fits"),
        "export it as CSV, MAT or HDF5",
    ),
    **dict.fromkeys(
        (".json", ".jsonl", ".ndjson", ".xml", ".db3", ".bag", ".sqlite", ".sqlite3", ".db"), "export it as CSV or MCAP"
    ),
}
"""Endings of files that often hold measurements and that no reader of ours takes, with what to do about them."""


@dataclass(frozen=True)
class Plugin:
    """A reader of another package.

    Parameters
    ----------
    name : of the format, as `format` of a mapping says it
    origin : package and version that it comes from
    suffixes : its file endings, in small letters
    options : keys of its own table in a mapping
    reader : the object itself (`ingest.readers.Reader`), None where it cannot be used
    trouble : why it cannot; empty where it can
    """

    name: str
    origin: str
    suffixes: tuple[str, ...] = ()
    options: Mapping[str, Key] = field(default_factory=dict)
    reader: Any = None
    trouble: str = ""


@functools.cache
def find_plugins() -> Mapping[str, Plugin]:
    """The readers of other packages, by format."""
    return {entry.name: _load(entry) for entry in metadata.entry_points(group=GROUP)}


@functools.cache
def list_formats() -> Mapping[str, tuple[str, ...]]:
    """File endings by format, ours first: an ending that is ours stays ours."""
    return {**FORMATS, **{name: plugin.suffixes for name, plugin in find_plugins().items() if name not in FORMATS}}


@functools.cache
def list_options() -> Mapping[str, Mapping[str, Key]]:
    """Keys of each format's own table."""
    return {**OPTIONS, **{name: plugin.options for name, plugin in find_plugins().items() if name not in OPTIONS}}


def identify_plugins() -> tuple[str, ...]:
    """Names and versions of the readers of other packages: results of a night depend on them."""
    return tuple(f"{plugin.name}={plugin.origin}" for _, plugin in sorted(find_plugins().items()))


def _load(entry: metadata.EntryPoint) -> Plugin:
    origin = f"{entry.dist.name} {entry.dist.version}" if entry.dist is not None else entry.value
    if entry.name in FORMATS:
        return Plugin(entry.name, origin, trouble=f"the format {entry.name} is dealab's own")
    try:
        reader = entry.load()
        suffixes = tuple(str(suffix).lower() for suffix in reader.suffixes)
        options = {str(name): key for name, key in reader.options.items()}
        if not callable(reader.read) or not all(isinstance(key, Key) for key in options.values()):
            raise TypeError("it has no method read, or options that are no ingest.mapping_keys.Key")
    except Exception as error:  # whatever another package does, the night goes on without it
        return Plugin(entry.name, origin, trouble=f"{type(error).__name__}: {error}")
    return Plugin(entry.name, origin, suffixes, options, reader)
