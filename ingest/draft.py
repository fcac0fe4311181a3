"""A mapping for a file that has none: what could be read from the file, what was inferred, and what has to be asked.

`dealab inspect` shows the draft, `dealab add` asks its questions and writes it. Only here anything is guessed, and each
guess is said in a comment. Does not belong here: the text of the TOML (`ingest.draft_text`), which test a trace shows
(`ingest.shapes`), what the lines above a table say (`ingest.harvest`).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ingest.arrays import ArrayFile
from ingest.assemble import assemble
from ingest.clocks import duration_s, moment
from ingest.columns import ColumnFile
from ingest.draft_text import toml_text
from ingest.harvest import SAMPLE_RATE, STARTED_AT, Fact, by_key, harvest_hdf5, harvest_rows
from ingest.mapping import FileMapping, format_of
from ingest.mapping_keys import FREQUENCY_RESPONSE, LIFETIMES, RECORDING, RELAXATION, TAN_DELTA
from ingest.meanings import TIME, GuessedColumn, guess_columns
from ingest.notations import read_cell
from ingest.read import open_columns
from ingest.shapes import SURE, UNSURE, Shape, Trace, find_shape
from ingest.sniff import are_units, guess_text, is_number
from schemas.errors import DealabError, RefusedError
from schemas.protocols import PROTOCOLS
from schemas.quantities import QUANTITIES
from schemas.units import ANY, conversion

_STORAGE = r"stor|speicher|^[eg]['1]|[eg]'$|^k'|^[ab]t?_?g'|re\b"
_LOSS = r"loss|verlust|^[eg](''|\"|2)|^k''|im\b"
_MAGNITUDE = r"^\|.*\|$|magnitude|betrag|complex modulus|\|?[egk]\*\|?|^k$|dyn.*stiff|amplitude ratio"
_TAN_DELTA = r"\btan|loss factor|verlustfaktor"
_PHASE = r"phase|phi|φ|delta|δ|winkel"
_FREQUENCY = r"freq|omega|ω|^f$"
_RELAXED = r"relax|^[eg]\s?\(t\)|modul"
_FAILED = r"cens|fail|event|status|state|death|broke|^breakdown$|^bd$|runout|durchschlag"
_LIFE = r"life|lebensdauer|time to (break|fail)|(breakdown|failure) time|寿命|standzeit"
_CONFIGURATION = r"config|group|electrode|design|layout|bauart|gruppe|^type$"
_SPECIMEN = r"specimen|sample|probe|^id$"
_COUNT = r"^n$|^count$|^anzahl$"
_PLANNED = r"^test\b|test duration|planned|^on rig"
_YES = r"1|y|ja|oui|true|bd|fail|broke|break|dead|death"
_MODULI = ("Pa", "kPa", "MPa", "GPa", "N/mm", "N/m", "kN/m")
_WORDS = ("failed", "censored", "configuration", "specimen_id", "count")
_DECIMAL_COMMA = re.compile(r"-?\d+,\d+")
_MOST_MATRIX_COLUMNS = 12
_FIRST_CELLS = 200
_FEWEST_DEGREES = 2.0
"""Range of temperatures below which a table holds one sweep."""
_ANY_SCALE = 2.0
"""Stands for the scale of a sensor that is not known yet: the shape of a trace does not depend on it."""
_EVEN = 1e-3
"""Largest spread of the steps of a column of times, in steps, which no column of samples has."""


@dataclass(frozen=True)
class Question:
    """Something that the file does not say.

    Parameters
    ----------
    key : where the answer belongs in the mapping, `recording.specimen_id`
    text : what is asked
    suggestion : the answer that is taken when none is given; None where one has to be given
    choices : the only answers there are; empty for any
    """

    key: str
    text: str
    suggestion: Any = None
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Draft:
    """A mapping as a draft.

    Parameters
    ----------
    path : the data file
    content : the TOML as nested tables; None stands for an answer that has to be given
    remarks : comments by key (`recording.protocol`)
    questions : what the file does not say
    unmapped : columns that were not recognised
    about : comments of the format's table
    shape : which test was recognised, of a recording whose samples can be read
    unread : why its samples cannot be read
    """

    path: Path
    content: Mapping[str, Any]
    remarks: Mapping[str, str] = field(default_factory=dict)
    questions: tuple[Question, ...] = ()
    unmapped: tuple[GuessedColumn, ...] = ()
    about: tuple[str, ...] = ()
    shape: Shape | None = None
    unread: str = ""

    def as_toml(self) -> str:
        """The text of the TOML; what has to be checked is marked `CHECK`."""
        asked = {q.key: q.text for q in self.questions}
        unmapped = [(c.column, c.unit) for c in self.unmapped]
        return toml_text(self.path.name, self.content, self.remarks, asked, unmapped, self.about)


@dataclass(frozen=True)
class _Opened:
    """A file as it seems to be: its format's own keys, its columns, some rows, and what it says of the test."""

    path: Path
    format: str
    options: Mapping[str, Any]
    columns: tuple[GuessedColumn, ...]
    rows: Sequence[Sequence[Any]] = ()
    facts: Mapping[str, Fact] = field(default_factory=dict)
    about: tuple[str, ...] = ()
    has_own_time: bool = False

    def cells(self, column: GuessedColumn) -> list[Any]:
        """The first cells of a column; none where the rows were not looked at."""
        if not self.rows:
            return self._cells_of_array(column)
        place = column.column if isinstance(column.column, int) else self.columns.index(column)
        return [row[place] for row in self.rows if place < len(row)]

    def _cells_of_array(self, column: GuessedColumn) -> list[Any]:
        mapping = FileMapping(RECORDING, self.format, dict(self.options), None, {}, {}, {})
        try:
            return list(open_columns(self.path, self.format, mapping).cells(column.column, column.index)[:_FIRST_CELLS])
        except DealabError:
            return []


