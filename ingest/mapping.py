"""The TOML beside a foreign file: what its columns mean, and the metadata that the file lacks.

`find_mapping` finds and parses the one that belongs to a file; `<file>.toml` beside it comes before `recordings.toml`
of its folder, whose `[[files]]` entries are tried in order: the first whose `match` fits the file's name is taken.

Which keys there are, and what they mean, is in `ingest.mapping_keys`; `ingest/README.md` lists them with examples.

Does not belong here: reading the data files.
"""

from __future__ import annotations

import fnmatch
import functools
import math
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from datetime import datetime
from pathlib import Path
from typing import Any, TypeAlias

from ingest.compressed import TEXTS, find_stem, find_suffix, is_compressed
from ingest.formats import list_formats, list_options
from ingest.mapping_keys import (
    CHANNEL_METADATA,
    COLUMN,
    COVARIATE,
    COVARIATES,
    EACH,
    FREQUENCY_RESPONSE,
    IGNORE,
    KINDS,
    LIFETIMES,
    MEAN,
    OF_A_PART,
    RECORDING,
    RELAXATION,
    SELECT,
    TABLE_COLUMN,
    TABLE_COLUMNS,
    TIME,
    TOP,
    Key,
    checked,
    choice,
    refused,
    table,
    unknown,
)
from ingest.toml_files import content_hash, load_toml
from schemas.errors import RefusedError
from schemas.life_covariates import CATEGORY, LAWS, check_name
from schemas.lifetimes import FAILURE_MODES
from schemas.metadata import RecordingMetadata, check_keys
from schemas.quantities import QUANTITIES

FOLDER_FILE = "recordings.toml"
STARTED_AT = "started_at"
ELAPSED, MINUTES = "elapsed", "mm:ss"
"""Formats of times that count from there."""
ORIGINS: Mapping[str, tuple[int, bool]] = {
    "unix": (0, True),
    "labview": (-24_107 * 86_400, True),
    "excel": (-25_569 * 86_400, False),
    "excel_1904": (-24_107 * 86_400, False),
    "matlab": (-719_529 * 86_400, False),
}
"""What times count from, by name: seconds from 1970, and whether that is UTC; local time else."""
_WAYS = ("equals", "each", "each_of", "at_least", "at_most", "first_row", "last_row")
"""How an entry of `[[select]]` says which rows it means."""
_OWN = ".toml"
"""What the name of a data file gets for that of a mapping of its own."""
ColumnName: TypeAlias = str | int


@dataclass(frozen=True)
class ColumnMapping:
    """One column of a file. value = scale × raw + offset, in `unit`.

    `metadata` holds the channel's own keys (`sensor`, `delay_s`, `resolution`, `filter_hz`) as text, as MCAP has them.
    `value` stands for a column that is the same in every row (tables only); `meanings` says which cell values mean
    failed, censored and left-censored, or which failure mode (columns of lifetime tables), `censored_modes` which modes, or texts of the table, count as survivors. `law`: how a covariate of the laboratory's
    own enters a regression of lives. `says_scale`: the mapping gives a scale
    or offset, be it 1 or 0.
    """

    column: ColumnName | None
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    says_scale: bool = False
    index: int | None = None
    field: str | None = None
    time: ColumnName | None = None
    sparse: bool = False
    overrule_unit: bool = False
    value: Any = None
    format: str | None = None
    open_until: str | None = None
    fill_down: bool = False
    meanings: Mapping[str, tuple[Any, ...]] = dataclass_field(default_factory=dict)
    censored_modes: tuple[str, ...] = ()
    law: str | None = None
    metadata: Mapping[str, str] = dataclass_field(default_factory=dict)

    @property
    def label(self) -> str:
        """The column as a reader of messages knows it."""
        return column_label(self.column, self.index)


