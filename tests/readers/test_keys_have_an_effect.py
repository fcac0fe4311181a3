"""Every key of a mapping, in every kind of file and every format: what it says can change what is read, or it is an error.

A key that is accepted and then ignored misleads whoever wrote it. For each format a small zoo of files is written, in the notations
that its keys speak of; each key is set beside each of several mappings, and must change what is read of one of the files at least.
"""

from __future__ import annotations

import copy
import functools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import h5py
import nptdms
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from mcap.writer import Writer

from ingest.mapping import FileMapping
from ingest.mapping_keys import (
    COLUMN,
    COVARIATE,
    FORMATS,
    LIFETIMES,
    OPTIONS,
    SELECT,
    TABLE_COLUMN,
    TABLE_COLUMNS,
    TIME,
    TOP,
)
from ingest.parts import list_parts, part_of
from ingest.read import read_raw
from schemas.errors import DealabError
from tests.helpers.xlsx_files import write_xlsx

Content = dict[str, Any]
Path_ = tuple[str, ...]

_ROWS = 24
_T = np.arange(_ROWS) / 10
_NUMBERS: dict[str, Any] = {
    "t": _T,
    "t2": 2 * _T,
    "x": 1.2345 + np.sin(_T),
    "F": 0.1 + 0.05 * np.cos(_T) ** 2,
    "run": np.repeat([1.0, 2.0], _ROWS // 2),
}
_STARTED = "2026-03-01T14:05:00+01:00"


# --- a zoo of files -----------------------------------------------------------------------------------------------------

_CLOCK = "2026-03-01 14:05:{:06.3f}"
TEXTS: Mapping[str, Content] = {
    "plain": {},
    "other units": {"units": "ms;s;mm;mN;;;"},
    "decimal commas": {"decimal": ","},
    "thousands": {"F": lambda i: f"{1234 + i}"[:1] + "," + f"{1234 + i}"[1:]},
    "slower force": {"F": lambda i: "" if i % 2 else f"{_NUMBERS['F'][i]:.4f}"},
    "cut": {"end": ""},
    "values that come back": {"run": lambda i: f"{(1.0, 2.0, 1.2)[i // 4 % 3]}"},
    "times of day": {"t": lambda i: f"14:05:{i / 10:06.3f}"},
    "elapsed": {"t": lambda i: f"00:05:{i / 10:06.3f}"},
    "dates": {"t": lambda i: _CLOCK.format(i / 10)},
    "dates with zone": {"t": lambda i: _CLOCK.format(i / 10) + "+00:00"},
    "since 1970": {"t": lambda i: f"{1_772_370_300 + i / 10:.1f}"},
}


def _write_text(
    path: Path,
    units: str = "s;s;mm;N;;;",
    decimal: str = ".",
    end: str = "\n",
    t: Callable[[int], str] | None = None,
    F: Callable[[int], str] | None = None,
    run: Callable[[int], str] | None = None,
) -> None:
    lines = ["made by a recorder", "t;t2;x;F;run;day;word", units]
    for i in range(_ROWS):
        cells = {name: f"{values[i]:.4f}".replace(".", decimal) for name, values in _NUMBERS.items()}
        cells |= {} if t is None else {"t": t(i)}
        cells |= {} if F is None else {"F": F(i)}
        cells |= {} if run is None else {"run": run(i)}
        lines.append(";".join([*cells.values(), "2026-03-01", '"a;b"' if i % 12 < 6 else "über"]))
    lines[6] = lines[6].replace(lines[6].split(";")[3], "n/a")
    lines.insert(9, "# pause")
    path.write_bytes(("\n".join(lines) + end).encode("cp1252"))


def _write_excel(path: Path, unit: str = "N", slower: bool = False) -> None:
    sheets: dict[str, list[list[Any]]] = {}
    for more, name in enumerate(("first", "second")):
        rows: list[list[Any]] = [["made by a recorder"], [*_NUMBERS, "word"]]
        rows.append(["s" if unit == "N" else "ms", "s", "mm", unit, None, None])
        for i in range(_ROWS):
            cells: list[Any] = [float(values[i]) + more for values in _NUMBERS.values()]
            cells[3] = None if slower and i % 2 else f"{cells[3]:.4f}".replace(".", "," if i == 5 else ".")
            rows.append([*cells, "a" if i % 2 else "b"])
        sheets[name] = rows
    write_xlsx(path, sheets)


def _deep() -> dict[str, Any]:
    return {name: np.asarray(values) + 1 for name, values in _NUMBERS.items()}


_TEXTS = [f"{value:.4f}" if i % 2 else "" for i, value in enumerate(_NUMBERS["F"])]
"""Forces as texts, every second of them empty."""
_NAMED = {"t (ms)": _T, "F (mN)": _NUMBERS["F"]}
"""Columns that are named after their units."""
_MATRIX = np.arange(_ROWS * _ROWS, dtype=float).reshape(_ROWS, _ROWS)


def _write_hdf5(path: Path, unit: str = "") -> None:
    with h5py.File(path, "w") as file:
        for name, values in ({**_NUMBERS, **_NAMED, "m": _MATRIX, "texts": _TEXTS}).items():
            file[name] = values
        for name, values in _deep().items():
            file[f"deep/{name}"] = values
        if unit:
            file["F"].attrs["units"] = unit


def _write_matlab(path: Path) -> None:
    texts = np.array(_TEXTS, dtype=object)
    scipy.io.savemat(path, {**_NUMBERS, "m": _MATRIX, "texts": texts, "deep": _deep()}, oned_as="column")


def _write_numpy(path: Path) -> None:
    deep = {f"deep/{name}": values for name, values in _deep().items()}
    np.savez(path, m=_MATRIX, texts=np.array(_TEXTS), **_NUMBERS, **_NAMED, **deep)


def _write_arrow(path: Path) -> None:
    pq.write_table(pa.table({**_NUMBERS, **_NAMED, "texts": [text or None for text in _TEXTS]}), path)


def _write_tdms(path: Path, unit: str = "") -> None:
    about = {"unit_string": unit} if unit else {}
    with nptdms.TdmsWriter(path) as writer:
        for group, more in (("run", 0.0), ("other", 1.0)):
            numbers = {name: np.asarray(values) + more for name, values in (_NUMBERS | _NAMED).items()}
            writer.write_segment(
                [
                    nptdms.ChannelObject(group, name, values, about if name == "F" else {})
                    for name, values in {**numbers, "texts": np.array(_TEXTS)}.items()
                ]
            )


def _write_mcap(path: Path, unit: str = "", slower: bool = False) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        rig = writer.register_channel("/rig", "json", schema)
        cell = writer.register_channel("/cell", "json", schema, {"unit": unit} if unit else {})
        for i in range(_ROWS):
            row: dict[str, Any] = {name: float(values[i]) for name, values in (_NUMBERS | _NAMED).items()}
            more = {"v": [float(i), 2.0 * i]} | ({"F": None} if slower and i % 2 else {})
            for channel, content in ((rig, row), (cell, row | more)):
                writer.add_message(channel, 1_772_370_300_000_000_000 + i * 10**8, json.dumps(content).encode(), 0)
        writer.finish()


def _write_uff(path: Path, unit: str = "N") -> None:
    pyuff = pytest.importorskip("pyuff")
    units = {"t": "s", "t2": "s", "x": "mm", "F": unit, "t (ms)": "s", "F (mN)": unit}
    about: dict[str, Any] = {f"id{i}": "NONE" for i in range(2, 6)} | {
        "type": 58, "binary": 0, "func_type": 1, "ver_num": 0, "load_case_id": 0, "rsp_ent_name": "NONE", "rsp_node": 1, "rsp_dir": 1,
        "ref_ent_name": "NONE", "ref_node": 1, "ref_dir": 1, "ord_data_type": 4, "num_pts": _ROWS, "abscissa_spacing": 1,
        "abscissa_min": 0.0, "abscissa_inc": 0.1, "z_axis_value": 0, "abscissa_spec_data_type": 17, "abscissa_axis_units_lab": "s",
        "ordinate_spec_data_type": 0, "orddenom_spec_data_type": 0, "orddenom_axis_units_lab": "NONE", "z_axis_spec_data_type": 0, "x": _T,
    }  # fmt: skip
    sets = [
        {**about, "id1": name, "ordinate_axis_units_lab": units.get(name, "NONE"), "data": np.asarray(values)}
        for name, values in (_NUMBERS | _NAMED).items()
    ]
    pyuff.UFF(str(path)).write_sets(sets, "overwrite")


def _write_mdf(path: Path, unit: str = "", slower: bool = False, empty: bool = False) -> None:
    asammdf = pytest.importorskip("asammdf")
    file = asammdf.MDF(version="4.10")
    file.start_time = datetime.fromisoformat(_STARTED)
    rows = slice(None, None, 2) if slower else slice(None)
    signals = {name: np.asarray(values) for name, values in (_NUMBERS | _NAMED).items()}
    file.append([asammdf.Signal(values, _T, name=name) for name, values in signals.items() if name != "F"])
    invalid = np.arange(_ROWS) % 2 == 1 if empty else np.zeros(_ROWS, dtype=bool)
    force = asammdf.Signal(signals["F"][rows], _T[rows], name="F", unit=unit, invalidation_bits=invalid[rows])
    file.append([force])
    file.save(path, overwrite=True)


_HEAD_OF_LVM = (
    "LabVIEW Measurement\t\nWriter_Version\t2\t\nSeparator\tTab\t\nDecimal_Separator\t.\t\nX_Columns\tNo\t\n"
    "Date\t2026/03/01\t\nTime\t14:05:00.5\t\n***End_of_Header***\t\n\t\n"
)


def _write_lvm(path: Path, unit: str = "N", encoding: str = "utf-8", slower: bool = False) -> None:
    units = ["s" if unit == "N" else "ms", "s", "mm", unit, "°C", unit]
    names = [*_NUMBERS, "F (mN)"]
    each: dict[str, Callable[[int], str]] = {
        "Samples": lambda _: str(_ROWS), "Date": lambda _: "2026/03/01", "Time": lambda _: "14:05:00.5",
        "Y_Unit_Label": lambda i: units[i], "X_Dimension": lambda _: "Time", "X0": lambda _: "0.0", "Delta_X": lambda _: "0.1",
    }  # fmt: skip
    head = "".join(f"{key}\t" + "\t".join(of(i) for i in range(len(names))) + "\t\n" for key, of in each.items())
    columns = [*_NUMBERS.values(), _NUMBERS["F"]]
    rows = "".join(
        "\t" + "\t".join("" if slower and i % 2 and v is columns[3] else f"{v[i]:.5f}" for v in columns) + "\n"
        for i in range(_ROWS)
    )
    named = "X_Value\t" + "\t".join(names) + "\tComment\n"
    text = f"{_HEAD_OF_LVM}Channels\t{len(names)}\n{head}***End_of_Header***\n{named}{rows}"
    path.write_bytes(text.replace("\n", "\r\n").encode(encoding))


def _write_trios(path: Path, unit: str = "N", encoding: str = "utf-8", clock: str = "", slower: bool = False) -> None:
    names = [*_NUMBERS, "F (mN)", *(["day"] if clock else [])]
    units = ["s" if unit == "N" else "ms", "s", "mm", unit, "°C", "mN", *([""] if clock else [])]
    columns = [*_NUMBERS.values(), _NUMBERS["F"]]
    lines = []
    for i in range(_ROWS):
        cells = ["" if slower and i % 2 and v is columns[3] else f"{v[i]:.5f}" for v in columns]
        if clock:
            cells = [clock.format(i / 10), *cells[1:], "2026-03-01"]
        lines.append("\t".join(cells))
    body = "\n".join(lines)
    head = "Filename\tsweeps\nInstrument name\t5332\nOperator\tMira\n"
    text = f"{head}[step]\nHold\n" + "\t".join(names) + "\n" + "\t".join(units) + f"\n{body}\n"
    path.write_bytes(text.replace("\n", "\r\n").encode(encoding))


ZOO: Mapping[str, tuple[str, Sequence[Callable[[Path], None]]]] = {
    "csv": (".csv", [functools.partial(_write_text, **more) for more in TEXTS.values()]),
    "excel": (
        ".xlsx",
        [_write_excel, functools.partial(_write_excel, unit="mN"), functools.partial(_write_excel, slower=True)],
    ),
    "hdf5": (".h5", [_write_hdf5, functools.partial(_write_hdf5, unit="mN")]),
    "matlab": (".mat", [_write_matlab, functools.partial(_write_hdf5, unit="mN")]),
    "numpy": (".npz", [_write_numpy]),
    "arrow": (".parquet", [_write_arrow]),
    "tdms": (".tdms", [_write_tdms, functools.partial(_write_tdms, unit="mN")]),
    "mcap": (
        ".mcap",
        [_write_mcap, functools.partial(_write_mcap, unit="mN"), functools.partial(_write_mcap, slower=True)],
    ),
    "uff": (".uff", [_write_uff, functools.partial(_write_uff, unit="mN")]),
    "mdf": (
        ".mf4",
        [
            _write_mdf,
            functools.partial(_write_mdf, unit="mN"),
            functools.partial(_write_mdf, slower=True),
            functools.partial(_write_mdf, empty=True),
        ],
    ),
    "lvm": (
        ".lvm",
        [
            _write_lvm,
            functools.partial(_write_lvm, unit="mN"),
            functools.partial(_write_lvm, encoding="cp1252"),
            functools.partial(_write_lvm, slower=True),
        ],
    ),
    "trios": (
        ".txt",
        [
            _write_trios,
            functools.partial(_write_trios, unit="mN"),
            functools.partial(_write_trios, encoding="cp1252"),
            functools.partial(_write_trios, slower=True),
            functools.partial(_write_trios, clock="14:05:{:06.3f}"),
            functools.partial(_write_trios, clock="00:05:{:06.3f}"),
            functools.partial(_write_trios, clock=_CLOCK),
            functools.partial(_write_trios, clock=_CLOCK + "+00:00"),
        ],
    ),
}


@pytest.fixture(scope="module")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, tuple[Path, ...]]:
    folder = tmp_path_factory.mktemp("zoo")
    made = {}
    for name, (suffix, writers) in ZOO.items():
        places = [folder / f"{name}{number}{suffix}" for number in range(len(writers))]
        for place, write in zip(places, writers, strict=True):
            write(place)
        made[name] = tuple(places)
    return made