def draft_mapping(path: Path) -> str:
    """The text of a TOML that maps the file, with the guesses marked. Raises `RefusedError` when it cannot be read."""
    return make_draft(path).as_toml()


def make_draft(path: Path, said: Mapping[str, str] = MappingProxyType({})) -> Draft:
    """The draft of a mapping.

    Parameters
    ----------
    path : the data file
    said : what a person says that columns are, by name or number: a quantity, `time` or `nothing`

    Raises
    ------
    RefusedError : the file cannot be read, or is no table of numbers
    """
    opened = _open(path, said)
    for kind, chosen in (
        (FREQUENCY_RESPONSE, _response_columns(opened.columns)),
        (LIFETIMES, _lifetime_columns(opened)),
        (RELAXATION, _relaxation_columns(opened.columns)),
    ):
        if chosen:
            return _table(opened, kind, chosen)
    return _recording(opened)


def _open(path: Path, said: Mapping[str, str]) -> _Opened:
    found = _true_format(path)
    if found == "csv":
        guess = guess_text(path.read_bytes(), said)
        d = guess.dialect
        options = {
            "delimiter": d.delimiter,
            "decimal": d.decimal,
            "encoding": d.encoding,
            "skip_rows": d.skip_rows,
            "header": d.header,
            "unit_row": d.unit_row,
        }
        columns = _with_time_first(guess.columns)
        return _Opened(path, found, options, columns, guess.rows, by_key(guess.facts))
    if found == "excel":
        return _open_excel(path, said)
    if found == "mcap":
        raise RefusedError("no channel can be guessed", where=path.name, expected="topics mapped by hand in a TOML")
    return _open_arrays(path, found or "", said)


def _true_format(path: Path) -> str | None:
    """The format by the file's ending, but for workbooks named as text and texts named as workbooks."""
    found = format_of(path)
    with path.open("rb") as file:
        start = file.read(4096)
    is_workbook = start.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0"))
    if found == "csv" and is_workbook:
        return "excel"
    if found == "excel" and not is_workbook and start and b"\x00" not in start:
        return "csv"
    return found


