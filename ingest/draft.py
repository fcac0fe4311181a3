"""A mapping for a file that has none: what could be read from the file, what was inferred, and what has to be asked.

`dealab inspect` shows the draft, `dealab add` asks its questions and writes it. Only here anything is guessed, and each
guess is said in a comment. Does not belong here: the text of the TOML (`ingest.draft_text`), which test a trace shows
(`ingest.shapes`), what the lines above a table say (`ingest.harvest`), how the file is opened (`ingest.draft_files`), what its columns
and times are (`ingest.draft_columns`, `ingest.draft_times`).
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ingest.assemble import assemble
from ingest.compressed import find_stem, find_suffix
from ingest.draft_columns import (
    find_lifetime_columns,
    find_meanings,
    find_own_response,
    find_relaxation_columns,
    find_response_columns,
    find_specimens,
    is_counted,
)
from ingest.draft_files import (
    Opened,
    is_workbook,
    make_format_keys,
    map_each_column,
    name_sheets,
    only_sheet,
    open_file,
    open_sheets,
    read_numbers,
)
from ingest.draft_parts import find_beside, find_parts, find_runs, join_shapes, name_parts
from ingest.draft_tables import (
    CLOCKS_OF,
    ask_censored_modes,
    ask_outcomes,
    find_clock,
    find_modes,
    find_state,
    find_warm_groups,
    is_written_once,
    say_frequency,
    select_isotherms,
    select_sweeps,
)
from ingest.draft_text import toml_text
from ingest.draft_times import ask_order, find_date_format, find_other_order, make_time_keys, prefer_order
from ingest.excel_reader import SHEET
from ingest.harvest import SAMPLE_RATE, STARTED_AT, Fact, name_fact
from ingest.mapping import FILLED_DOWN, WORDS, FileMapping
from ingest.mapping_keys import FREQUENCY_RESPONSE, LIFETIMES, MEAN, RECORDING, RELAXATION, TAN_DELTA
from ingest.meanings import NOTHING, TIME, GuessedColumn, counts_rows, is_sensor_unit
from ingest.parts import content_of_part
from ingest.questions import Question, ask_unit, make_place, make_unit_keys, name_column
from ingest.read import open_columns
from ingest.shapes import SURE, UNSURE, Shape, Trace, find_shape
from schemas.errors import DealabError, RefusedError
from schemas.metadata import RECORDING_ID
from schemas.protocols import PROTOCOLS
from schemas.quantities import QUANTITIES
from schemas.units import conversion

_SIZES = ("film_length_mm", "film_width_mm", "film_thickness_mm")
"""Sizes of a film without which no modulus becomes a stiffness."""
_ANY_SCALE = 2.0
"""Stands for the scale of a sensor that is not known yet: the shape of a trace does not depend on it."""
_LONGEST_NAME = 60
"""Characters of a name made from that of a file: what tells its parts apart follows."""
_LOWEST_DRIVE_V = 20.0
"""A voltage that never goes beyond it drives no film: it is what the monitor of a high-voltage amplifier puts out (up to 10 V)."""
_EVEN = 1e-3
"""Largest spread of the steps of a column of times, in steps, which no column of samples has."""


@dataclass(frozen=True)
class Wanted:
    """What a person says of a file as a whole: its kind, the sheet of a workbook, and which column of a table is what."""

    kind: str | None = None
    sheet: str | None = None
    roles: Mapping[str, str] = field(default_factory=dict)


NOTHING_SAID = Wanted()


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
    told : what was chosen, such as a sheet
    """

    path: Path
    content: Mapping[str, Any]
    remarks: Mapping[str, str] = field(default_factory=dict)
    questions: tuple[Question, ...] = ()
    unmapped: tuple[GuessedColumn, ...] = ()
    about: tuple[str, ...] = ()
    shape: Shape | None = None
    unread: str = ""
    told: tuple[str, ...] = ()

    def as_toml(self) -> str:
        """The text of the TOML; what has to be checked is marked `CHECK`."""
        asked = {q.key: q.text for q in self.questions}
        unmapped = [(c.column, c.unit, c.name) for c in self.unmapped]
        return toml_text(self.path.name, self.content, self.remarks, asked, unmapped, self.about)