# --- mappings, and keys beside them --------------------------------------------------------------------------------------

_OPTIONS: Mapping[str, Content] = {
    "csv": {
        "delimiter": ";",
        "skip_rows": 1,
        "unit_row": True,
        "encoding": "cp1252",
        "comment": "#",
        "missing": ["n/a"],
    },
    "excel": {"sheet": "first", "skip_rows": 1, "unit_row": True},
    "tdms": {"group": "run"},
}
_TIMES: Mapping[str, Content] = {
    "column": {"column": "t", "unit": "s"},
    "rate": {"sample_rate_hz": 10.0},
    "elapsed": {"column": "t", "format": "elapsed"},
    "iso": {"column": "t", "format": "iso", "zone": "Europe/Berlin"},
    "time of day": {"column": "t", "format": "time_of_day"},
    "two columns": {"column": "t", "date_column": "day", "zone": "Europe/Berlin"},
    "since 1970": {"column": "t", "unit": "s", "origin": "unix"},
    "own": {"origin": "started_at"},
}
_OTHERS: Mapping[Path_, Sequence[Any]] = {
    ("time", "column"): ["t2"],
    ("time", "index"): [1],
    ("time", "unit"): ["ms"],
    ("time", "sample_rate_hz"): [50.0],
    ("time", "origin"): ["unix", "labview"],
    ("time", "format"): ["elapsed", "mm:ss", "time_of_day", "%H:%M:%S.%f"],
    ("time", "date_column"): ["word"],
    ("time", "overrule_unit"): [True],
    ("time", "zone"): ["Asia/Tokyo"],
    ("columns", "force", "column"): ["x"],
    ("columns", "force", "index"): [1],
    ("columns", "force", "unit"): ["mN"],
    ("columns", "force", "scale"): [2.0],
    ("columns", "force", "offset"): [1.0],
    ("columns", "force", "overrule_unit"): [True],
    ("columns", "force", "field"): ["v.1"],
    ("columns", "force", "time"): ["t2"],
    ("columns", "force", "sparse"): [True],
    ("columns", "force", "sensor"): ["S2"],
    ("columns", "force", "delay_s"): [0.01],
    ("columns", "force", "resolution"): [0.01],
    ("columns", "force", "filter_hz"): [5.0],
    ("csv", "delimiter"): [",", "whitespace"],
    ("csv", "decimal"): [","],
    ("csv", "thousands"): [","],
    ("csv", "encoding"): ["utf-16"],
    ("csv", "skip_rows"): [0],
    ("csv", "header"): [False],
    ("csv", "unit_row"): [False],
    ("csv", "quote"): [""],
    ("csv", "comment"): [""],
    ("csv", "missing"): [[]],
    ("csv", "final_newline"): [False],
    ("excel", "sheet"): ["second", 1],
    ("excel", "skip_rows"): [0],
    ("excel", "header"): [False],
    ("excel", "unit_row"): [False],
    ("excel", "decimal"): [","],
    ("hdf5", "root"): ["deep"],
    ("matlab", "root"): ["deep"],
    ("numpy", "root"): ["deep"],
    ("hdf5", "transpose"): [True],
    ("matlab", "transpose"): [True],
    ("numpy", "transpose"): [True],
    ("tdms", "group"): ["other"],
    ("lvm", "encoding"): ["cp1252"],
    ("trios", "encoding"): ["cp1252"],
    ("rig", "clamp_mass_kg"): [0.07],
    ("recording", "operator"): ["B"],
    ("format",): ["excel"],
    ("repeated",): ["mean"],
}