def _open_excel(path: Path, said: Mapping[str, str]) -> _Opened:
    from ingest.excel_reader import sheet_names, sheet_rows

    names = sheet_names(path)
    sheet = max(names, key=lambda name: len(sheet_rows(path, name)))
    rows = sheet_rows(path, sheet)
    decimal = (
        "," if any(isinstance(c, str) and _DECIMAL_COMMA.fullmatch(c.strip()) for row in rows for c in row) else "."
    )
    numbers = [sum(_is_number(c, decimal) for c in row) for row in rows]
    usual = max(set(numbers) - {0}, key=numbers.count, default=0)
    start = next((i for i, n in enumerate(numbers) if n and n >= usual), 0)
    above = [i for i in range(start) if any(str(c).strip() for c in rows[i])]
    header = [str(c).strip() for c in rows[above[-1]]] if above else []
    units: list[str] = []
    if len(above) > 1 and are_units(header):
        header, units = [str(c).strip() for c in rows[above[-2]]], header
    guessed = guess_columns(header, units, len(rows[start]) if rows else 0, said)
    skip = start - (len(header) > 0) - (len(units) > 0)
    options = {"sheet": sheet, "skip_rows": skip, "header": bool(header), "unit_row": bool(units)}
    options |= {} if decimal == "." else {"decimal": decimal}
    facts = harvest_rows(rows[:skip])
    return _Opened(path, "excel", options, _with_time_first(guessed), rows[start:], by_key(facts))


def _is_number(cell: Any, decimal: str) -> bool:
    if isinstance(cell, bool) or cell is None:
        return False
    if isinstance(cell, str):
        return is_number(cell.strip(), decimal)
    return True


def _open_arrays(path: Path, found: str, said: Mapping[str, str]) -> _Opened:
    mapping = FileMapping(RECORDING, found, {}, None, {}, {}, {})
    file = open_columns(path, found, mapping)
    names = file.names()
    separator = "." if found == "matlab" else "/"
    short = [n.rsplit(separator, 1)[-1] for n in names]
    guessed = guess_columns(
        [s if short.count(s) == 1 else n for s, n in zip(short, names, strict=True)],
        [file.unit(n) or "" for n in names],
        len(names),
        said,
    )
    columns: list[GuessedColumn] = []
    for name, guess in zip(names, guessed, strict=False):
        shape = file.shape(name) if isinstance(file, ArrayFile) else ()
        matrix = len(shape) == 2 and 1 < min(shape) <= _MOST_MATRIX_COLUMNS
        if matrix and guess.meaning is None:
            columns += [GuessedColumn(name, guess.unit, None, index=i) for i in range(min(shape))]
        else:
            columns.append(replace(guess, column=name))
    about = ["the arrays of the file; a column of a matrix is index = 0, 1, …"] if isinstance(file, ArrayFile) else []
    about += [f'"{name}": {" × ".join(map(str, file.shape(name)))}' for name in names if isinstance(file, ArrayFile)]
    is_hdf5 = found == "hdf5" or (found == "matlab" and path.read_bytes()[:4] == b"\x89HDF")
    facts = by_key(harvest_hdf5(path)) if is_hdf5 else {}
    own_time = found in ("tdms", "uff")
    return _Opened(path, found, {}, tuple(columns), (), facts, tuple(about), own_time)


def _with_time_first(columns: Sequence[GuessedColumn]) -> tuple[GuessedColumn, ...]:
    """Columns of a file without any names: the first is taken for the time, as nearly every recorder writes it."""
    if columns and all(isinstance(c.column, int) for c in columns) and not any(c.meaning for c in columns):
        return (replace(columns[0], meaning=TIME), *columns[1:])
    return tuple(columns)


def _table(opened: _Opened, kind: str, chosen: Mapping[str, GuessedColumn]) -> Draft:
    """The draft of a table of lives, of a frequency response or of a relaxation."""
    remarks: dict[str, str] = {}
    questions: list[Question] = []
    columns: dict[str, dict[str, Any]] = {}
    usual = {"lifetime": "s", "voltage": "kV", "test_duration": "s", "frequency": "Hz", "time": "s", "phase": "deg"}
    usual |= {
        TAN_DELTA: "1",
        "temperature": "degC",
        "storage": "MPa",
        "loss": "MPa",
        "relaxation": "MPa",
        "magnitude": "N/mm",
    }
    for name, column in chosen.items():
        entry: dict[str, Any] = _place(column)
        if name in ("failed", "censored"):
            entry |= _meanings(column, opened)
            questions.append(Question(f"columns.{name}.failed_values", "which values mean failed, which censored", []))
        elif name not in _WORDS:
            entry["unit"] = column.unit or usual[name]
            if not column.unit and name != TAN_DELTA:
                questions.append(_ask_unit(f"columns.{name}", column, usual[name]))
        columns[name] = entry
    about: dict[str, Any] = {"recording_id": "{stem}"}
    each = _several(opened, chosen) if kind in (FREQUENCY_RESPONSE, RELAXATION) else None
    _take(opened.facts, about, remarks, ("operator", "material"))
    if kind != LIFETIMES:
        _take(opened.facts, about, remarks, ("specimen_id",))
        sizes = ("film_length_mm", "film_width_mm", "film_thickness_mm")
        if all(size in opened.facts for size in sizes):
            _take(opened.facts, about, remarks, sizes)
        if "specimen_id" not in about:
            about["specimen_id"] = "{stem}"
            questions.append(Question("recording.specimen_id", "name of the specimen", opened.path.stem))
    elif "configuration" not in chosen:
        about["configuration"] = "{stem}"
        questions.append(Question("recording.configuration", "how the films are built", opened.path.stem))
    content = {"kind": kind, **_format_keys(opened), "columns": columns, "recording": about}
    if each is not None:
        content["select"] = [each]
        about["recording_id"] = "{stem}-{each}"
        remarks["recording.specimen_id"] = "all temperatures of one specimen make a master curve"
    unmapped = tuple(c for c in opened.columns if c not in chosen.values())
    return Draft(opened.path, content, remarks, tuple(questions), unmapped, opened.about)