def column_label(column: ColumnName | None, index: int | None = None) -> str:
    """`"name"`, `number 3` or `"name", column 1` for messages."""
    shown = f"number {column}" if isinstance(column, int) else f'"{column}"'
    return shown if index is None else f"{shown}, column {index}"


@dataclass(frozen=True)
class TimeMapping:
    """Where the time of the samples comes from; see `ingest.mapping_keys.TIME`."""

    column: ColumnName | None = None
    index: int | None = None
    unit: str | None = None
    sample_rate_hz: float | None = None
    origin: str = "started_at"
    is_elapsed: bool = False
    """Whether the mapping itself says that times count from started_at, also those that the file gives."""
    format: str | None = None
    zone: str | None = None
    date_column: ColumnName | None = None
    overrule_unit: bool = False


@dataclass(frozen=True)
class Selection:
    """Only rows whose `column` holds one of `equals` belong to the table, numbers within `tolerance`, or one in a range.

    `each`: every value of the column makes a recording of its own, `each_of`: every one of these, `part`: the rows of this entry do
    (`ingest.parts`). `column` is None where the rows are counted: `first_row` to `last_row`, from 0.
    """

    column: ColumnName | None
    equals: tuple[Any, ...] = ()
    tolerance: float = 0.0
    at_least: float | None = None
    at_most: float | None = None
    each: bool = False
    each_of: tuple[Any, ...] = ()
    part: str | None = None
    runs: str | None = None
    run: int | None = None
    first_row: int | None = None
    last_row: int | None = None


@dataclass(frozen=True)
class FileMapping:
    """What the TOML says about one file, `{stem}` already replaced.

    `options` are the keys of the format's own table (`csv`, `excel`, …). `hash` is the SHA-256 of the effective
    content: it changes when anything that matters for this file changes, and not when a comment does.
    """

    kind: str
    format: str | None
    options: Mapping[str, Any]
    time: TimeMapping | None
    columns: Mapping[str, ColumnMapping]
    recording: Mapping[str, Any]
    rig: Mapping[str, Any]
    select: tuple[Selection, ...] = ()
    source: str = ""
    hash: str = ""
    reads: str = ""
    """Hash of what of the file is read: columns, rows and how, without metadata. Another one is another recording."""
    content: Mapping[str, Any] = dataclass_field(default_factory=dict, repr=False, compare=False)
    """The tables it was made from."""
    repeated: str | None = None
    """What becomes of rows of a table at the same frequency or time: "mean", or None where there may be none."""
    is_part: bool = False
    """Whether it is that of one part of a file, which begins with its own first sample."""

    @property
    def parts_file(self) -> bool:
        """Whether one file holds several recordings."""
        return any(s.each or s.each_of or s.part is not None for s in self.select)

    @property
    def counts_rows_as_time(self) -> bool:
        """Whether a sample's instant follows from the number of its row: no row may be left out before it is counted."""
        return self.time is not None and self.time.sample_rate_hz is not None

    def columns_of_file(self) -> list[ColumnName]:
        """All columns of the file that the mapping names."""
        time = () if self.time is None else (self.time.column, self.time.date_column)
        of_values = (name for c in self.columns.values() for name in (c.column, c.time))
        return [name for name in (*time, *of_values, *(s.column for s in self.select)) if name is not None]

    @classmethod
    def parse(cls, content: Mapping[str, Any], *, stem: str, suffix: str = "", source: str = "") -> FileMapping:
        """The mapping of a file from TOML content; `stem` and `suffix` are the two parts of the file's name.

        Raises `RefusedError` for keys that are unknown, of a wrong type or missing.
        """
        content = {k: _with_stem(v, stem) for k, v in content.items() if k != "match"}
        known = {*TOP, "time", "columns", COVARIATES, "recording", "rig", "select", *list_options()}
        for key in content:
            if key not in known:
                raise unknown(source, key, known)
        kind = choice(content.get("kind", RECORDING), "kind", KINDS, source)
        chosen = _format(content, source) or format_of_suffix(suffix)
        _check_used(content, kind, chosen, source)
        if kind == IGNORE:
            columns: dict[str, ColumnMapping] = {}
        else:
            columns = _columns(content, kind, chosen, source) | _covariates(content, kind, source)
        return cls(
            kind=kind,
            format=chosen,
            options=checked(content.get(chosen or "", {}), chosen or "", list_options().get(chosen or "", {}), source),
            time=_time(content, kind, source),
            columns=columns,
            recording=table(content, "recording", source),
            rig=table(content, "rig", source),
            select=_selections(content, source),
            source=source,
            repeated=None if "repeated" not in content else choice(content["repeated"], "repeated", (MEAN,), source),
            hash=content_hash(content),
            reads=content_hash({k: v for k, v in content.items() if k not in ("recording", "rig")}),
            content=content,
        )


