"""LabVIEW measurement files (`.lvm`), after NI's specification: text with a head for the file and for each segment.

A column is the name of a channel. Its time is what the head of its segment says (`X0`, `Delta_X`), or `X_Value`;
segments of the same channels follow each other by the clock times of their heads. Does not belong here: rows of text
(`ingest.csv_reader`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from ingest.columns import OwnTime, named_column
from ingest.compressed import read_plain_content
from ingest.csv_dialect import Dialect, as_utf8
from ingest.csv_reader import CsvFile, parse_csv
from ingest.mapping import ColumnName, FileMapping, column_label
from schemas.arrays import Float
from schemas.errors import RefusedError
from schemas.units import conversion

BEGINS = "LabVIEW Measurement"
X_VALUE, COMMENT = "X_Value", "Comment"
ENDS = "***End_of_Header***"
_SPECIAL = ("***Start_Special***", "***End_Special***")
_NO_X, _ONE_X, _EACH_X = "no", "one", "multi"
_SEPARATORS = {"tab": "\t", "comma": ","}


@dataclass(frozen=True)
class _Segment:
    """A segment: the lines of its head by their first word, the names of its columns, and its rows."""

    head: Mapping[str, tuple[str, ...]]
    names: tuple[str, ...]
    rows: tuple[str, ...]


@dataclass(frozen=True)
class LvmFile(CsvFile):
    """The channels of a file; a `ColumnFile`. `times` (n,) in s by the position of a column.

    `since` (n,) is what is added to columns of times: the seconds from the start of the first segment to that of a row's own
    one, where each begins anew. `begins` are the first rows of segments with a head of their own.
    """

    times: Mapping[int, Float] = field(default_factory=dict)
    axis: str = "Time"
    since: Float | None = None
    begins: tuple[int, ...] = (0,)

    def own_time(self, column: ColumnName) -> OwnTime | None:
        at = named_column(self.header, column, self.where)
        if self.axis.lower() != "time":
            raise RefusedError(
                f'the axis of {column_label(column)} is "{self.axis[:40]}" (X_Dimension)',
                where=self.where,
                expected="samples over time",
                remedy='Map it as a table: format = "csv" with skip_rows',
            )
        if at in self.times:
            return OwnTime(self.times[at], None)
        by = max((i for i, name in enumerate(self.header[:at]) if name.startswith(X_VALUE)), default=None)
        if by is None:
            return None
        written = self.numbers(by).values
        if self.since is None or not _begins_anew(written, self.begins):
            return OwnTime(written, None)
        return OwnTime(written + self.since[: written.size], None)


def read_lvm(path: Path, mapping: FileMapping) -> LvmFile:
    """The channels of a file. Raises `RefusedError` for other files, and where segments differ."""
    plain = read_plain_content(path)
    where = path.name
    text, notes = as_utf8(plain.content, Dialect(encoding=mapping.options.get("encoding", "utf-8")), where)
    about, segments = _split(text.decode("utf-8", "replace"), where)
    separator = _SEPARATORS.get(_first(about, "Separator").lower(), "\t")
    decimal = _first(about, "Decimal_Separator") or "."
    first = segments[0]
    for number, segment in enumerate(segments):
        if segment.names != first.names:
            raise RefusedError(
                f"segment {number} has the columns {', '.join(segment.names)[:200]},"
                f" the first {', '.join(first.names)[:200]}",
                where=where,
                expected="segments of the same channels",
                remedy="Export each to a file of its own",
            )
    names = [name for name in first.names if name != COMMENT]
    rows = [row for segment in segments for row in segment.rows]
    commented = [i for i, row in enumerate(rows) if row.count(separator) == len(names) < len(first.names)]
    comments = [rows[i].rpartition(separator)[2].strip() for i in commented]
    for i in commented:  # LabVIEW writes none behind the rows that have none
        rows[i] = rows[i].rpartition(separator)[0]
    said = [comment for comment in comments if comment]
    if said:
        notes.append(f'{len(said)} rows have comments, such as "{said[0][:80]}"')
    body = "\n".join([separator.join(names), *rows]).encode() + (b"\n" if text.endswith((b"\n", b"\r")) else b"")
    dialect = Dialect(delimiter=separator, decimal=decimal, quote="")
    file = parse_csv(body, dialect, where=where, keep_blank=True)
    kind = (_first(about, "X_Columns") or _ONE_X).lower()
    short = _check_counts(segments) if file.table.num_rows else []
    return LvmFile(
        where,
        dialect,
        file.header,
        _units(first, kind),
        file.table,
        (*plain.problems, *short, *file.problems),
        (*notes, *file.notes, *_joins(segments, about)),
        _times(segments, kind, file.table.num_rows, where) if kind == _NO_X else {},
        _first(first.head, "X_Dimension") or "Time",
        _since(segments, file.table.num_rows, where),
        _begins(segments, file.table.num_rows),
    )


def find_facts(path: Path, encoding: str) -> list[str]:
    """The lines of a file's head, for people who want to know when and by whom it was written."""
    text, _ = as_utf8(read_plain_content(path).content, Dialect(encoding=encoding), path.name)
    about, segments = _split(text.decode("utf-8", "replace"), path.name)
    head = {**{k: v for k, v in segments[0].head.items() if k in ("Date", "Time")}, **about}
    clock = f"{_first(head, 'Date')} {_first(head, 'Time').replace(',', '.')[:15]}".strip()
    lines = [f"{key}: {values[0]}" for key, values in about.items() if values and key not in ("Date", "Time")]
    return [*lines, f"Date: {clock.replace('/', '-')}"]