def _recording(opened: _Opened) -> Draft:
    """The draft of a recording: its samples are read with what is known so far; their shape says which test it is."""
    remarks: dict[str, str] = {}
    questions: list[Question] = []
    opened = _by_content(opened)
    time_of = next((c for c in opened.columns if c.meaning == TIME), None)
    content: dict[str, Any] = {"kind": RECORDING, **_format_keys(opened)}
    rate = opened.facts.get(SAMPLE_RATE)
    counts = time_of is not None and time_of.column in ("X", "x") and rate is not None
    about: dict[str, Any] = {"recording_id": "{stem}"}
    has_dates = False
    if time_of is not None and not counts:
        content["time"] = _place(time_of) | _time_keys(time_of, opened, questions)
        has_dates = content["time"].get("format") not in (None, "elapsed", "mm:ss", "time_of_day")
        has_dates |= content["time"].get("origin") is not None
    elif rate is not None:
        content["time"] = {SAMPLE_RATE: rate.value}
        remarks[f"time.{SAMPLE_RATE}"] = f"the file: {rate.words}"
    elif not opened.has_own_time:
        content["time"] = {SAMPLE_RATE: None}
        questions.append(Question(f"time.{SAMPLE_RATE}", "samples in a second: the file has no times"))
    about_times = tuple(questions)
    content["columns"], questions = _channels(opened, about_times)
    shape, unread = _shape(opened, content)
    if (shape.protocol, shape.loading) == ("sphs", "other") and any(c.is_asked for c in opened.columns):
        opened = _as_electrical(opened)
        time_of = next((c for c in opened.columns if c.meaning == TIME), None)
        content["columns"], questions = _channels(opened, about_times)
        shape = replace(shape, loading="electrical")
    about |= {"protocol": shape.protocol, "loading": shape.loading}
    remarks["recording.protocol"] = f"{shape.certainty}: {shape.seen}"
    if shape.certainty != SURE:
        names = tuple(dict.fromkeys(p for p, _ in PROTOCOLS))
        questions.append(Question("recording.protocol", f"which test it is ({shape.seen})", shape.protocol, names))
    raw = any(c.is_raw for c in opened.columns)
    for key, value in shape.constants.items():
        if raw and key.endswith("_kv"):
            continue  # measured in volts of a monitor, whose scale is not known
        about[key] = value
        remarks[f"recording.{key}"] = "measured from the trace"
    facts = ("specimen_id", "operator", "material", "film_length_mm", "film_width_mm", "film_thickness_mm")
    _take(opened.facts, about, remarks, facts)
    if "specimen_id" not in about:
        about["specimen_id"] = "{stem}"
        questions.append(Question("recording.specimen_id", "name of the specimen", opened.path.stem))
    _ask_start(opened, content, about, remarks, questions, has_dates)
    content["recording"] = about
    mapped = [c for c in opened.columns if c.meaning is not None and not (counts and c is time_of)]
    unmapped = tuple(c for c in opened.columns if c not in mapped)
    return Draft(opened.path, content, remarks, tuple(questions), unmapped, opened.about, shape, unread)


