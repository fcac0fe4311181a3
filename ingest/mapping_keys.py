"""The keys of a mapping TOML: which there are, of which type, and the checks that name a wrong one.

What they mean is told in `ingest.mapping`, which builds the mapping from them.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

from schemas.errors import RefusedError

Types: TypeAlias = tuple[type, ...]

RECORDING, LIFETIMES, FREQUENCY_RESPONSE, RELAXATION, IGNORE = (
    "recording",
    "lifetimes",
    "frequency_response",
    "relaxation",
    "ignore",
)
KINDS = (RECORDING, LIFETIMES, FREQUENCY_RESPONSE, RELAXATION, IGNORE)
FORMATS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "mcap": (".mcap",),
        "csv": (".csv", ".tsv", ".txt", ".dat", ".asc"),
        "excel": (".xlsx", ".xls", ".xlsm", ".xlsb", ".ods"),
        "matlab": (".mat",),
        "hdf5": (".h5", ".hdf5", ".hdf"),
        "tdms": (".tdms",),
        "uff": (".uff", ".unv"),
    }
)
"""File endings by format."""

OPTIONS: Mapping[str, Mapping[str, Types]] = {
    "csv": {
        "delimiter": (str,),
        "decimal": (str,),
        "encoding": (str,),
        "skip_rows": (int,),
        "header": (bool,),
        "unit_row": (bool,),
        "quote": (str,),
        "comment": (str,),
        "missing": (list,),
        "final_newline": (bool,),
    },
    "excel": {"sheet": (str, int), "skip_rows": (int,), "header": (bool,), "unit_row": (bool,)},
    "hdf5": {"root": (str,), "transpose": (bool,)},
    "matlab": {"root": (str,), "transpose": (bool,)},
    "tdms": {"group": (str,)},
    "uff": {},
    "mcap": {},
}
TIME = {
    "column": (str, int),
    "index": (int,),
    "unit": (str,),
    "sample_rate_hz": (float, int),
    "origin": (str,),
    "format": (str,),
    "zone": (str,),
}
CHANNEL_METADATA = ("sensor", "delay_s", "resolution", "filter_hz")
COLUMN = {
    "column": (str, int),
    "index": (int,),
    "field": (str,),
    "time": (str, int),
    "unit": (str,),
    "scale": (float, int),
    "offset": (float, int),
    "sparse": (bool,),
    "sensor": (str,),
    "delay_s": (float, int),
    "resolution": (float, int),
    "filter_hz": (float, int),
}
TABLE_COLUMN = {
    "column": (str, int),
    "index": (int,),
    "unit": (str,),
    "scale": (float, int),
    "offset": (float, int),
    "value": (str, int, float, bool),
    "failed_values": (list,),
    "censored_values": (list,),
    "left_censored_values": (list,),
}
TABLE_COLUMNS: Mapping[str, tuple[str, ...]] = {
    LIFETIMES: (
        "lifetime",
        "failed",
        "voltage",
        "configuration",
        "specimen_id",
        "breakdown_voltage",
        "failure_site",
        "failure_region",
    ),
    FREQUENCY_RESPONSE: (
        "frequency",
        "storage",
        "loss",
        "magnitude",
        "phase",
        "standard_error",
        "temperature",
        "displacement",
        "transducer_displacement",
    ),
    RELAXATION: ("time", "relaxation", "standard_error"),
}
"""Names that `columns.<name>` may have in each kind of table."""
_TYPE_NAMES = {str: "text", int: "a whole number", float: "a number", bool: "true or false", list: "a list"}


def table(content: Mapping[str, Any], name: str, source: str) -> dict[str, Any]:
    """A table of the TOML, empty where it is absent."""
    found = content.get(name, {})
    if not isinstance(found, dict):
        raise refused(source, f"{name} is {type(found).__name__} {str(found)[:80]!r}", f"a table [{name}]")
    return dict(found)


def checked(entry: Any, name: str, keys: Mapping[str, Types], source: str) -> dict[str, Any]:
    """A table whose keys are all known and of their types."""
    if not isinstance(entry, dict):
        raise refused(source, f"{name} is {str(entry)[:80]!r}", f"a table [{name}]")
    for key, value in entry.items():
        if key not in keys:
            raise refused(source, f'key "{name}.{key[:80]}" is unknown', "one of " + ", ".join(keys))
        types = keys[key]
        if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
            raise refused(source, f"{name}.{key} is {str(value)[:80]!r}", " or ".join(_TYPE_NAMES[t] for t in types))
    return dict(entry)


def choice(value: Any, key: str, allowed: tuple[str, ...], source: str) -> str:
    """A value that is one of those allowed."""
    if value not in allowed:
        raise refused(source, f'{key} is "{str(value)[:80]}"', "one of " + ", ".join(allowed))
    return str(value)


def refused(source: str, problem: str, expected: str) -> RefusedError:
    """The error for a mistake in a mapping."""
    return RefusedError(problem, where=source, expected=expected, remedy="Correct the mapping TOML")