def draft_mapping(path: Path) -> str:
    """The text of a TOML that maps the file, with the guesses marked. Raises `RefusedError` when it cannot be read."""
    return make_draft(path).as_toml()


def make_draft(path: Path, said: Mapping[str, str] = MappingProxyType({}), wanted: Wanted = NOTHING_SAID) -> Draft:
    """The draft of a mapping.

    Parameters
    ----------
    path : the data file
    said : what a person says that columns are, by name or number: a quantity, `time` or `nothing`
    wanted : what else a person says of the file

    Raises
    ------
    RefusedError : the file cannot be read, or is no table of numbers, or holds no columns of the kind that is said
    """
    opened, others = _open(path, said, wanted)
    kinds = _find_kinds(opened, wanted)
    if wanted.kind is not None and wanted.kind != RECORDING and wanted.kind not in kinds:
        known = ", ".join(str(c.column) for c in opened.columns[:20])
        raise RefusedError(
            f"no columns of a table of kind {wanted.kind} are recognised",
            where=path.name,
            expected=f"columns that are named as such; there are {known}",
            remedy="Say what they are, such as --yes Zyklen=lifetime Status=failed",
        )
    if wanted.kind == RECORDING or not kinds:
        draft = _recording(opened)
        draft = replace(draft, questions=tuple(q for q in draft.questions if q.key not in said))
    else:
        kind = wanted.kind or next(iter(kinds))
        draft = _table(opened, kind, kinds[kind])
    return replace(draft, about=(*draft.about, *others), told=(*draft.told, *others))


def _find_kinds(opened: Opened, wanted: Wanted) -> dict[str, dict[str, GuessedColumn]]:
    """The kinds of table that a file may be, the likeliest first, each with its columns."""
    found = {
        FREQUENCY_RESPONSE: find_own_response(opened) or find_response_columns(opened.columns),
        LIFETIMES: find_lifetime_columns(opened, wanted.roles),
        RELAXATION: find_relaxation_columns(opened.columns),
    }
    return {kind: chosen for kind, chosen in found.items() if chosen}


def _open(path: Path, said: Mapping[str, str], wanted: Wanted) -> tuple[Opened, tuple[str, ...]]:
    """The file, of a workbook the sheet that is meant: the one that is said, else one that holds a table, else the longest."""
    if not is_workbook(path):
        return open_file(path, said), ()
    sheets = open_sheets(path, said)
    if wanted.sheet is not None:
        chosen = next((one for one in sheets if wanted.sheet in name_sheets(one)), None)
        if chosen is None:
            shown = ", ".join(f'"{name}"' for one in sheets for name in name_sheets(one))
            raise RefusedError(f'there is no sheet "{wanted.sheet}"', where=path.name, expected=f"one of {shown}")
        chosen = only_sheet(path, wanted.sheet, said)
    else:
        kinds = [(one, _find_kinds(one, wanted)) for one in sheets]
        tables = [one for one, found in kinds if (wanted.kind in found if wanted.kind else found) and len(one.rows) > 1]
        chosen = next(iter(tables), sheets[0])
    names = name_sheets(chosen)
    others = [name for one in sheets for name in name_sheets(one) if name not in names]
    if not others and len(names) == 1:
        return chosen, ()
    read = (
        "the sheet " + names[0] if len(names) == 1 else f"{len(names)} sheets, one below the other: {', '.join(names)}"
    )
    return chosen, (
        f"read is {read}" + (f"; not {', '.join(others)} (--yes sheet=NAME reads another)" if others else ""),
    )