def _channels(opened: _Opened, asked: Sequence[Question]) -> tuple[dict[str, Any], list[Question]]:
    """The tables of the channels, and the questions so far with those about them."""
    questions = list(asked)
    columns = {
        str(c.meaning): _place(c) | _unit_keys(c, questions) for c in opened.columns if c.meaning not in (None, TIME)
    }
    return columns, questions


def _as_electrical(opened: _Opened) -> _Opened:
    """A multisine on two channels of a scope: a voltage monitor and a load cell; nobody here drives anything else so."""
    names = {"input": "voltage", "output": "force"}
    columns = tuple(
        replace(c, meaning=names[str(c.meaning)], is_raw=True) if c.meaning in names and c.is_asked else c
        for c in opened.columns
    )
    return replace(opened, columns=columns)


def _ask_start(
    opened: _Opened,
    content: dict[str, Any],
    about: dict[str, Any],
    remarks: dict[str, str],
    questions: list[Question],
    has_dates: bool,
) -> None:
    """When the test began: what the file says, with the zone where it has none; else the time of the file's change."""
    said = opened.facts.get(STARTED_AT)
    if has_dates:
        return  # the first sample says it
    if said is not None:
        about[STARTED_AT] = said.value
        remarks[f"recording.{STARTED_AT}"] = f"the file: {said.words}"
        if datetime.fromisoformat(said.value).tzinfo is None:
            content.setdefault("time", {})["zone"] = "UTC"
            questions.append(Question("time.zone", "time zone of the clock that wrote the date", "UTC"))
        return
    changed = datetime.fromtimestamp(int(opened.path.stat().st_mtime), UTC).isoformat()
    about[STARTED_AT] = changed
    questions.append(Question(f"recording.{STARTED_AT}", "start of the test (this is the file's last change)", changed))


def _shape(opened: _Opened, content: Mapping[str, Any]) -> tuple[Shape, str]:
    """The test that the samples show; by the names of the channels alone where they cannot be read, with the reason."""
    columns = {
        name: {k: _ANY_SCALE if k == "scale" and v is None else v for k, v in c.items()}
        for name, c in content["columns"].items()
    }
    time = content.get("time")
    if time is not None:
        time = {k: 1.0 if v is None else v for k, v in time.items()}
    start = {"recording_id": "draft", STARTED_AT: "2020-01-01T00:00:00+00:00"}
    if time is not None and time.get("format") not in (None, "elapsed", "mm:ss", "time_of_day"):
        start = {"recording_id": "draft"}
    probe = {**content, "columns": columns, "recording": start} | ({} if time is None else {"time": time})
    reason = ""
    traces: dict[str, Trace] = {}
    try:
        mapping = FileMapping.parse(probe, stem="draft", suffix=opened.path.suffix, source="draft")
        raw = assemble(open_columns(opened.path, opened.format, mapping), mapping, where=opened.path.name)
        for channel in raw.channels:
            unit = QUANTITIES[channel.quantity].unit
            values = conversion(channel.unit, unit).apply(channel.values)
            traces[channel.quantity] = Trace((channel.time_ns - channel.time_ns[0]) * 1e-9, values)
    except DealabError as error:
        reason = str(error)
    if traces:
        return find_shape(traces), ""
    by_name = find_shape({name: Trace(np.arange(4.0), np.arange(4.0)) for name in columns})
    seen = "by the names of the columns alone: their samples cannot be read"
    return replace(by_name, certainty=UNSURE, seen=seen, constants={}), reason


def _by_content(opened: _Opened) -> _Opened:
    """What names leave open is taken from the numbers: a column of even steps is the time, a smooth one the drive."""
    columns = list(opened.columns)
    known = {c.meaning for c in columns}
    free = [i for i, c in enumerate(columns) if c.meaning is None]
    nameless = all(isinstance(c.column, int) for c in columns)
    timed = (TIME in known and not nameless) or opened.has_own_time or SAMPLE_RATE in opened.facts
    if not free or (timed and known - {TIME, None}):
        return opened
    try:
        mapping = FileMapping(RECORDING, opened.format, dict(opened.options), None, {}, {}, {})
        file = open_columns(opened.path, opened.format, _wanting(mapping, columns))
        numbers = {i: _numbers(file, columns[i]) for i in range(len(columns)) if i in free or not timed}
    except DealabError:
        return opened
    usable = {i: v[np.isfinite(v)] for i, v in numbers.items() if v is not None and np.isfinite(v).sum() > 3}
    if not timed:
        even = [i for i, v in usable.items() if _is_even(v)]
        if even:
            columns = [replace(c, meaning=None) if c.meaning == TIME else c for c in columns]
            columns[even[0]] = replace(columns[even[0]], meaning=TIME)
    free = [i for i, c in enumerate(columns) if c.meaning is None and i in usable and not _is_even(usable[i])]
    if not {c.meaning for c in columns} - {TIME, None}:
        _name_by_shape(columns, free, usable)
    return replace(opened, columns=tuple(columns))


