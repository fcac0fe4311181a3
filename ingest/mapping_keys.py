"""The keys of a mapping TOML: which there are, of which type, and the checks that name a wrong one.

The mapping is built from them in `ingest.mapping`; `ingest/README.md` shows them with an example of each kind.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

from schemas.alike import ask_meant
from schemas.errors import RefusedError

Types: TypeAlias = tuple[type, ...]


@dataclass(frozen=True)
class Key:
    """A key of the TOML: the types that its value may have, and what it means."""

    types: Types
    meaning: str


RECORDING, LIFETIMES, FREQUENCY_RESPONSE, RELAXATION, IGNORE = (
    "recording",
    "lifetimes",
    "frequency_response",
    "relaxation",
    "ignore",
)
TAN_DELTA = "tan_delta"
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
        "mdf": (".mf4", ".mdf"),
        "lvm": (".lvm",),
        "trios": (),
        "arrow": (".parquet", ".pq", ".feather", ".arrow"),
        "numpy": (".npy", ".npz"),
    }
)
"""File endings by format."""

_NUMBER: Types = (float, int)
_COLUMN: Types = (str, int)

TOP: Mapping[str, str] = MappingProxyType(
    {
        "kind": "what the file holds",
        "format": "where the file's ending does not tell it",
        "repeated": '"mean": rows of a table at the same frequency (or time) are one, their mean; absent: they are refused',
    }
)
"""Keys at the top of a mapping with what they mean; beside them stand the tables below."""
OPTIONS: Mapping[str, Mapping[str, Key]] = {
    "csv": {
        "delimiter": Key((str,), 'one character, or "whitespace"'),
        "decimal": Key((str,), "decimal mark"),
        "thousands": Key((str,), "mark between thousands, where a number such as 1,234 may have two meanings"),
        "encoding": Key((str,), "character encoding, such as utf-8 or cp1252"),
        "skip_rows": Key((int,), "lines before the header"),
        "header": Key((bool,), "false: there is none, columns are numbers from 0"),
        "unit_row": Key((bool,), "true: the line after the header holds units"),
        "quote": Key((str,), "quotation mark"),
        "comment": Key(
            (str,),
            "lines that begin so are left out; where rows count as time, one that is a whole sample keeps its time",
        ),
        "missing": Key((list,), "texts that stand for no value"),
        "final_newline": Key((bool,), "false: this exporter ends its last line without a line end"),
    },
    "excel": {
        "sheet": Key(
            (str, int, list),
            "name, or number from 0; or a list of sheets with the same columns, which are read one below the other: the column `sheet`"
            " has their names",
        ),
        "skip_rows": Key((int,), "rows before the header"),
        "header": Key((bool,), "false: there is none, columns are numbers from 0"),
        "unit_row": Key((bool,), "true: the row after the header holds units"),
        "decimal": Key((str,), "decimal mark of numbers that are stored as text"),
    },
    "hdf5": {
        "root": Key((str,), "prefix of every path"),
        "transpose": Key((bool,), "true: the samples run along the rows of matrices"),
    },
    "matlab": {
        "root": Key((str,), "prefix of every path"),
        "transpose": Key((bool,), "true: the samples run along the rows of matrices"),
    },
    "tdms": {"group": Key((str,), "group whose channels are meant")},
    "uff": {},
    "mdf": {},
    "lvm": {"encoding": Key((str,), "character encoding, such as utf-8 (the default) or cp1252")},
    "trios": {"encoding": Key((str,), "character encoding, such as utf-8 (the default) or utf-16")},
    "arrow": {},
    "numpy": {
        "root": Key((str,), "prefix of every path"),
        "transpose": Key((bool,), "true: the samples run along the rows of matrices"),
    },
    "mcap": {},
}
"""Keys of each format's own table."""
TIME: Mapping[str, Key] = {
    "column": Key(_COLUMN, "the column of times"),
    "index": Key((int,), "column of a matrix, from 0"),
    "unit": Key((str,), "unit of time"),
    "sample_rate_hz": Key(_NUMBER, "in place of a column: equal steps"),
    "origin": Key(
        (str,),
        '"started_at": time since the start, the default; "unix": since 1970 UTC; "labview": since 1904 UTC; "excel",'
        ' "excel_1904" and "matlab": serial days of local time, which need zone; or the date they count from, such as'
        ' "1899-12-30"',
    ),
    "format": Key(
        (str,),
        'for times as text: "iso", a strptime pattern, "time_of_day" (the date is that of started_at, midnight may'
        ' pass), "elapsed" (hh:mm:ss, beyond 24 h as well) or "mm:ss"',
    ),
    "date_column": Key(_COLUMN, "the column of dates, where column holds the time of day alone"),
    "overrule_unit": Key((bool,), "true: the unit that the file itself gives (header, unit row) is wrong"),
    "zone": Key((str,), "for absolute times that lack theirs: an IANA name such as Europe/Berlin"),
}
CHANNEL_METADATA = ("sensor", "delay_s", "resolution", "filter_hz")
_ANY_COLUMN: Mapping[str, Key] = {
    "column": Key(_COLUMN, "name of the column in the file, or its number from 0"),
    "index": Key((int,), "column of a matrix, from 0"),
    "unit": Key((str,), "unit of the column; may be left out where a unit row or the file has it"),
    "scale": Key(_NUMBER, "value = scale × raw + offset, in the unit"),
    "offset": Key(_NUMBER, "see scale"),
    "overrule_unit": Key((bool,), "true: the unit that the file itself gives (header, unit row, attribute) is wrong"),
}
COLUMN: Mapping[str, Key] = {
    **_ANY_COLUMN,
    "field": Key((str,), "key inside an MCAP message, dots for deeper ones"),
    "time": Key(_COLUMN, "a time column of its own"),
    "sparse": Key((bool,), "true: an empty cell means that this slower channel has no sample there"),
    "sensor": Key((str,), "what measured it"),
    "delay_s": Key(_NUMBER, "known latency"),
    "resolution": Key(_NUMBER, "one step of the converter, in the unit"),
    "filter_hz": Key(_NUMBER, "corner of the anti-alias filter"),
}
"""Keys of `columns.<quantity>` of a recording."""
TABLE_COLUMN: Mapping[str, Key] = {
    **_ANY_COLUMN,
    "value": Key((str, int, float, bool), "in place of a column: the same in every row"),
    "format": Key(
        (str,),
        "of `started` and `ended`: how their dates are written, a strptime pattern (absent: ISO 8601, or dates of a workbook);"
        ' of lives and other ages: "hh:mm" or "mm:ss" (hh:mm:ss is understood as it stands)',
    ),
    "open_until": Key(
        (str,),
        "column `ended`: the date and time (ISO 8601) of the state of the list, until which specimens without an end that have not failed"
        " were under test",
    ),
    "fill_down": Key(
        (bool,),
        "true: an empty cell has the value of the last filled one above it, as under a name that is written once for a block",
    ),
    "failed_values": Key((list,), "column `failed`: cells that mean failed"),
    "censored_values": Key((list,), "column `failed`: cells that mean a life that is only known to be longer"),
    "left_censored_values": Key((list,), "column `failed`: cells that mean a life that is only known to be shorter"),
    "no_test_values": Key(
        (list,), "column `failed`: cells of specimens that do not count: their rows are left out, a note"
    ),
    "film_values": Key((list,), "column `failure_mode`: cells that mean a failure of the film"),
    "lead_values": Key((list,), "column `failure_mode`: cells that mean a failure at the lead"),
    "edge_values": Key((list,), "column `failure_mode`: cells that mean a failure over or at the edge"),
    "electrode_values": Key((list,), "column `failure_mode`: cells that mean a failure of the electrode"),
    "other_values": Key((list,), "column `failure_mode`: cells that mean any other failure"),
    "censored_modes": Key(
        (list,),
        "column `failure_mode`: modes (film, lead, edge, electrode, other), or texts as the table writes them, whose failures count as"
        " survivors until then, a note: for the life of the film alone",
    ),
}
"""Keys of `columns.<name>` of a table."""
COVARIATES = "covariates"
COVARIATE: Mapping[str, Key] = {
    **{name: key for name, key in _ANY_COLUMN.items() if name != "overrule_unit"},
    "value": Key((str, int, float), "in place of a column: the same in every row"),
    "law": Key(
        (str,),
        '"inverse power" (by its logarithm), "exponential" (as it is), "arrhenius" (a temperature in °C) or "category"; absent:'
        " exponential where all cells are numbers, else category",
    ),
}
"""Keys of `covariates.<name>` of a table of lives: whatever a life may depend on, under a name of the laboratory's own."""
SELECT: Mapping[str, Key] = {
    "column": Key(_COLUMN, "the column that is looked at; none beside `first_row` and `last_row`"),
    "equals": Key((list, str, int, float, bool), "the value, or list of values, of the rows that are read"),
    "tolerance": Key(_NUMBER, "how far a number may be from `equals`, `each_of`, or the value that `each` stands for"),
    "at_least": Key(_NUMBER, "in place of `equals`: the smallest number of the rows that are read"),
    "at_most": Key(_NUMBER, "the largest one"),
    "first_row": Key((int,), "in place of a column: the first row that is read, from 0"),
    "last_row": Key((int,), "the last one"),
    "each": Key(
        (bool,),
        "true: each value makes a recording of its own; `{each}` in `[recording]` is the value, and has to stand in"
        " `recording_id`",
    ),
    "each_of": Key(
        (list,),
        "in place of `each`: these values make a recording each; rows at none of them, within `tolerance`, are left out",
    ),
    "runs": Key(
        (str,),
        '"apart", beside `each` or `each_of`: a value that comes back after others makes another recording, `20` and `20-run2`',
    ),
    "run": Key((int,), "beside `equals`: of the times that the column comes to it the one of this number, from 1"),
    "part": Key(
        (str,),
        "a name: the rows of this entry (of all entries of that name) make a recording of their own, and `{each}` is the name",
    ),
    "recording": Key((dict,), "beside `part`: the keys of `[recording]` that are others for it, such as `protocol`"),
    "columns": Key(
        (dict,),
        "beside `part`: the tables of `columns` that are others for it, as of specimens side by side: `[select.columns.force]`",
    ),
    "time": Key((dict,), "beside `part`: the keys of `[time]` that are others for it, likewise"),
}
OF_A_PART = ("recording", "columns", "time")
"""Tables that an entry of `select` may have for its part alone."""
MEAN = "mean"
"""What `repeated` may be."""
EACH = "{each}"
"""Stands for the value that a part of a file has, in the texts of `[recording]`."""
TABLE_COLUMNS: Mapping[str, Mapping[str, str]] = {
    LIFETIMES: {
        "lifetime": "required, or `started` and `ended`; a unit of time, or cycles (kcycles, Mcycles) with a frequency. So are all other ages of the row",
        "failed": "`failed_values` and `censored_values` say which cells mean what: numbers are compared as numbers,"
        " other cells as text, and a value in none of the lists refuses the table; `left_censored_values` are lives that are"
        " only known to be shorter. Where no column says it, a life written as survived (`> 3600`, `3600+`) is censored"
        " and every other one a failure",
        "censored": "in place of `failed`, with the same keys",
        "alive_at": "of a failure found at an inspection: the last inspection before it that found the specimen alive, 0 where"
        " there was none (left-censored, as a life written `< 3600`); an empty cell: the life is exact. Without a life: alive"
        " then, and not seen again",
        "entered": "age at which the specimen came under watch, where specimens that failed earlier are not in the table;"
        " an empty cell: from its start",
        "started": "date and time of the start, with `ended`: the life of a row that has none of its own is the time between them",
        "ended": "see started; `open_until` stands for the empty cells of specimens that still run",
        "test_duration": "planned duration: the life of a survivor that has none of its own; absent: `test_duration_s`"
        " of `[recording]`",
        "count": "number of specimens that the row stands for; absent: one",
        "voltage": "a unit of voltage; absent: `voltage_setpoint_kv` of `[recording]`",
        "configuration": "absent: that of `[recording]`",
        "specimen_id": "absent: `<name of the file>-<row from 1>`",
        "breakdown_voltage": "of staircase tests",
        "failure_site": "absent: that of `[recording]`",
        "failure_region": "absent: that of `[recording]`",
        "failure_mode": "in any words; `film_values`, `lead_values`, `edge_values`, `electrode_values` and `other_values` say what"
        " they mean, else it is told from words such as pinhole, contact or flashover. What no word tells is `other`, which a"
        " note says. `censored_modes`: failures of these modes, or with these texts, end the watch and are no failures",
        "temperature": "of the test; absent: `temperature_c` of `[recording]`",
        "humidity": "relative humidity of the test, 0 to 1 or %",
        "frequency": "Hz, of an alternating voltage",
        "electrode": "material of the electrode",
        "batch": "batch of film, or of specimens",
    },
    FREQUENCY_RESPONSE: {
        "frequency": "Hz or rad/s, the two are told apart; required but of UFF, whose sets have their own",
        "storage": "required with `loss` or `tan_delta`, or magnitude and phase or tan_delta, or response; N/mm (stiffness)"
        " or MPa (modulus)",
        "loss": "see storage",
        TAN_DELTA: "in place of the loss or the phase: loss over storage",
        "magnitude": "required with `phase` or `tan_delta`, or storage and loss, or response; N/mm or MPa",
        "phase": "deg or rad; a lossy material has a positive phase",
        "response": "in place of both pairs: complex numbers as e^{jωt}; N/mm or MPa, or what they are computed from:"
        " m/N (compliance), m/s/N (mobility), m/s²/N (accelerance) and their inverses",
        "standard_error": "√E|Δ|² of both components together, in the unit of storage or magnitude",
        "temperature": "of the row; several recordings of one specimen at different temperatures make a master curve",
        "displacement": "amplitude of the specimen's deformation",
        "transducer_displacement": "amplitude of the machine's own transducer, which it has taken off already, of the same"
        " kind as `displacement`: lines that are more the transducer's than the specimen's are not used",
    },
    RELAXATION: {
        "time": "required; time since the step",
        "relaxation": "required; N/mm (stiffness) or MPa (modulus)",
        "standard_error": "in the same unit",
        "temperature": "of the row; several recordings of one specimen at different temperatures make a master curve",
    },
}
"""Names that `columns.<name>` may have in each kind of table, with what they mean."""
TYPE_NAMES = {
    str: "text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    list: "a list",
    dict: "a table",
}