def _table(opened: Opened, kind: str, chosen: Mapping[str, GuessedColumn]) -> Draft:
    """The draft of a table of lives, of a frequency response or of a relaxation."""
    remarks: dict[str, str] = {}
    questions: list[Question] = []
    columns: dict[str, dict[str, Any]] = {}
    usual = {"lifetime": "s", "voltage": "kV", "test_duration": "s", "frequency": "Hz", "time": "s", "phase": "deg"}
    usual |= {
        "alive_at": "s",
        "entered": "s",
        "breakdown_voltage": "kV",
        "humidity": "1",
        TAN_DELTA: "1",
        "temperature": "degC",
        "storage": "MPa",
        "loss": "MPa",
        "relaxation": "MPa",
        "magnitude": "N/mm",
        "response": "N/mm",
    }
    for name, column in chosen.items():
        entry: dict[str, Any] = make_place(column)
        if name in ("failed", "censored"):
            entry |= find_meanings(column, opened, [chosen[own] for own in ("lifetime", "ended") if own in chosen])
            questions.append(ask_outcomes(f"columns.{name}.failed_values", entry))
        elif name in ("started", "ended"):
            cells = [cell for cell in opened.cells(column) if str(cell).strip()]
            written = find_date_format(cells)
            if written is None:
                raise RefusedError(
                    f"{name_column(column)} is said to be {name}", where=opened.path.name, expected="a column of dates"
                )
            entry["format"] = written
            if (other := find_other_order(cells, entry["format"])) is not None:
                entry["format"] = prefer_order(entry["format"], other, opened)
                questions.append(ask_order(f"columns.{name}.format", cells[0], entry["format"]))
            if name == "ended" and (until := find_state(opened)) is not None:
                entry["open_until"] = until.value
                remarks["columns.ended.open_until"] = f"the file: {until.words}"
        elif name == "lifetime" and (keys := find_clock(column, opened)) is not None:
            entry |= keys
            clock = keys.get("format", "hh:mm:ss")
            if clock is None:
                first = next(str(cell) for cell in opened.cells(column) if str(cell).count(":") == 1)
                questions.append(Question(f"columns.{name}.format", f"what {first} means", None, ("hh:mm", "mm:ss")))
            else:
                remarks[f"columns.{name}.column"] = CLOCKS_OF[clock]
        elif name == "lifetime" and (unit := is_counted(column)) is not None:
            entry["unit"] = unit
            if "frequency" not in chosen:
                columns["frequency"] = say_frequency(opened, remarks, questions)
        elif name not in (*WORDS, "count"):
            entry["unit"] = column.unit or usual[name]
            if not column.unit and name != TAN_DELTA:
                questions.append(ask_unit(f"columns.{name}", column, usual[name]))
        if name in FILLED_DOWN and is_written_once(column, opened, kind):
            entry["fill_down"] = True
            remarks[f"columns.{name}.fill_down"] = "written once for each block of rows"
        columns[name] = entry
    if kind == LIFETIMES and "failure_mode" not in columns:
        of_modes = find_modes(opened, chosen, columns.get("failed", {}))
        if of_modes is not None:
            chosen = {**chosen, "failure_mode": of_modes}
            columns["failure_mode"] = make_place(of_modes)
    if "failure_mode" in chosen and (ask := ask_censored_modes(opened, chosen["failure_mode"])) is not None:
        columns["failure_mode"]["censored_modes"] = ask.suggestion
        questions.append(ask)
    about: dict[str, Any] = {"recording_id": _own_name(opened.path)}
    each, repeated, remark = (
        select_isotherms(opened, chosen) if kind in (FREQUENCY_RESPONSE, RELAXATION) else (None, False, "")
    )
    _take(opened.facts, about, remarks, ("operator", "material"))
    if kind != LIFETIMES:
        _take(opened.facts, about, remarks, ("specimen_id",))
        told = [size for size in _SIZES if size in opened.facts]
        if len(told) == len(_SIZES):
            _take(opened.facts, about, remarks, told)
            questions += _ask_units_of_sizes(opened)
        if "specimen_id" not in about:
            about["specimen_id"] = "{stem}"
            questions.append(Question("recording.specimen_id", "name of the specimen", find_stem(opened.path)))
        if told and len(told) < len(_SIZES):
            words = " and ".join(opened.facts[size].words for size in told)
            lacking = " and ".join(size for size in _SIZES if size not in told)
            kept = remarks.get("recording.specimen_id", "")
            remarks["recording.specimen_id"] = "; ".join(
                filter(None, [kept, f"a stiffness in N/mm needs {lacking} beside what the file says ({words})"])
            )
    else:
        about["campaign"] = "{stem}"
        remarks["recording.campaign"] = "the page of a campaign shows its survival curves"
    if kind == LIFETIMES and "configuration" not in chosen:
        about["configuration"] = "{stem}"
        questions.append(Question("recording.configuration", "how the films are built", find_stem(opened.path)))
    sweeps = select_sweeps(opened, chosen) if kind == FREQUENCY_RESPONSE else None
    selections = [s for s in (sweeps, each) if s is not None]
    beside = find_warm_groups(opened, chosen) if kind in (FREQUENCY_RESPONSE, RELAXATION) and not selections else []
    content = {"kind": kind, **make_format_keys(opened), "columns": columns, "recording": about}
    content |= {"repeated": MEAN} if repeated and not beside else {}
    content |= {"select": chosen_rows} if (chosen_rows := selections or beside) else {}
    if each is not None or beside:
        about["recording_id"] = about["recording_id"] + "-{each}"
        remarks["recording.specimen_id"] = "all temperatures of one specimen make a master curve"
        remarks |= {"recording.recording_id": remark} if remark else {}
    own = {c["column"] for entry in beside for c in entry.get("columns", {}).values()}
    unmapped = tuple(c for c in opened.columns if c not in chosen.values() and c.column not in own)
    return Draft(opened.path, content, remarks, tuple(questions), unmapped, opened.about)