def _name_by_shape(columns: list[GuessedColumn], free: Sequence[int], values: Mapping[int, Any]) -> None:
    """Nameless columns: one alone is a force, of two the smoother one drives; what is in volts is of no known kind."""
    if len(free) == 1:
        columns[free[0]] = replace(columns[free[0]], meaning="force", is_asked=True)
    elif len(free) >= 2:
        drive, answer = sorted(free[:2], key=lambda i: _roughness(values[i]))
        volts = any((columns[i].unit or "").lower() in ("v", "volt", "volts") for i in (drive, answer))
        volts |= all(
            columns[i].unit is None and re.match("ch", str(columns[i].column).lower()) for i in (drive, answer)
        )
        names = ("input", "output") if volts else ("displacement", "force")
        for i, name in zip((drive, answer), names, strict=True):
            columns[i] = replace(columns[i], meaning=name, is_asked=True)


def _roughness(values: Any) -> float:
    span = float(np.ptp(values))
    return float(np.median(np.abs(np.diff(values, 2)))) / span if span > 0 else np.inf


def _is_even(values: Any) -> bool:
    steps = np.diff(values)
    middle = float(np.median(steps))
    return middle > 0 and float(np.median(np.abs(steps - middle))) <= _EVEN * middle and bool((steps > 0).all())


def _wanting(mapping: FileMapping, columns: Sequence[GuessedColumn]) -> FileMapping:
    from ingest.mapping import ColumnMapping

    return replace(mapping, columns={str(i): ColumnMapping(c.column, index=c.index) for i, c in enumerate(columns)})


def _numbers(file: ColumnFile, column: GuessedColumn) -> Any:
    try:
        return file.numbers(column.column, column.index).values
    except DealabError:
        return None


def _response_columns(columns: Sequence[GuessedColumn]) -> dict[str, GuessedColumn]:
    """The columns of a table of a modulus or stiffness over frequency; empty where it is none."""
    stiff = [c for c in columns if c.unit in _MODULI]
    storage, loss, magnitude = (_first(stiff, pattern) for pattern in (_STORAGE, _LOSS, _MAGNITUDE))
    ratio = _first([c for c in columns if c.unit in ("1", "", None)], _TAN_DELTA)
    phase = _first([c for c in columns if c.unit in ("deg", "°", "rad", None) and c is not ratio], _PHASE)
    if storage is not None and loss is not None and storage is not loss:
        pair = {"storage": storage, "loss": loss}
    elif magnitude is not None and phase is not None:
        pair = {"magnitude": magnitude, "phase": phase}
    elif storage is not None and ratio is not None:
        pair = {"storage": storage, TAN_DELTA: ratio}
    elif magnitude is not None and ratio is not None:
        pair = {"magnitude": magnitude, TAN_DELTA: ratio}
    else:
        return {}
    others = [c for c in columns if c not in pair.values()]
    frequency = next((c for c in others if c.unit in ("Hz", "rad/s", "kHz")), None) or _first(others, _FREQUENCY)
    if frequency is None:
        return {}
    warm = next((c for c in others if c.meaning == "temperature"), None)
    return {"frequency": frequency, **pair} | ({} if warm is None else {"temperature": warm})


def _relaxation_columns(columns: Sequence[GuessedColumn]) -> dict[str, GuessedColumn]:
    """The columns of a table of a relaxing modulus over time; empty where it is none."""
    time = next((c for c in columns if c.meaning == TIME), None)
    modulus = _first([c for c in columns if c.unit in _MODULI and c.meaning is None], _RELAXED)
    if time is None or modulus is None:
        return {}
    warm = next((c for c in columns if c.meaning == "temperature"), None)
    return {"time": time, "relaxation": modulus} | ({} if warm is None else {"temperature": warm})