def list_faults(
    content: Mapping[str, Any], *, stem: str, suffix: str = "", source: str = ""
) -> tuple[RefusedError, ...]:
    """All that is wrong with a mapping, table by table, where `FileMapping.parse` raises the first of it."""
    content = {k: _with_stem(v, stem) for k, v in content.items() if k != "match"}
    faults: list[RefusedError] = []

    def attempt(check: Callable[[], Any]) -> Any:
        try:
            return check()
        except RefusedError as error:
            if str(error) not in map(str, faults):
                faults.append(error)
            return None

    known = {*TOP, "time", "columns", COVARIATES, "recording", "rig", "select", *list_options()}
    faults += [unknown(source, key, known) for key in content if key not in known]
    kind = attempt(lambda: choice(content.get("kind", RECORDING), "kind", KINDS, source)) or RECORDING
    chosen = attempt(lambda: _format(content, source)) or format_of_suffix(suffix)
    options = content.get(chosen or "", {})
    for key in options if isinstance(options, dict) else ():
        own = {key: options[key]}
        attempt(functools.partial(checked, own, str(chosen), list_options().get(chosen or "", {}), source))
    columns = content.get("columns", {})
    for name in columns if isinstance(columns, dict) and kind != IGNORE else ():
        alone = {"columns": {name: columns[name]}}
        attempt(functools.partial(_columns, alone, kind, chosen, source))
    attempt(lambda: _covariates(content, kind, source))
    attempt(lambda: _time(content, kind, source))
    attempt(lambda: _selections(content, source))
    if not faults:
        attempt(lambda: FileMapping.parse(content, stem=stem, suffix=suffix, source=source))
    return tuple(faults)


def find_mapping(path: Path, names: Container[str] | None = None) -> FileMapping | None:
    """The mapping of a data file, or None when there is none. `RefusedError` when there is one but it is wrong.

    `names` in the file's folder, where somebody has looked already.
    """

    def there(name: str) -> bool:
        if names is not None:
            return name in names and path.with_name(name).is_file()
        try:
            return path.with_name(name).is_file()
        except OSError:  # a name that is too long, or in a folder that is closed now
            return False

    own = path.name + _OWN
    if there(own) and path.with_name(own).stat().st_size:  # `dealab inspect FILE > FILE.toml` begins with an empty one
        content = load_toml(path.with_name(own))
        if "match" in content:
            raise refused(own, "match is not used in the mapping of a single file", "only keys that have an effect")
        return FileMapping.parse(content, stem=find_stem(path), suffix=find_suffix(path), source=own)
    if not there(FOLDER_FILE):
        return None
    shared = path.with_name(FOLDER_FILE)
    info = shared.stat()
    for number, entry in enumerate(_folder_entries(shared, info.st_mtime_ns, info.st_size), start=1):
        if fnmatch.fnmatchcase(path.name, entry["match"]):
            return FileMapping.parse(
                entry,
                stem=find_stem(path),
                suffix=find_suffix(path),
                source=f"{shared.name}, [[files]] number {number}",
            )
    return None