def _recording(name: str, time: Content) -> Content:
    """A mapping of a recording."""
    columns: dict[str, Content] = {"displacement": {"column": "x"}, "force": {"column": "F"}}
    if name == "mcap":
        columns = {"displacement": {"column": "/rig", "field": "x"}, "force": {"column": "/cell", "field": "F"}}
    content = {
        "format": name,
        "time": dict(time),
        "columns": {q: {**c, "unit": unit} for (q, c), unit in zip(columns.items(), ("mm", "N"), strict=True)},
        "recording": {"recording_id": "r", "protocol": "step", "loading": "mechanical", "specimen_id": "s"}
        | {"started_at": _STARTED},
    }
    return content | ({name: dict(_OPTIONS[name])} if name in _OPTIONS else {})


def _set(content: Content, place: Path_, value: Any) -> Content:
    changed = copy.deepcopy(content)
    table = changed
    for key in place[:-1]:
        table = table.setdefault(key, {})
    table[place[-1]] = value
    return changed


def _plain(value: Any) -> Any:
    """What was read, as values that can be compared."""
    if is_dataclass(value) and not isinstance(value, type):
        return tuple((field.name, _plain(getattr(value, field.name))) for field in fields(value))
    if isinstance(value, np.ndarray):
        return (value.shape, value.tobytes())
    if isinstance(value, Mapping):
        return tuple((key, _plain(one)) for key, one in value.items())
    if isinstance(value, datetime):
        return repr(value.isoformat())
    if isinstance(value, tuple | list):
        return tuple(_plain(one) for one in value)
    return repr(value)