def _split(text: str, where: str) -> tuple[Mapping[str, tuple[str, ...]], list[_Segment]]:
    """The head of the file and its segments."""
    lines = text.split("\n") if "\r" not in text else text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if not lines[0].strip().startswith(BEGINS):
        raise RefusedError(
            f'the file does not begin with "{BEGINS}"',
            where=where,
            expected="a LabVIEW measurement file",
            remedy='Other text is read with format = "csv"',
        )
    about, at = _head(lines, 1, where)
    separator = _SEPARATORS.get(_first(about, "Separator").lower(), "\t")
    segments: list[_Segment] = []
    while (at := _next_filled(lines, at)) < len(lines):
        if lines[at].startswith("Channels"):
            head, at = _head(lines, at, where, separator)
            at = _next_filled(lines, at)
            names = tuple(" ".join(name.split()) for name in lines[at].split(separator)) if at < len(lines) else ()
            at += 1
        elif segments:
            head, names = {}, segments[-1].names
        else:
            raise RefusedError(
                "there is no head of a segment",
                where=where,
                expected=f"Channels … {ENDS} behind that of the file",
            )
        end = at
        while end < len(lines) and lines[end].strip("\r\n \x00" if separator == "\t" else " ") != "":
            end += 1
        segments.append(_Segment(head, _numbered(names), tuple(lines[at:end])))
        at = end
    if not segments or not any(segment.rows for segment in segments):
        raise RefusedError("there are no rows of data", where=where, expected="rows after the head of a segment")
    return about, segments


def _head(lines: Sequence[str], at: int, where: str, separator: str = "\t") -> tuple[dict[str, tuple[str, ...]], int]:
    """The lines of a head by their first word, and where it ends."""
    found: dict[str, tuple[str, ...]] = {}
    special = False
    for i in range(at, len(lines)):
        line = lines[i].strip("\r\n")
        if line.strip().strip(separator).startswith(ENDS):
            return found, i + 1
        if line.startswith(_SPECIAL):
            special = line.startswith(_SPECIAL[0])
        elif not special and line.strip():
            key, *values = line.split("," if separator == "," or line.startswith("Separator,") else "\t")
            found[key.strip()] = tuple(value.strip() for value in values)
    raise RefusedError("a head does not end", where=where, expected=ENDS, remedy="Copy the file again")


def _next_filled(lines: Sequence[str], at: int) -> int:
    while at < len(lines) and not lines[at].strip(" \t\r\n\x00,"):
        at += 1
    return at


def _first(head: Mapping[str, tuple[str, ...]], key: str) -> str:
    return next((value for value in head.get(key, ()) if value), "")


def _numbered(names: Sequence[str]) -> tuple[str, ...]:
    """Names in which each column of times has its own: `X_Value`, `X_Value 2`."""
    seen = 0
    found = []
    for name in names:
        seen += name == X_VALUE
        found.append(f"{name} {seen}" if name == X_VALUE and seen > 1 else name)
    return tuple(found)


def _channels(segment: _Segment) -> list[int]:
    """Positions of the columns that are channels."""
    return [i for i, name in enumerate(segment.names) if name and not name.startswith(X_VALUE) and name != COMMENT]


def _by_channel(segment: _Segment, key: str) -> list[str]:
    """What a line of the head says of each channel; empty where it says nothing."""
    channels, said = _channels(segment), segment.head.get(key, ())
    if len(said) >= len(channels) and len([s for s in said if s]) != len(channels):
        said = said[: len(channels)]
    else:
        said = tuple(s for s in said if s)[: len(channels)]
    return [*said, *[""] * (len(channels) - len(said))]