def own_mapping(path: Path) -> Path:
    """The mapping file beside a data file, whether it exists or not."""
    return path.with_name(path.name + _OWN)


@functools.lru_cache(maxsize=64)
def _folder_entries(path: Path, mtime_ns: int, size: int) -> tuple[dict[str, Any], ...]:
    """Entries of a folder's file in this state of it: a folder of thousands of recordings parses it once."""
    return tuple(list_entries(load_toml(path), path.name))


def format_of(path: Path, mapping: FileMapping | None = None) -> str | None:
    """The format of a data file: what its mapping says, else what its ending says; None when neither does."""
    if mapping is not None and mapping.format is not None:
        return mapping.format
    found = format_of_suffix(find_suffix(path))
    return None if is_compressed(path) and found not in TEXTS else found


def format_of_suffix(suffix: str) -> str | None:
    """The format that a file ending stands for, in capitals or not; None for an unknown one."""
    return next((name for name, suffixes in list_formats().items() if suffix.lower() in suffixes), None)


def list_entries(content: Mapping[str, Any], source: str) -> list[dict[str, Any]]:
    """The `[[files]]` of a folder's file. Raises `RefusedError` for anything else in it, and for one without `match`."""
    for key in content:
        if key != "files":
            raise refused(source, f'key "{key[:80]}" is unknown at the top level', "only [[files]] entries")
    entries = content.get("files", [])
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise refused(source, "files is not a list of tables", "[[files]] entries")
    for number, entry in enumerate(entries, start=1):
        if not isinstance(entry.get("match"), str):
            raise refused(source, f"[[files]] number {number} has no match", 'a pattern such as match = "*.csv"')
    return entries


def _with_stem(value: Any, stem: str) -> Any:
    if isinstance(value, str):
        return value.replace("{stem}", stem)
    if isinstance(value, list):
        return [_with_stem(v, stem) for v in value]
    if isinstance(value, dict):
        return {k: _with_stem(v, stem) for k, v in value.items()}
    return value


def _format(content: Mapping[str, Any], source: str) -> str | None:
    named = [name for name in list_options() if name in content]
    if len(named) > 1:
        raise refused(source, f"tables of {len(named)} formats: {', '.join(named)}", "the table of one format")
    if "format" not in content:
        return named[0] if named else None
    chosen = choice(content["format"], "format", tuple(list_formats()), source)
    if named and named[0] != chosen:
        raise refused(source, f'format is "{chosen}" but the options are in [{named[0]}]', f"[{chosen}]")
    return chosen


def _columns(content: Mapping[str, Any], kind: str, chosen: str | None, source: str) -> dict[str, ColumnMapping]:
    columns = table(content, "columns", source)
    allowed = tuple(QUANTITIES if kind == RECORDING else TABLE_COLUMNS[kind])
    keys = COLUMN if kind == RECORDING else TABLE_COLUMN
    mapped = {}
    for name, entry in columns.items():
        if name not in allowed:
            raise unknown(source, f"columns.{name}", [f"columns.{n}" for n in allowed])
        mapped[name] = _column(entry, f"columns.{name}", keys, source)
    if not mapped and chosen != "mcap":
        raise refused(source, "no columns are mapped", "a table [columns.<quantity>] for each quantity")
    return mapped


def _covariates(content: Mapping[str, Any], kind: str, source: str) -> dict[str, ColumnMapping]:
    """The columns of `[covariates.<name>]`, by `covariates.<name>`."""
    entries = table(content, COVARIATES, source)
    if entries and kind != LIFETIMES:
        raise refused(source, f'{COVARIATES} is not used for kind "{kind}"', f'kind "{LIFETIMES}"')
    mapped = {}
    for name, entry in entries.items():
        key = f"{COVARIATES}.{name}"
        check_name(name, key, source)
        mapped[key] = _column(entry, key, COVARIATE, source)
        if mapped[key].law is not None:
            choice(mapped[key].law, f"{key}.law", LAWS, source)
    return mapped