def _read(content: Content, path: Path) -> Any:
    """All that a mapping makes of a file; the error where it is refused."""
    try:
        mapping = FileMapping.parse(copy.deepcopy(content), stem="r", suffix=path.suffix, source="r.toml")
        parts = list_parts(path, mapping) if mapping.parts_file else ()
        read = [read_raw(path, part_of(mapping, part)) for part in parts] or [read_raw(path, mapping)]
    except DealabError as error:
        return str(error)
    return tuple(_plain(one) for one in read)


def _is_error(content: Content, suffix: str) -> bool:
    """Whether a mapping is refused before any file is looked at."""
    try:
        FileMapping.parse(copy.deepcopy(content), stem="r", suffix=suffix, source="r.toml")
    except DealabError:
        return True
    return False


def _find_ignored(
    contents: Sequence[Content], files: Sequence[Path], cases: Mapping[Path_, Sequence[Any]]
) -> Iterator[str]:
    """Keys that change nothing in any of the files beside any of the mappings, and are accepted beside one of them."""
    read = functools.cache(lambda at, path: _read(contents[at], path))
    for place, values in cases.items():
        for value in values:
            changed = [_set(content, place, value) for content in contents]
            accepted = [
                at for at, one in enumerate(changed) if one != contents[at] and not _is_error(one, files[0].suffix)
            ]
            if accepted and all(_read(changed[at], path) == read(at, path) for at in accepted for path in files):
                yield f"{'.'.join(place)} = {value!r}"


