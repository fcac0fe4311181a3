"""A complete mapping TOML for a file that has none, ready to be checked by a person. Used by `dealab inspect` alone."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ingest.arrays import ArrayFile
from ingest.clocks import moment
from ingest.columns import ColumnFile
from ingest.csv_dialect import Dialect
from ingest.mapping import FileMapping, format_of
from ingest.mapping_keys import FREQUENCY_RESPONSE, LIFETIMES, RECORDING
from ingest.sniff import TIME, GuessedColumn, guess_columns, guess_text
from schemas.errors import RefusedError
from schemas.protocols import PROTOCOLS, missing_channels
from schemas.quantities import QUANTITIES
from schemas.units import ANY

_CHECK = "                 # CHECK"
_STORAGE = r"stor|^[eg]['1]|[eg]'$|^k'"
_LOSS = r"loss|^[eg](''|\"|2)|^k''"
_FAILED = r"cens|fail|event|status|death|broke|^breakdown$|runout|durchschlag"
_LIFE = r"life|lebensdauer|time to (break|fail)|(breakdown|failure) time|寿命"
_CONFIGURATION = r"config|group|electrode|design|layout|bauart|gruppe|^type$"
_SPECIMEN = r"specimen|sample|probe|^id$"
_YES = r"1|y|ja|true|bd|fail|broke|break|dead|death"


def draft_mapping(path: Path) -> str:
    """The text of a TOML that maps the file, with the guesses marked. Raises `RefusedError` when it cannot be read."""
    found = format_of(path)
    if found == "csv":
        guess = guess_text(path.read_bytes())
        return _recording_or_table(path, _csv_lines(guess.dialect), _with_time_first(guess.columns), guess.rows)
    if found == "excel":
        return _recording_or_table(path, *_excel(path))
    if found == "mcap":
        raise RefusedError("no channel can be guessed", where=path.name, expected="topics mapped by hand in a TOML")
    return _arrays(path, found or "")


def toml_string(text: str) -> str:
    """A TOML basic string of any text; lone surrogates, which TOML cannot hold, become question marks."""
    plain = text.encode("utf-8", "replace").decode()
    return json.dumps(plain, ensure_ascii=False).replace("\x7f", "\\u007F")


def _recording_or_table(
    path: Path, format_lines: Sequence[str], columns: Sequence[GuessedColumn], rows: Sequence[Sequence[Any]]
) -> str:
    """A table of moduli over frequency or of lives is drafted as such, anything else as a recording."""
    frequency = next((c for c in columns if c.unit in ("Hz", "rad/s", "kHz")), None)
    moduli = [c for c in columns if c.unit in ("Pa", "kPa", "MPa", "GPa", "N/mm", "N/m")]
    storage, loss = (next((c for c in moduli if re.search(p, str(c.column).lower())), None) for p in (_STORAGE, _LOSS))
    if frequency is not None and storage is not None and loss is not None:
        chosen = {"frequency": frequency, "storage": storage, "loss": loss}
        return _table_text(path, FREQUENCY_RESPONSE, format_lines, columns, chosen, rows)
    lives = _lives(columns)
    return (
        _table_text(path, LIFETIMES, format_lines, columns, lives, rows)
        if lives
        else _text(path, format_lines, columns, rows)
    )


def _lives(columns: Sequence[GuessedColumn]) -> dict[str, GuessedColumn]:
    """The columns of a table of lives by what they are; empty where nothing says that it is one."""
    named = next((c for c in columns if c.unit != "kV" and re.search(_LIFE, str(c.column).lower())), None)
    failed = next((c for c in columns if c is not named and re.search(_FAILED, str(c.column).lower())), None)
    life = named or next((c for c in columns if failed is not None and c.meaning == TIME and c is not failed), None)
    if life is None:
        return {}
    found = {"lifetime": life} | ({} if failed is None else {"failed": failed})
    for name, pattern in (("voltage", None), ("configuration", _CONFIGURATION), ("specimen_id", _SPECIMEN)):
        column = next(
            (
                c
                for c in columns
                if c not in found.values()
                and (c.meaning == name if pattern is None else re.search(pattern, str(c.column).lower()))
            ),
            None,
        )
        found |= {} if column is None else {name: column}
    return found


def _table_text(
    path: Path,
    kind: str,
    format_lines: Sequence[str],
    columns: Sequence[GuessedColumn],
    chosen: Mapping[str, GuessedColumn],
    rows: Sequence[Sequence[Any]],
) -> str:
    lines = [*_head(path, kind), *format_lines]
    for name, c in chosen.items():
        lines += ["", f"[columns.{name}]", f"column = {_column(c)}"]
        if name == "failed":
            lines += _meanings(c, columns, rows)
        elif name not in ("configuration", "specimen_id"):
            unit = c.unit or {"lifetime": "s", "voltage": "kV"}.get(name, "1")
            lines += [f"unit = {toml_string(unit)}{'' if c.unit else _CHECK}"]
    lines += _others([c for c in columns if c not in chosen.values()])
    lines += ["", "[recording]", 'recording_id = "{stem}"']
    if kind == FREQUENCY_RESPONSE:
        lines += [f'specimen_id = "{{stem}}"{_CHECK}']
    elif "configuration" not in chosen:
        lines += [f'configuration = "{{stem}}"{_CHECK}']
    return "\n".join([*lines, ""])


def _meanings(failed: GuessedColumn, columns: Sequence[GuessedColumn], rows: Sequence[Sequence[Any]]) -> list[str]:
    """The values of a column of failures, as they seem to be meant: which ones depends on the table."""
    place = failed.column if isinstance(failed.column, int) else _position(failed, columns)
    cells = [row[place] for row in rows if place < len(row)]
    values = list(dict.fromkeys(int(c) if isinstance(c, float) and c.is_integer() else c for c in cells))[:8] or [1, 0]
    turned = re.search("cens|runout|surv", str(failed.column).lower()) is not None
    yes = [v for v in values if (re.match(_YES, str(v).strip().lower()) is not None) != turned]
    shown = [", ".join(str(v) if isinstance(v, int) else toml_string(str(v)) for v in group) for group in
             (yes, [v for v in values if v not in yes])]  # fmt: skip
    return [f"failed_values = [{shown[0]}]", f"censored_values = [{shown[1]}]          # CHECK: which value means what"]


def _position(column: GuessedColumn, columns: Sequence[GuessedColumn]) -> int:
    return next(i for i, c in enumerate(columns) if c is column)


def _head(path: Path, kind: str) -> list[str]:
    return [
        f"# Draft for {toml_string(path.name)}: check every line marked CHECK, then save it beside the file as",
        f"# {toml_string(path.name + '.toml')}",
        f'kind = "{kind}"',
        "",
    ]


def _others(columns: Sequence[GuessedColumn]) -> list[str]:
    if not columns:
        return []
    lines = ["", "# CHECK: columns that are not mapped. Map them like this where they matter:"]
    for c in columns:
        shown = f" in {c.unit}" if c.unit else ""
        lines += [f"# [columns.<name>]   column = {_column(c)}{toml_string(shown)[1:-1]}"]
    return lines


def _excel(path: Path) -> tuple[list[str], tuple[GuessedColumn, ...], list[list[Any]]]:
    from ingest.excel_reader import sheet_names, sheet_rows

    names = sheet_names(path)
    sheet = max(names, key=lambda name: len(sheet_rows(path, name)))
    rows = sheet_rows(path, sheet)
    numbers = [sum(isinstance(c, float | int) and not isinstance(c, bool) for c in row) for row in rows]
    usual = max(set(numbers) - {0}, key=numbers.count, default=0)
    start = next((i for i, n in enumerate(numbers) if n and n >= usual), 0)
    above = [i for i in range(start) if any(str(c).strip() for c in rows[i])]
    header = [str(c).strip() for c in rows[above[-2]]] if len(above) > 1 else []
    units = [str(c).strip() for c in rows[above[-1]]] if len(above) > 1 else []
    guessed = guess_columns(header, units, len(rows[start]) if rows else 0)
    if not any(c.unit and c.meaning for c in guessed):
        header, units = ([str(c).strip() for c in rows[above[-1]]] if above else []), []
        guessed = guess_columns(header, units, len(rows[start]) if rows else 0)
    skip = start - (len(header) > 0) - (len(units) > 0)
    lines = ["[excel]", f"sheet = {toml_string(sheet)}", f"skip_rows = {skip}"]
    lines += [f"header = {_truth(bool(header))}", f"unit_row = {_truth(bool(units))}"]
    return lines, _with_time_first(guessed), rows[start:]


def _csv_lines(dialect: Dialect) -> list[str]:
    return [
        "[csv]",
        f"delimiter = {toml_string(dialect.delimiter)}",
        f"decimal = {toml_string(dialect.decimal)}",
        f"encoding = {toml_string(dialect.encoding)}",
        f"skip_rows = {dialect.skip_rows}                 # lines before the header",
        f"header = {_truth(dialect.header)}",
        f"unit_row = {_truth(dialect.unit_row)}",
    ]


def _arrays(path: Path, found: str) -> str:
    from ingest.read import open_columns

    mapping = FileMapping(RECORDING, found, {}, None, {}, {}, {})
    file = open_columns(path, found, mapping)
    names = file.names()
    separator = "." if found == "matlab" else "/"
    guessed = guess_columns(
        [n.rsplit(separator, 1)[-1] for n in names], [file.unit(n) or "" for n in names], len(names)
    )
    columns = tuple(GuessedColumn(n, g.unit, g.meaning) for n, g in zip(names, guessed, strict=False))
    lines = [f"[{found}]"]
    if found in ("matlab", "hdf5"):
        lines += ["# the arrays of the file; a column of a matrix is index = 0, 1, …"]
        lines += [f"# {toml_string(name)}: {_shape(file, name)}" for name in names]
    return _text(path, lines, columns, has_own_time=found in ("tdms", "uff"))


def _shape(file: ColumnFile, name: str) -> str:
    return " × ".join(map(str, file.shape(name))) if isinstance(file, ArrayFile) else ""


def _with_time_first(columns: Sequence[GuessedColumn]) -> tuple[GuessedColumn, ...]:
    """Columns of a file without any names: the first is taken for the time, as nearly every recorder writes it."""
    if columns and all(isinstance(c.column, int) for c in columns) and not any(c.meaning for c in columns):
        return (GuessedColumn(columns[0].column, columns[0].unit, TIME), *columns[1:])
    return tuple(columns)


def _text(
    path: Path,
    format_lines: Sequence[str],
    columns: Sequence[GuessedColumn],
    rows: Sequence[Sequence[Any]] = (),
    *,
    has_own_time: bool = False,
) -> str:
    time = next((c for c in columns if c.meaning == TIME), None)
    mapped = [c for c in columns if c.meaning not in (None, TIME)]
    others = [c for c in columns if c.meaning is None]
    protocol, loading = _protocol({str(c.meaning) for c in mapped})
    started = datetime.fromtimestamp(int(path.stat().st_mtime), UTC).isoformat()
    lines = [*_head(path, RECORDING), *format_lines, ""]
    if time is not None:
        lines += ["[time]", f"column = {_column(time)}", *_time_lines(time, columns, rows)]
    elif not has_own_time:
        lines += ["[time]", "sample_rate_hz = 1000.0       # CHECK: no column of times was found"]
    for c in mapped:
        unit = c.unit or ("V" if QUANTITIES[str(c.meaning)].unit == ANY else QUANTITIES[str(c.meaning)].unit)
        lines += ["", f"[columns.{c.meaning}]", f"column = {_column(c)}"]
        lines += [f"unit = {toml_string(unit)}{'' if c.unit else _CHECK}"]
    lines += _others(others)
    lines += [
        "",
        "[recording]",
        'recording_id = "{stem}"',
        f'protocol = "{protocol}"          # CHECK: one of ' + ", ".join(dict.fromkeys(p for p, _ in PROTOCOLS)),
        f'loading = "{loading}"',
        'specimen_id = "{stem}"        # CHECK',
        f'started_at = "{started}"      # CHECK: this is the time of the file\'s last change',
        "",
        "[rig]",
        "",
    ]
    return "\n".join(lines)


def _time_lines(time: GuessedColumn, columns: Sequence[GuessedColumn], rows: Sequence[Sequence[Any]]) -> list[str]:
    """Unit of a column of times, or the format of dates."""
    place = time.column if isinstance(time.column, int) else _position(time, columns)
    cell = rows[0][place] if rows and place < len(rows[0]) else ""
    found = None if isinstance(cell, float | int) else moment(cell, None)
    if found is None:
        return [f"unit = {toml_string(time.unit or 's')}{'' if time.unit else _CHECK}"]
    return ['format = "iso"'] + ([] if found.tzinfo is not None else [f'zone = "UTC"{_CHECK}: zone of the clock'])


def _protocol(found: set[str]) -> tuple[str, str]:
    """The first protocol whose required channels are all there; a cycle where none is."""
    for name, loading in (("cycle", "mechanical"), ("step", "electrical"), ("force_map", "electrical")):
        if not missing_channels(PROTOCOLS[name, loading], found):
            return name, loading
    for (name, loading), definition in PROTOCOLS.items():
        if not missing_channels(definition, found) and loading != "calibration":
            return name, loading
    return "cycle", "mechanical"


def _column(column: GuessedColumn) -> str:
    return str(column.column) if isinstance(column.column, int) else toml_string(column.column)


def _truth(value: bool) -> str:
    return "true" if value else "false"