def _moment_or_none(value: str | None, key: str, source: str) -> str | None:
    """A date and time in ISO 8601, None where there is none."""
    if value is None:
        return None
    try:
        datetime.fromisoformat(value)
    except ValueError:
        raise refused(source, f'{key} is "{value[:80]}"', "a date and time such as 2026-03-02T09:00") from None
    return value


def _column(entry: Any, name: str, keys: Mapping[str, Key], source: str) -> ColumnMapping:
    entry = checked(entry, name, keys, source)
    if ("column" in entry) == ("value" in entry):
        raise refused(
            source,
            f"{name} has no column" if "column" not in entry else f"{name} has column and value",
            'the name (or number from 0) of a column in the file: column = "…"',
        )
    for key in ("column", "index"):
        if isinstance(entry.get(key), int) and entry[key] < 0:
            raise refused(source, f"{name}.{key} is {entry[key]}", "a number from 0")
    meanings = {
        key.removesuffix("_values"): tuple(entry[key])
        for key in (*_VALUES_OF_FAILED, *_VALUES_OF_MODES)
        if key in entry
    }
    return ColumnMapping(
        column=entry.get("column"),
        unit=entry.get("unit"),
        scale=float(entry.get("scale", 1.0)),
        offset=float(entry.get("offset", 0.0)),
        says_scale="scale" in entry or "offset" in entry,
        index=entry.get("index"),
        field=entry.get("field"),
        time=entry.get("time"),
        sparse=entry.get("sparse", False),
        overrule_unit=entry.get("overrule_unit", False),
        value=entry.get("value"),
        format=entry.get("format"),
        open_until=_moment_or_none(entry.get("open_until"), f"{name}.open_until", source),
        fill_down=entry.get("fill_down", False),
        meanings=meanings,
        censored_modes=tuple(str(mode) for mode in entry.get("censored_modes", ())),
        law=entry.get("law"),
        metadata={k: str(entry[k]) for k in CHANNEL_METADATA if k in entry},
    )


def _check_used(content: Mapping[str, Any], kind: str, chosen: str | None, source: str) -> None:
    """Refuses keys that are known and that this kind of file does not use: to ignore them would mislead."""
    if kind == IGNORE:
        more = [key for key in content if key != "kind"]
        if more:
            raise refused(
                source, f'{more[0]} is not used for kind "{IGNORE}"', "kind alone: nothing of the file is read"
            )
        return
    time = table(content, "time", source)
    columns = {name: c for name, c in table(content, "columns", source).items() if isinstance(c, dict)}
    unused = []
    if kind == RECORDING:
        own_times = [c.get("time") is not None for c in columns.values()]
        unused += [f"time.{key}" for key in time if key not in _used_of_time(time, chosen, own_times)]
    else:
        unused += ["rig"] if content.get("rig") else []
        unused += [f"time.{key}" for key in time if key != "zone"]
        unused += [f"columns.{n}.{key}" for n, c in columns.items() for key in c if key in _unused_of_table(n, c)]
        own = {name: c for name, c in table(content, COVARIATES, source).items() if isinstance(c, dict)}
        unused += [f"{COVARIATES}.{n}.{key}" for n, c in own.items() for key in c if key in _unused_of_covariate(c)]
    if chosen == "mcap":
        unused += ["select"] if content.get("select") else []
    else:
        unused += [f"columns.{n}.field" for n, c in columns.items() if "field" in c]
    if chosen == "uff":  # a set has a value for each of its places
        unused += [f"columns.{n}.sparse" for n, c in columns.items() if "sparse" in c]
    if "zone" in time and not _reads_local_time(content, time, kind, chosen):
        unused.append("time.zone")
    unused += ["repeated"] if "repeated" in content and kind not in (FREQUENCY_RESPONSE, RELAXATION) else []
    if unused:
        what = f"{chosen} files" if kind == RECORDING else f'kind "{kind}"'
        if unused[0].startswith("time.") and kind == RECORDING:
            what = "times that the mapping takes from there"
        raise refused(source, f"{unused[0]} is not used for {what}", "only keys that have an effect")
    alone = [n for n, c in columns.items() if c.get("overrule_unit") and "unit" not in c]
    if alone:
        raise refused(source, f"columns.{alone[0]} has overrule_unit without unit", "the unit that is right beside it")
    if time.get("overrule_unit") and "unit" not in time:
        raise refused(source, "time has overrule_unit without unit", "the unit that is right beside it")