def _several(opened: _Opened, chosen: Mapping[str, GuessedColumn]) -> dict[str, Any] | None:
    """The selection of each temperature where a table holds several sweeps; None where it holds one."""
    warm = chosen.get("temperature")
    if warm is None:
        return None
    decimal = opened.options.get("decimal", ".")
    cells = [read_cell(str(cell).strip(), decimal) for cell in opened.cells(warm)]
    values = np.sort([c.value for c in cells if c is not None and np.isfinite(c.value)])
    gaps = np.diff(values)
    if values.size < 2 or values[-1] - values[0] < _FEWEST_DEGREES:
        return None
    wide = gaps[gaps > max(1.0, 5 * float(np.median(gaps)))]
    if not wide.size:
        return None
    within = max(
        (float(np.ptp(group)) for group in np.split(values, np.flatnonzero(np.isin(gaps, wide)) + 1)), default=0
    )
    tolerance = next((t for t in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0) if t >= within), None)
    if tolerance is None or 2 * tolerance >= float(wide.min()):
        return None
    return {"column": warm.column, "each": True, "tolerance": tolerance}


def _lifetime_columns(opened: _Opened) -> dict[str, GuessedColumn]:
    """The columns of a table of lives by what they are; empty where nothing says that it is one.

    It is one where a column is named a life, where outcomes stand beside times, or specimens beside times that do not
    run.
    """
    columns = opened.columns
    named = next((c for c in columns if c.unit != "kV" and re.search(_LIFE, _label(c))), None)
    outcome = _first([c for c in columns if c is not named], _FAILED)
    life = named or next((c for c in columns if outcome is not None and c.meaning == TIME and c is not outcome), None)
    channels = {c.meaning for c in columns} & {"force", "displacement", "leakage_current"}
    if life is None and not channels and (_first(columns, _SPECIMEN) or _first(columns, _CONFIGURATION)):
        life = next((c for c in columns if c.meaning == TIME and not _runs(opened.cells(c), opened.options)), None)
    if life is None or (named is None and channels):
        return {}
    found = {"lifetime": life} | ({} if outcome is None else {"failed": outcome})
    for name, pattern in (
        ("voltage", None),
        ("configuration", _CONFIGURATION),
        ("specimen_id", _SPECIMEN),
        ("count", _COUNT),
        ("test_duration", _PLANNED),
    ):
        rest = [c for c in columns if c not in found.values()]
        column = next((c for c in rest if c.meaning == name), None) if pattern is None else _first(rest, pattern)
        found |= {} if column is None else {name: column}
    return found


def _runs(cells: Sequence[Any], options: Mapping[str, Any]) -> bool:
    """Whether times go up from row to row, as samples do."""
    found = [read_cell(str(c).strip(), options.get("decimal", ".")) for c in cells]
    values = [f.value for f in found if f is not None]
    return len(values) > 2 and all(b >= a for a, b in itertools.pairwise(values))


def _first(columns: Sequence[GuessedColumn], pattern: str) -> GuessedColumn | None:
    return next((c for c in columns if re.search(pattern, _label(c))), None)


def _label(column: GuessedColumn) -> str:
    """A column's name in small letters without what stands in brackets."""
    return re.sub(r"\s*[\[(/].*$", "", str(column.column)).strip().lower()


def _format_keys(opened: _Opened) -> dict[str, Any]:
    """The format's table, and its name where the file's ending says another one."""
    named = {} if format_of(opened.path) == opened.format else {"format": opened.format}
    return {**named, opened.format: dict(opened.options)}


def _place(column: GuessedColumn) -> dict[str, Any]:
    place: dict[str, Any] = {"column": column.column}
    return place if column.index is None else place | {"index": column.index}


def _unit_keys(column: GuessedColumn, questions: list[Question]) -> dict[str, Any]:
    """The unit of a channel, and the scale of a sensor that is recorded in volts."""
    name, label = str(column.meaning), f"columns.{column.meaning}"
    usual = "V" if QUANTITIES[name].unit == ANY else QUANTITIES[name].unit
    if column.is_asked:
        questions.append(Question(f"{label}.column", f"which column is the {name}", column.column))
    if column.is_raw:
        text = f"how many {usual} are 1 {column.unit or 'V'} of {column.column} (value = scale × volts + offset)"
        questions.append(Question(f"{label}.scale", text))
        return {"unit": usual, "scale": None}
    if column.unit is None:
        questions.append(_ask_unit(label, column, usual))
    return {"unit": column.unit or usual}