def _own_name(path: Path) -> str:
    """`{stem}` where a file's name can be that of a recording; else the name with all else in it as hyphens."""
    stem = find_stem(path)
    if RECORDING_ID.fullmatch(stem):
        return "{stem}"
    plain = unicodedata.normalize("NFKD", stem).encode("ascii", "ignore").decode()
    kept = re.sub(r"[^A-Za-z0-9._-]+", "-", plain).strip("-._")[:_LONGEST_NAME]
    return kept or f"recording-{hashlib.sha256(stem.encode()).hexdigest()[:8]}"


def _recording(opened: Opened) -> Draft:
    """The draft of a recording: its samples are read with what is known so far; their shape says which test it is."""
    remarks: dict[str, str] = {}
    questions: list[Question] = []
    opened = _with_monitors(_by_content(opened))
    time_of = next((c for c in opened.columns if c.meaning == TIME), None)
    content: dict[str, Any] = {"kind": RECORDING, **make_format_keys(opened)}
    rate = opened.facts.get(SAMPLE_RATE)
    counts = (
        rate is not None and time_of is not None and (time_of.column in ("X", "x") or _stands_still(opened, time_of))
    )
    about: dict[str, Any] = {"recording_id": _own_name(opened.path)}
    has_dates = False
    if time_of is not None and not counts:
        content["time"] = make_place(time_of) | make_time_keys(time_of, opened, questions)
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
    sheets = name_sheets(opened)
    specimens = find_specimens(opened) if len(sheets) <= 1 else None
    one_sheet = not counts and len(sheets) <= 1 and specimens is None
    runs = find_runs(opened, time_of) if one_sheet else []
    beside = find_beside(opened, time_of) if one_sheet and not runs else []
    tests = runs or beside or (find_parts(opened, time_of) if one_sheet else [])
    tests += [(None, {"column": SHEET, "equals": name}) for name in sheets] if len(sheets) > 1 else []
    shapes = [_shape(opened, content_of_part({**content, "select": [{**e, "part": "-"}]}, "-"))[0] for _, e in tests]
    if parts := name_parts(tests, shapes):
        content["select"] = parts
        about["recording_id"] += "-{each}"
        shape, unread = join_shapes(shapes), ""
        if runs and not opened.has_own_time:
            remarks["recording.recording_id"] = (
                "the file does not say when the later runs began: all have the same start"
            )
    else:
        shape, unread = _shape(opened, content)
    if specimens is not None and "select" not in content:
        content["select"] = [{"column": specimens.column, "each": True}]
        shape, unread = _shape(opened, content | {"select": [_first_of(specimens, opened)]})
        seen = f"{shape.seen}, of each of several specimens in one file"
        shape = replace(shape, seen=seen)
        about |= {"recording_id": about["recording_id"] + "-{each}", "specimen_id": "{each}"}
        remarks["recording.specimen_id"] = f"the file: each name in {specimens.column}"
    if (shape.protocol, shape.loading) == ("sphs", "other") and any(c.is_asked for c in opened.columns):
        opened = _as_electrical(opened)
        time_of = next((c for c in opened.columns if c.meaning == TIME), None)
        content["columns"], questions = _channels(opened, about_times)
        shape, unread = _shape(opened, content)
    if content.get("time", {}).get(SAMPLE_RATE, 0) is None:
        seen = f"the file has no times; if its rows are samples in even steps: {shape.seen}"
        shape = replace(shape, certainty=UNSURE, seen=seen)
    if any(c.is_asked for c in opened.columns):
        seen = f"if the columns are what their numbers suggest: {shape.seen}"
        shape = replace(shape, certainty=UNSURE, seen=seen)  # a test seen in columns that may be others is not known
    unknown = _ask_answers(opened, content["columns"])
    if unknown:
        questions += unknown
        shape = replace(shape, certainty=UNSURE)  # what answers the voltage may be among them
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
    facts = ("specimen_id", "operator", "material", *_SIZES)
    _take(opened.facts, about, remarks, facts if specimens is None else facts[1:])
    if any(c.meaning == "displacement" and c.unit == "mm" for c in opened.columns):
        questions += _ask_units_of_sizes(opened)
    named = all("specimen_id" in part.get("recording", {}) for part in parts) if parts else "specimen_id" in about
    if not named:
        questions.append(Question("recording.specimen_id", "name of the specimen", find_stem(opened.path)))
    about.setdefault("specimen_id", "{stem}")
    _ask_start(opened, content, about, remarks, questions, has_dates)
    content["recording"] = about
    mapped = [c for c in opened.columns if c.meaning is not None and not (counts and c is time_of)]
    clocks = {content.get("time", {}).get(key) for key in ("column", "date_column")} - {None}
    clocks |= {own["column"] for _, e in beside for own in (*e.get("columns", {}).values(), e.get("time")) if own}
    unmapped = tuple(c for c in opened.columns if c not in mapped and c.column not in clocks and c is not specimens)
    return Draft(opened.path, content, remarks, tuple(questions), unmapped, opened.about, shape, unread)