def _used_of_time(time: Mapping[str, Any], chosen: str | None, own_times: Sequence[bool]) -> Container[str]:
    """The keys of [time] that have an effect beside those that say where the times are.

    `own_times` says of each column whether it has a time column of its own.
    """
    if "sample_rate_hz" in time:
        return ("sample_rate_hz", "zone", "column")  # with column it is refused for that
    unused = {"index"} if chosen == "mcap" else set()
    if own_times and all(own_times):
        unused |= {"column", "index", "sample_rate_hz"}
    elif "column" not in time and not any(own_times):
        if "date_column" in time or time.get("origin") is None:
            return TIME  # refused for lacking the column
        return ("zone", "origin") if time["origin"] == STARTED_AT else ("zone",)
    if "format" in time or "date_column" in time:
        unused.update(_unused_of_text(time))
    return [key for key in TIME if key not in unused]


def _reads_local_time(content: Mapping[str, Any], time: Mapping[str, Any], kind: str, chosen: str | None) -> bool:
    """Whether there may be a time without a zone of its own: in the file, or `started_at`."""
    about = content.get("recording", {})
    entries = content.get("select", [])
    stated = (
        [about, *(e.get("recording", {}) for e in entries if isinstance(e, dict))] if isinstance(entries, list) else []
    )
    starts = [one["started_at"] for one in stated if isinstance(one, dict) and one.get("started_at")]
    if any(_is_local(start) for start in starts) or (chosen == "mcap" and not starts):
        return True  # the messages of an MCAP file may have the start of the recording beside them
    if kind != RECORDING or "sample_rate_hz" in time or time.get("format") in (ELAPSED, MINUTES):
        return False
    origin = str(time.get("origin"))
    if origin == STARTED_AT and "column" not in time:
        return False
    counted = "unit" in time and "date_column" not in time
    return not (counted and origin in ORIGINS and ORIGINS[origin][1])


def _is_local(start: Any) -> bool:
    """Whether a `started_at` lacks its zone, as far as one can read it."""
    if isinstance(start, datetime):
        return start.tzinfo is None
    try:
        return datetime.fromisoformat(str(start).strip()).tzinfo is None
    except ValueError:
        return True


def _unused_of_text(time: Mapping[str, Any]) -> tuple[str, ...]:
    """The keys of [time] that have no effect on times as text, which say themselves what they count from."""
    counted = time.get("format") in (ELAPSED, MINUTES) and time.get("origin") == STARTED_AT
    return ("overrule_unit",) if counted else ("overrule_unit", "origin")


_VALUES_OF_FAILED = ("failed_values", "censored_values", "left_censored_values", "no_test_values")
_VALUES_OF_MODES = tuple(f"{mode}_values" for mode in FAILURE_MODES)
WORDS = (
    "failed",
    "censored",
    "configuration",
    "specimen_id",
    "failure_site",
    "failure_region",
    "failure_mode",
    "electrode",
    "batch",
)
"""Columns of tables that hold words, and so have no unit."""


FILLED_DOWN = ("configuration", "electrode", "batch", "voltage")
"""Columns of tables that people write once for a block of rows."""
_DATES = ("started", "ended")
_AGES = ("lifetime", "alive_at", "entered", "test_duration")
"""Columns of tables that hold times since the start of the test."""