# --- recordings ------------------------------------------------------------------------------------------------------------

_FORCES: Mapping[str, Content] = {
    "plain": {},
    "named after another unit": {"column": "F (mN)"},
    "a matrix": {"column": "m", "index": 2},
    "texts": {"column": "texts"},
}
"""What is mapped as the force."""


def _with_force(content: Content, name: str, force: Content) -> Content | None:
    if name == "mcap" and force:
        force = {"field": force["column"]} if force["column"] in _NAMED else {}
    changed = copy.deepcopy(content)
    changed["columns"]["force"] |= force
    return changed


def _bases(name: str) -> Iterator[tuple[str, Content]]:
    """Mappings of a recording in a format, each in its own way of times or of forces."""
    suffix = ZOO[name][0]
    for label, time in _TIMES.items():
        content = _recording(name, time)
        if not _is_error(content, suffix):
            yield label, content
    for label, force in _FORCES.items():
        yield label, _with_force(_recording(name, _TIMES["column"]), name, force)
    named = {"column": "t (ms)", "unit": "s"}
    yield "time named after another unit", _recording(name, named)


def _is_of(place: Path_, name: str) -> bool:
    return place[0] not in OPTIONS or place[0] == name


def test_all_keys_are_tried() -> None:
    tried = {place[-1] for place in _OTHERS}
    assert tried >= {*TIME, *COLUMN}
    assert tried >= {key for name in ZOO for key in OPTIONS[name]}
    assert set(FORMATS) <= set(ZOO)