def _channels(opened: Opened, asked: Sequence[Question]) -> tuple[dict[str, Any], list[Question]]:
    """The tables of the channels, and the questions so far with those about them."""
    questions = list(asked)
    columns = {
        str(c.meaning): make_place(c) | make_unit_keys(c, questions)
        for c in opened.columns
        if c.meaning not in (None, TIME)
    }
    return columns, questions


def _ask_units_of_sizes(opened: Opened) -> list[Question]:
    """A question for each size that the file tells by a number alone, as if it were in mm."""
    return [
        Question(f"recording.{fact.key}", f"size in mm (the file says {fact.words}, without a unit)", fact.value)
        for fact in opened.facts.values()
        if fact.lacks_unit
    ]


def _stands_still(opened: Opened, time_of: GuessedColumn) -> bool:
    """Whether times are written in steps so coarse that most stand for several samples: hours, minutes and seconds of a fast recorder."""
    cells = [str(cell).strip() for cell in opened.cells(time_of) if str(cell).strip()]
    return 2 * len(set(cells)) < len(cells)


def _ask_answers(opened: Opened, mapped: Mapping[str, Any]) -> list[Question]:
    """What the other channels of a recorder are, where the voltage alone is known: what a film does under it is in one of them, or nowhere."""
    if set(mapped) != {"voltage"}:
        return []
    others = [c for c in opened.columns if c.meaning is None and c.unit is not None and is_sensor_unit(c.unit)]
    choices = ("force", "displacement", "capacitance", "leakage_current", NOTHING)
    text = f"what {{}} records: {', '.join(choices[:-1])} or {NOTHING}"
    return [Question(str(c.column), text.format(name_column(c)), None, choices) for c in others]


def _first_of(column: GuessedColumn, opened: Opened) -> dict[str, Any]:
    """The selection of the first specimen that a column names."""
    return {"column": column.column, "equals": next(str(c).strip() for c in opened.cells(column) if str(c).strip())}