def _unused_of_table(name: str, column: Mapping[str, Any]) -> Container[str]:
    """The keys of a table's column that have no effect."""
    unused: list[str] = []
    if name in (*WORDS, "count"):
        unused += ["unit", "scale", "offset", "overrule_unit"]
    if name not in ("failed", "censored"):
        unused += _VALUES_OF_FAILED
    if name != "failure_mode":
        unused += [*_VALUES_OF_MODES, "censored_modes"]
    if "value" in column:
        unused += ["index", "overrule_unit", "fill_down", "format", "open_until"]
    if name not in FILLED_DOWN:
        unused.append("fill_down")
    if name != "ended":
        unused.append("open_until")
    if name in _DATES:
        unused += ["unit", "scale", "offset", "overrule_unit"]
    elif name not in _AGES:
        unused.append("format")
    elif "format" in column:
        unused += ["unit", "scale", "offset", "overrule_unit"]
    return unused


def _unused_of_covariate(column: Mapping[str, Any]) -> Container[str]:
    """The keys of a covariate that have no effect."""
    unused = ["index", "scale", "offset"] if "value" in column else []
    return [*unused, "scale", "offset", "unit"] if column.get("law") == CATEGORY else unused


def _time(content: Mapping[str, Any], kind: str, source: str) -> TimeMapping | None:
    if "time" not in content:
        return None
    entry = checked(content["time"], "time", TIME, source)
    if "column" in entry and "sample_rate_hz" in entry:
        raise refused(source, "time has column and sample_rate_hz", "one of the two")
    by_itself = entry.get("origin") is not None or "zone" in entry  # of a file that has times without any column
    columns = [c for c in table(content, "columns", source).values() if isinstance(c, dict)]
    by_itself |= bool(columns) and all(c.get("time") is not None for c in columns)
    if kind == RECORDING and "column" not in entry and "sample_rate_hz" not in entry and not by_itself:
        raise refused(source, "time has neither column nor sample_rate_hz", "one of the two")
    rate = entry.get("sample_rate_hz")
    if rate is not None and not 0 < rate < 1e9:
        raise refused(source, f"time.sample_rate_hz is {rate}", "a rate above 0 and below 1e9 Hz")
    if "date_column" in entry and "column" not in entry:
        raise refused(source, "time has date_column without column", "the column of the times of day beside it")
    if "date_column" in entry and "unit" in entry:
        raise refused(source, "time has date_column and unit", "format, where the times of day need one")
    if "format" in entry and "unit" in entry:
        raise refused(source, "time has format and unit", "format for dates as text, unit for numbers")
    return TimeMapping(
        column=entry.get("column"),
        index=entry.get("index"),
        unit=entry.get("unit"),
        sample_rate_hz=None if rate is None else float(rate),
        origin=_origin(entry.get("origin", STARTED_AT), source),
        is_elapsed=entry.get("origin") == STARTED_AT,
        format=entry.get("format"),
        zone=entry.get("zone"),
        date_column=entry.get("date_column"),
        overrule_unit=entry.get("overrule_unit", False),
    )


def _as_list(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list | tuple) else (value,)


def _is_number(value: Any) -> bool:
    """Whether a value of `equals` is one, as a number or as its text."""
    try:
        return math.isfinite(float(str(value).strip().replace(",", ".")))
    except ValueError:
        return False


def _origin(value: str, source: str) -> str:
    """An origin by its name, or the date that times count from."""
    if value in (STARTED_AT, *ORIGINS):
        return value
    try:
        datetime.fromisoformat(value)
    except ValueError:
        named = ", ".join((STARTED_AT, *ORIGINS))
        raise refused(source, f'time.origin is "{value[:80]}"', f"{named}, or a date such as 1899-12-30") from None
    return value