@pytest.mark.long_after(1)
@pytest.mark.parametrize("name", ZOO)
def test_a_key_of_time_changes_what_is_read_or_is_an_error(name: str, zoo: Mapping[str, tuple[Path, ...]]) -> None:
    """`zone` beside equal steps, `format` without a column and others were accepted and ignored."""
    cases = {place: values for place, values in _OTHERS.items() if place[0] == "time" and place[1] != "overrule_unit"}
    for label, content in _bases(name):
        if all(isinstance(_read(content, path), str) for path in zoo[name]):
            continue  # a way of times that the files of this format do not have
        assert list(_find_ignored([content], zoo[name], cases)) == [], label


@pytest.mark.long_after(1)
@pytest.mark.parametrize("name", ZOO)
def test_any_other_key_of_a_recording_changes_what_is_read_or_is_an_error(
    name: str, zoo: Mapping[str, tuple[Path, ...]]
) -> None:
    cases = {p: v for p, v in _OTHERS.items() if (p[0] != "time" or p[1] == "overrule_unit") and _is_of(p, name)}
    assert list(_find_ignored([content for _, content in _bases(name)], zoo[name], cases)) == []


def test_nothing_beside_the_kind_of_a_file_that_is_ignored() -> None:
    for place, values in _OTHERS.items():
        content = _set({"kind": "ignore"}, place, values[0])
        assert _is_error(content, ".csv"), place
    assert not _is_error({"kind": "ignore"}, ".csv")


def test_text_apart_by_blanks_may_be_quoted(tmp_path: Path) -> None:
    """`quote` is used with `delimiter = "whitespace"` as well: in names, and around numbers."""
    path = tmp_path / "r.dat"
    path.write_text("'t of run' x 'F cell'\n" + "".join(f"{i} '{i}.5'  1.5\n" for i in range(20)))
    content = _recording("csv", {"column": "t of run", "unit": "s"})
    content["columns"]["force"]["column"] = "F cell"
    content["csv"] = {"delimiter": "whitespace", "quote": "'"}
    assert not isinstance(_read(content, path), str)
    assert list(_find_ignored([content], [path], {("csv", "quote"): ['"', ""]})) == []


# --- selections --------------------------------------------------------------------------------------------------------------

_SELECTIONS: Sequence[Content] = (
    {"column": "run", "equals": 1},
    {"column": "run", "equals": [1.2]},
    {"column": "word", "equals": "über"},
    {"column": "run", "at_least": 1.5},
    {"column": "run", "each": True},
    {"column": "word", "each": True},
    {"column": "run", "each_of": [1, 2]},
    {"column": "run", "each_of": [1.2, 2]},
    {"first_row": 3},
    {"part": "late", "first_row": 5},
)
_OF_SELECTIONS: Mapping[str, Sequence[Any]] = {
    "column": ["t2"],
    "equals": [2, "x"],
    "tolerance": [0.3],
    "at_least": [2.05],
    "at_most": [0.5],
    "first_row": [7],
    "last_row": [9],
    "each": [True],
    "each_of": [[2]],
    "runs": ["apart"],
    "run": [2],
    "part": ["one"],
    "recording": [{"operator": "C"}],
    "columns": [{"force": {"column": "x"}}],
    "time": [{"column": "t2"}],
}


@pytest.mark.parametrize("entry", _SELECTIONS, ids=str)
def test_a_key_of_a_selection_changes_what_is_read_or_is_an_error(
    entry: Content, zoo: Mapping[str, tuple[Path, ...]]
) -> None:
    """`tolerance` beside a text left rows out without a word: a text lies within no tolerance."""
    assert set(_OF_SELECTIONS) == set(SELECT)
    content = _recording("csv", _TIMES["column"])
    content["recording"]["recording_id"] = "r-{each}"
    content["select"] = [entry]
    for key, values in _OF_SELECTIONS.items():
        for value in values:
            changed = {**content, "select": [{**entry, key: value}]}
            if changed != content and not _is_error(changed, ".csv"):
                assert any(_read(changed, path) != _read(content, path) for path in zoo["csv"]), key


# --- tables ------------------------------------------------------------------------------------------------------------------