def _ask_unit(label: str, column: GuessedColumn, usual: str) -> Question:
    return Question(f"{label}.unit", f'unit of "{column.column}": the file does not say', usual)


def _time_keys(time: GuessedColumn, opened: _Opened, questions: list[Question]) -> dict[str, Any]:
    """Unit of a column of times, or how its dates are written."""
    cells = [c for c in opened.cells(time) if str(c).strip()]
    first = cells[0] if cells else ""
    if not isinstance(first, float | int):
        keys = _text_times(cells)
        if keys is not None:
            if keys.get("format") not in ("elapsed", "mm:ss") and not _has_zone(first):
                keys["zone"] = "UTC"
                questions.append(Question("time.zone", "time zone of the clock", "UTC"))
            return keys
    origin = _origin(first, opened)
    if origin is not None:
        if origin.get("origin") in ("excel", "matlab"):
            origin["zone"] = "UTC"
            questions.append(Question("time.zone", "time zone of the clock", "UTC"))
        return origin
    unit = time.unit or {"micros": "us", "millis": "ms"}.get(str(time.column).lower())
    if unit is None:
        questions.append(_ask_unit("time", time, "s"))
    return {"unit": unit or "s"}


def _text_times(cells: Sequence[Any]) -> dict[str, Any] | None:
    """The format of times as text; None where they are none."""
    texts = [str(c).strip() for c in cells]
    if moment(cells[0], None) is not None if cells else False:
        return {"format": "iso"}
    for day in ("%d.%m.%Y", "%Y/%m/%d", "%m/%d/%Y", "%d/%m/%Y", "%d-%b-%Y"):
        for clock in ("%H:%M:%S.%f", "%H:%M:%S", "%H:%M:%S:%f", "%H:%M:%S,%f", "%H:%M"):
            if texts and all(moment(text, f"{day} {clock}") is not None for text in texts):
                return {"format": f"{day} {clock}"}
    if texts and re.fullmatch(r"\d{1,2}:\d\d:\d\d([.,]\d+)?", texts[0]):
        return {"format": "time_of_day" if not texts[0].startswith(("0:", "00:")) else "elapsed"}
    if texts and duration_s(texts[0], minutes=True) is not None and ":" in texts[0]:
        return {"format": "mm:ss"}
    return None


def _has_zone(cell: Any) -> bool:
    found = moment(cell, None)
    return found is not None and found.tzinfo is not None


def _origin(first: Any, opened: _Opened) -> dict[str, Any] | None:
    """The origin of times that are counted from a calendar's day, by their size; None for times since the start."""
    try:
        value = float(str(first).replace(opened.options.get("decimal", "."), "."))
    except ValueError:
        return None
    for low, high, keys in (
        (1e12, 4e12, {"unit": "ms", "origin": "unix"}),
        (1e9, 2.5e9, {"unit": "s", "origin": "unix"}),
        (3e9, 4.2e9, {"unit": "s", "origin": "labview"}),
        (7.2e5, 7.6e5, {"origin": "matlab"}),
        (3.6e4, 6e4, {"origin": "excel"}),
    ):
        if low < value < high and not (keys.get("origin") == "excel" and value.is_integer()):
            return dict(keys)
    return None


def _meanings(failed: GuessedColumn, opened: _Opened) -> dict[str, list[Any]]:
    """The values of a column of failures, as they seem to be meant: which ones depends on the table."""
    cells = opened.cells(failed)
    values = list(dict.fromkeys(int(c) if isinstance(c, float) and c.is_integer() else c for c in cells))[:8] or [1, 0]
    plain = [v if isinstance(v, int) and not isinstance(v, bool) else str(v) for v in values]
    turned = re.search("cens|runout|surv", str(failed.column).lower()) is not None
    yes = [v for v in plain if (re.match(_YES, str(v).strip().lower()) is not None) != turned]
    return {"failed_values": yes, "censored_values": [v for v in plain if v not in yes]}


def _take(facts: Mapping[str, Fact], about: dict[str, Any], remarks: dict[str, str], keys: Sequence[str]) -> None:
    for key in keys:
        if key in facts:
            about[key] = facts[key].value
            remarks[f"recording.{key}"] = f"the file: {facts[key].words}"