def table(content: Mapping[str, Any], name: str, source: str) -> dict[str, Any]:
    """A table of the TOML, empty where it is absent."""
    found = content.get(name, {})
    if not isinstance(found, dict):
        raise refused(source, f"{name} is {type(found).__name__} {str(found)[:80]!r}", f"a table [{name}]")
    return dict(found)


def checked(entry: Any, name: str, keys: Mapping[str, Key], source: str) -> dict[str, Any]:
    """A table whose keys are all known and of their types."""
    if not isinstance(entry, dict):
        raise refused(source, f"{name} is {str(entry)[:80]!r}", f"a table [{name}]")
    for key, value in entry.items():
        if key not in keys:
            raise unknown(source, f"{name}.{key}", [f"{name}.{k}" for k in keys])
        types = keys[key].types
        if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
            raise refused(source, f"{name}.{key} is {str(value)[:80]!r}", " or ".join(TYPE_NAMES[t] for t in types))
    return dict(entry)


def choice(value: Any, key: str, allowed: tuple[str, ...], source: str) -> str:
    """A value that is one of those allowed."""
    if value not in allowed:
        raise refused(
            source, f'{key} is "{str(value)[:80]}"{ask_meant(str(value), allowed)}', "one of " + ", ".join(allowed)
        )
    return str(value)


def unknown(source: str, key: str, known: Iterable[str]) -> RefusedError:
    """The error for a key that does not exist, with the one that may be meant."""
    names = sorted(known)
    return refused(source, f'key "{key[:80]}" is unknown{ask_meant(key, names)}', "one of " + ", ".join(names))


def refused(source: str, problem: str, expected: str) -> RefusedError:
    """The error for a mistake in a mapping."""
    return RefusedError(problem, where=source, expected=expected, remedy="Correct the mapping TOML")