_CELLS: Mapping[str, Callable[[int], Any]] = {
    "life": lambda i: 10 * (i + 1),
    "early": lambda i: i + 1,
    "ended": lambda i: i % 2,
    "number": lambda i: i + 1,
    "share": lambda i: 0.1 + 0.01 * i,
    "word": lambda i: "abcd"[i % 4],
    "once": lambda i: "uv"[i // 8] if i % 8 == 0 else "",
    "rarely": lambda i: "" if i % 4 else i + 1,
    "begun": lambda i: f"2026-03-01T{i:02d}:00",
    "over": lambda i: f"2026-03-02T{i:02d}:00",
    "site": lambda i: ("rod", "lead")[i % 2],
    "region": lambda i: ("left", "centre")[i % 2],
    "name": lambda i: f"S-{i}",
    "f": lambda i: 1.5**i,
    "half": lambda i: 0.5 * (i + 1),
    "beside": lambda i: 0.02 + 0.001 * i,
}
_HEADS: Mapping[str, Content] = {
    "lifetimes": {
        "lifetime": {"column": "life", "unit": "h"},
        "failed": {"column": "ended", "failed_values": [1], "censored_values": [0]},
    },
    "frequency_response": {
        "frequency": {"column": "f", "unit": "Hz"},
        "storage": {"column": "number", "unit": "N/mm"},
        "loss": {"column": "share", "unit": "N/mm"},
    },
    "relaxation": {"time": {"column": "f", "unit": "s"}, "relaxation": {"column": "number", "unit": "N/mm"}},
}
_PLACES: Mapping[str, Content] = {
    "alive_at": {"column": "early", "unit": "h"},
    "entered": {"column": "early", "unit": "h"},
    "test_duration": {"column": "early", "unit": "h"},
    "count": {"column": "number"},
    "voltage": {"column": "rarely", "unit": "kV"},
    "configuration": {"column": "once"},
    "started": {"column": "begun"},
    "ended": {"column": "over"},
    "specimen_id": {"column": "name"},
    "breakdown_voltage": {"column": "number", "unit": "kV"},
    "failure_site": {"column": "site"},
    "failure_region": {"column": "region"},
    "failure_mode": {"column": "word"},
    "temperature": {"column": "beside", "unit": "degC"},
    "humidity": {"column": "share", "unit": "1"},
    "electrode": {"column": "once"},
    "batch": {"column": "once"},
    "censored": {"column": "ended", "failed_values": [0], "censored_values": [1]},
    "magnitude": {"column": "number", "unit": "N/mm"},
    "phase": {"column": "share", "unit": "rad"},
    "tan_delta": {"column": "share", "unit": "1"},
    "response": {"column": "number", "unit": "N/mm"},
    "standard_error": {"column": "beside", "unit": "N/mm"},
    "displacement": {"column": "half", "unit": "mm"},
    "transducer_displacement": {"column": "early", "unit": "mm"},
    "frequency": {"column": "f", "unit": "Hz"},
}
_OF_COLUMNS: Mapping[str, Sequence[Any]] = {
    "column": ["word"],
    "index": [0],
    "unit": ["min", "mN/mm", "K", "V", "rad/s"],
    "scale": [0.5],
    "offset": [0.25],
    "overrule_unit": [True],
    "value": [3.0, "rod"],
    **{f"{name}_values": [[0], [1]] for name in ("failed", "censored", "left_censored", "no_test")},
    **{f"{name}_values": [["a", "b"]] for name in ("film", "lead", "edge", "electrode", "other")},
    "censored_modes": [["other"]],
    "law": ["category", "inverse power"],
    "format": ["hh:mm", "%d.%m.%Y %H:%M"],
    "fill_down": [True],
    "open_until": ["2026-03-05T00:00"],
}


_BESIDE: Mapping[str, Sequence[str]] = {
    "tan_delta": ("frequency", "storage"),
    "magnitude": ("frequency", "phase"),
    "phase": ("frequency", "magnitude"),
    "response": ("frequency",),
    "displacement": ("frequency", "storage", "loss", "transducer_displacement"),
    "transducer_displacement": ("frequency", "storage", "loss", "displacement"),
    "censored": ("lifetime",),
    "started": ("failed", "ended"),
    "ended": ("failed", "started"),
    "test_duration": ("lifetime", "failed"),
}
"""Columns that one column needs, where the others of its kind stand in place of it."""
_NEIGHBOURS: Mapping[str, str] = {
    "h": "min", "kV": "V", "degC": "K", "1": "%", "N/mm": "mN/mm", "rad": "deg", "mm": "m", "Hz": "kHz", "s": "ms",
}  # fmt: skip
"""Another unit that a file may have where the mapping says one."""


def _write_table(path: Path, unit_of: str = "", unit: str = "", survivors_without_lives: bool = False) -> Path:
    cells = dict(_CELLS)
    if survivors_without_lives:
        cells["life"] = lambda i: 10 * (i + 1) if i % 2 else ""
        cells["over"] = lambda i: f"2026-03-02T{i:02d}:00" if i % 2 else ""
    units = [unit if name == unit_of else "" for name in cells]
    rows = [";".join(str(cell(i)) for cell in cells.values()) for i in range(16)]
    path.write_text("\n".join([";".join(cells), ";".join(units), *rows, ""]))
    return path


def _table(kind: str, columns: Content, **more: Any) -> Content:
    about = {"recording_id": "r", "specimen_id": "s"} if kind != LIFETIMES else {"recording_id": "r"}
    return {"kind": kind, "csv": {"delimiter": ";", "unit_row": True}, "columns": columns, "recording": about, **more}


@pytest.mark.long_after(1)
@pytest.mark.parametrize("kind", _HEADS)
def test_a_column_of_a_table_and_its_keys_change_what_is_read_or_are_errors(kind: str, tmp_path: Path) -> None:
    """`magnitude` without a phase was ignored beside storage and loss."""
    wrong = []
    assert {*_PLACES, *_HEADS[kind]} >= set(TABLE_COLUMNS[kind])
    plain, open_ended = (_write_table(tmp_path / f"{n}.csv", survivors_without_lives=bool(n)) for n in range(2))
    all_columns = _PLACES | _HEADS[kind]
    for name in TABLE_COLUMNS[kind]:
        others = _BESIDE.get(name, [k for k in _HEADS[kind] if k != name])
        base = _table(kind, {k: all_columns[k] for k in others})
        content = _set(base, ("columns", name), all_columns[name])
        unit = _NEIGHBOURS.get(all_columns[name].get("unit", ""), "")
        files = [plain, open_ended, _write_table(tmp_path / f"{name}.csv", all_columns[name]["column"], unit)]
        if all(_read(content, path) == _read(base, path) for path in files):
            wrong.append(name)
        if name != "response":  # complex numbers, which no text has
            wrong += _find_ignored([content], files, {("columns", name, key): _OF_COLUMNS[key] for key in TABLE_COLUMN})
    assert wrong == []


@pytest.mark.parametrize("beside", ["magnitude", "phase"])
def test_half_of_another_pair_is_an_error(beside: str, tmp_path: Path) -> None:
    columns = _HEADS["frequency_response"] | {beside: _PLACES[beside]}
    said = _read(_table("frequency_response", columns), _write_table(tmp_path / "t.csv"))
    assert f"columns.{beside} is not used beside storage and loss" in said


@pytest.mark.parametrize("key", ["unit", "scale"])
def test_words_of_a_covariate_have_no_unit_and_no_scale(key: str, tmp_path: Path) -> None:
    own = {"column": "word", key: "mm" if key == "unit" else 2.0}
    content = _table(LIFETIMES, _HEADS[LIFETIMES], covariates={"thing": own})
    assert f"covariates.thing.{key} is not used" in _read(content, _write_table(tmp_path / "t.csv"))


@pytest.mark.parametrize("law", [None, "category", "exponential", "arrhenius"])
def test_a_key_of_a_covariate_changes_what_is_read_or_is_an_error(law: str | None, tmp_path: Path) -> None:
    own = {"column": "number"} | ({} if law is None else {"law": law})
    content = _table(LIFETIMES, _HEADS[LIFETIMES], covariates={"thing": own})
    cases = {("covariates", "thing", key): _OF_COLUMNS[key] for key in COVARIATE}
    assert list(_find_ignored([content], [_write_table(tmp_path / "t.csv")], cases)) == []


@pytest.mark.parametrize("kind", _HEADS)
def test_a_table_takes_no_key_of_recordings(kind: str, tmp_path: Path) -> None:
    cases = {p: v for p, v in _OTHERS.items() if p[0] in ("time", "rig", "repeated", "format")}
    assert set(TOP) == {"kind", "format", "repeated"}
    content = _table(kind, _HEADS[kind])
    ignored = list(_find_ignored([content], [_write_table(tmp_path / "t.csv")], cases))
    assert ignored == ([] if kind == LIFETIMES else ["repeated = 'mean'"])  # nothing repeats in these tables