def _units(segment: _Segment, kind: str) -> tuple[str, ...]:
    units = [""] * len(segment.names)
    for at, unit in zip(_channels(segment), _by_channel(segment, "Y_Unit_Label"), strict=True):
        units[at] = unit
    along = _first(segment.head, "X_Unit_Label")
    if kind != _NO_X:
        units = [along if name.startswith(X_VALUE) else u for name, u in zip(segment.names, units, strict=True)]
    return tuple(units)


def _times(segments: Sequence[_Segment], kind: str, rows: int, where: str) -> dict[int, Float]:
    """(rows,) seconds of each channel since the first segment's start, of files that have no column of times."""
    times: dict[int, list[Float]] = {at: [] for at in _channels(segments[0])}
    starts = [_clock(segment, where) for segment in segments]
    to_s = conversion(_first(segments[0].head, "X_Unit_Label") or "s", "s", where=f"{where}: X_Unit_Label")
    head, done = segments[0], 0
    since = 0.0
    for segment, start in zip(segments, starts, strict=True):
        if segment.head:
            head, done = segment, 0
            begin = starts[0]
            since = (start - begin).total_seconds() if start is not None and begin is not None else 0.0
        before, step = _by_channel(head, "X0"), _by_channel(head, "Delta_X")
        steps = np.arange(done, done + len(segment.rows), dtype=np.float64)
        for k, at in enumerate(times):
            x0, dx = _number(before[k] or "0", where, "X0"), _number(step[k], where, "Delta_X")
            times[at].append(since + to_s.apply(x0 + dx * steps))
        done += len(segment.rows)
    return {at: np.concatenate(parts)[:rows] for at, parts in times.items()}


def _begins(segments: Sequence[_Segment], rows: int) -> tuple[int, ...]:
    """The first rows of segments with a head of their own."""
    firsts = np.concatenate(([0], np.cumsum([len(segment.rows) for segment in segments])[:-1])).astype(int)
    return tuple(int(at) for at, s in zip(firsts, segments, strict=True) if (s.head or not at) and at < rows)


def _since(segments: Sequence[_Segment], rows: int, where: str) -> Float | None:
    """(rows,) seconds from the start of the first segment to that of the row's own; None where a head tells no time."""
    if len(segments) == 1:
        return None
    parts, since = [], 0.0
    begin = _clock(segments[0], where)
    for segment in segments:
        start = _clock(segment, where)
        if segment.head and (start is None or begin is None):
            return None
        if start is not None and begin is not None:
            since = (start - begin).total_seconds()
        parts.append(np.full(len(segment.rows), since))
    return np.concatenate(parts)[:rows]


def _begins_anew(written: Float, begins: Sequence[int]) -> bool:
    """Whether the times of each segment count from its own start: they step back where one begins."""
    return all(written[at] <= written[at - 1] for at in begins if at) and len(begins) > 1


def _number(text: str, where: str, key: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise RefusedError(f'{key} is "{text[:40]}"', where=where, expected="a number") from None


def _clock(segment: _Segment, where: str) -> datetime | None:
    """The local time of a segment's head; None where it has none."""
    day, clock = _first(segment.head, "Date"), _first(segment.head, "Time").replace(",", ".")
    if not day or not clock:
        return None
    try:
        whole, _, part = clock.partition(".")
        start = datetime.strptime(f"{day.replace('-', '/')} {whole}", "%Y/%m/%d %H:%M:%S")
        return start + timedelta(seconds=float(f"0.{part or 0}"))
    except ValueError:
        raise RefusedError(
            f'the time of a segment is "{day[:20]} {clock[:30]}"', where=where, expected="YYYY/MM/DD and hh:mm:ss"
        ) from None


def _check_counts(segments: Sequence[_Segment]) -> list[str]:
    """Segments with fewer rows than their heads say."""
    short = []
    if not all(segment.head for segment in segments):
        return []  # those without a head go on with the samples of the one before
    for number, segment in enumerate(segments):
        said = [int(text) for text in _by_channel(segment, "Samples") if text.isdecimal()]
        if said and len(segment.rows) < max(said):
            of = f" of segment {number}" if len(segments) > 1 else ""
            short.append(f"there are {len(segment.rows)} of {max(said)} samples{of}: the file is cut")
    return short


def _joins(segments: Sequence[_Segment], about: Mapping[str, tuple[str, ...]]) -> list[str]:
    """What was assumed where segments follow each other."""
    if len(segments) == 1:
        return []
    if all(segment.head for segment in segments):
        return [f"{len(segments)} segments, one behind the other by the times of their heads"]
    return [f"{len(segments)} segments, those without a head counted on from the one before"]