def _check_own_columns(entry: Mapping[str, Any], content: Mapping[str, Any], source: str) -> None:
    """Refuses columns and times of a part that are none, or of a quantity that the mapping does not have."""
    mapped = table(content, "columns", source)
    for name, own in table(entry, "columns", source).items():
        if name not in mapped:
            raise unknown(source, f"select.columns.{name}", [f"select.columns.{n}" for n in mapped])
        _column(
            {**mapped[name], **checked(own, f"select.columns.{name}", COLUMN, source)},
            f"columns.{name}",
            COLUMN,
            source,
        )
    if "time" in entry:
        checked(entry["time"], "select.time", TIME, source)


def _selections(content: Mapping[str, Any], source: str) -> tuple[Selection, ...]:
    entries = content.get("select", [])
    if not isinstance(entries, list):
        raise refused(source, "select is not a list of tables", "[[select]] entries with column and equals")
    selections = []
    for entry in entries:
        found = checked(entry, "select", SELECT, source)
        ways = [key for key in _WAYS if key in found and found[key] is not False]
        counted = set(ways) <= {"first_row", "last_row"}
        if not ways or (("column" in found) is counted):
            raise refused(
                source,
                "a select entry lacks column or equals"
                if not counted or not ways
                else "a select entry has column and first_row",
                'column = "Set" and equals = 0, or at_least and at_most, or each = true in place of equals; or first_row and last_row',
            )
        if len(ways) > 1 and set(ways) not in ({"at_least", "at_most"}, {"first_row", "last_row"}):
            raise refused(source, f"a select entry has {' and '.join(ways)}", "one of them")
        if found.get("tolerance", 0) < 0 or ("tolerance" in found and ways[0] not in ("equals", "each", "each_of")):
            raise refused(source, "select.tolerance is not used so", "a tolerance from 0 beside equals or each")
        wanted = (*found.get("each_of", ()), *_as_list(found.get("equals", ())))
        words = [v for v in wanted if isinstance(v, bool) or not isinstance(v, int | float | str) or not _is_number(v)]
        if found.get("tolerance") and words:
            raise refused(source, f'select.tolerance is not used for "{words[0]}"', "a tolerance beside numbers")
        if "runs" in found and ways[0] not in ("each", "each_of"):
            raise refused(source, "select.runs is not used so", "runs beside each or each_of")
        if "run" in found and (ways[0] != "equals" or found["run"] < 1):
            raise refused(source, "select.run is not used so", "a number from 1 beside equals")
        if "part" in found and ways[0] in ("each", "each_of"):
            raise refused(source, f"a select entry has part and {ways[0]}", "one of the two")
        check_keys(found.get("recording", {}), RecordingMetadata, "select.recording", source)
        _check_own_columns(found, content, source)
        alone = [name for name in OF_A_PART if name in found and "part" not in found]
        if alone:
            raise refused(
                source, f"a select entry has {alone[0]} without part", "the name of the recording that it is for"
            )
        selections.append(
            Selection(
                found.get("column"),
                tuple(_as_list(found.get("equals", ()))),
                float(found.get("tolerance", 0.0)),
                None if "at_least" not in found else float(found["at_least"]),
                None if "at_most" not in found else float(found["at_most"]),
                found.get("each", False),
                tuple(found.get("each_of", ())),
                found.get("part"),
                None if "runs" not in found else choice(found["runs"], "select.runs", ("apart",), source),
                found.get("run"),
                found.get("first_row"),
                found.get("last_row"),
            )
        )
    of_values = [s for s in selections if s.each or s.each_of]
    named_parts = any(s.part is not None for s in selections)
    if len(of_values) > 1:
        raise refused(source, "two select entries have each", "one column that tells the recordings apart")
    if of_values and named_parts:
        raise refused(source, "select entries have each and part", "one of the two ways to tell the recordings apart")
    about = content.get("recording", {})
    named = isinstance(about, dict) and EACH in str(about.get("recording_id"))
    if (of_values or named_parts) and not named:
        raise refused(source, "each makes several recordings of one recording_id", f'recording_id = "{{stem}}-{EACH}"')
    return tuple(selections)