def _as_electrical(opened: Opened) -> Opened:
    """A multisine on two channels of a scope: a voltage monitor and a load cell; nobody here drives anything else so."""
    names = {"input": "voltage", "output": "force"}
    columns = tuple(
        replace(c, meaning=names[str(c.meaning)], is_raw=True) if c.meaning in names and c.is_asked else c
        for c in opened.columns
    )
    return replace(opened, columns=columns)


def _ask_start(
    opened: Opened,
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
    own = _own_start(opened)
    if own is not None:
        about[STARTED_AT] = own
        remarks[f"recording.{STARTED_AT}"] = "the start of its samples, as the file has it"
        return
    changed = datetime.fromtimestamp(int(opened.path.stat().st_mtime), UTC).isoformat()
    about[STARTED_AT] = changed
    questions.append(Question(f"recording.{STARTED_AT}", "start of the test (this is the file's last change)", changed))


def _own_start(opened: Opened) -> str | None:
    """When the first samples begin in a file that gives them times of its own (TDMS, MDF); None where it does not say."""
    if not opened.has_own_time:
        return None
    mapping = FileMapping(RECORDING, opened.format, dict(opened.options), None, {}, {}, {})
    starts: list[int] = []
    try:
        file = open_columns(opened.path, opened.format, map_each_column(mapping, opened.columns))
        for column in opened.columns:
            own = file.own_time(column.column)
            if own is not None and own.start_ns is not None and own.elapsed_s.size:
                starts.append(own.start_ns + round(float(own.elapsed_s[0]) * 1e9))
    except DealabError:
        return None
    return datetime.fromtimestamp(min(starts) // 1000 / 1e6, UTC).isoformat() if starts else None


def _shape(opened: Opened, content: Mapping[str, Any]) -> tuple[Shape, str]:
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
        mapping = FileMapping.parse(probe, stem="draft", suffix=find_suffix(opened.path), source="draft")
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


def _by_content(opened: Opened) -> Opened:
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
        file = open_columns(opened.path, opened.format, map_each_column(mapping, columns))
        numbers = {i: read_numbers(file, columns[i]) for i in range(len(columns)) if i in free or not timed}
    except DealabError:
        return opened
    usable = {i: v[np.isfinite(v)] for i, v in numbers.items() if v is not None and np.isfinite(v).sum() > 3}
    if not timed:
        rows = [i for i, c in enumerate(columns) if c.meaning in (None, TIME) and not counts_rows(c)]
        even = [i for i, v in usable.items() if i in rows and _is_even(v)]
        if even:
            columns = [replace(c, meaning=None) if c.meaning == TIME else c for c in columns]
            columns[even[0]] = replace(columns[even[0]], meaning=TIME)
    free = [i for i, c in enumerate(columns) if c.meaning is None and i in usable and not _is_even(usable[i])]
    if not {c.meaning for c in columns} - {TIME, None}:
        _name_by_shape(columns, free, usable)
    return replace(opened, columns=tuple(columns))


def _with_monitors(opened: Opened) -> Opened:
    """Voltages of a few volts are those of an amplifier's monitor: how many kilovolts they stand for is not in the file."""
    chosen = [c for c in opened.columns if c.meaning == "voltage" and not c.is_raw and is_sensor_unit(c.unit)]
    if not chosen:
        return opened
    mapping = FileMapping(RECORDING, opened.format, dict(opened.options), None, {}, {}, {})
    try:
        file = open_columns(opened.path, opened.format, map_each_column(mapping, chosen))
        values = {c: read_numbers(file, c) for c in chosen}
    except DealabError:
        return opened
    volts = {c: v * conversion(str(c.unit), "V").scale for c, v in values.items() if v is not None}
    low = [c for c, v in volts.items() if np.isfinite(v).any() and np.nanmax(np.abs(v)) <= _LOWEST_DRIVE_V]
    return replace(opened, columns=tuple(replace(c, is_raw=True) if c in low else c for c in opened.columns))


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


def _take(facts: Mapping[str, Fact], about: dict[str, Any], remarks: dict[str, str], keys: Sequence[str]) -> None:
    for key in keys:
        if key in facts and not facts[key].lacks_unit:
            about[key] = name_fact(facts[key])
            remarks[f"recording.{key}"] = f"the file: {facts[key].words}"
