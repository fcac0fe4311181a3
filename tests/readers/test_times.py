"""Instants of samples from elapsed, Unix and absolute times; zones; rates."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ingest.mapping import FileMapping
from ingest.read import read_raw
from ingest.times import from_seconds, uniform
from schemas.errors import RefusedError
from schemas.recording import RawRecording

START = "2026-03-01T14:00:00+00:00"
START_NS = int(datetime.fromisoformat(START).timestamp()) * 10**9


def times(path: Path, cells: list[str], time: dict[str, Any], started: Any = START) -> list[int]:
    return raw_of(path, cells, time, started).channels[0].time_ns.tolist()


def raw_of(path: Path, cells: list[str], time: dict[str, Any], started: Any = START) -> RawRecording:
    path.write_text("t,F\n" + "".join(f"{c},{i}.5\n" for i, c in enumerate(cells)))
    content = {
        "time": {"column": "t", **time},
        "columns": {"force": {"column": "F", "unit": "N"}},
        "recording": {} if started is None else {"started_at": started},
    }
    raw = read_raw(path, FileMapping.parse(content, stem="run", suffix=".csv", source="run.csv.toml"))
    assert isinstance(raw, RawRecording)
    return raw


def test_elapsed_units(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    assert times(path, ["0", "1.5"], {"unit": "ms"}) == [START_NS, START_NS + 1_500_000]
    assert times(path, ["1", "2"], {"unit": "min"}) == [START_NS + 60 * 10**9, START_NS + 120 * 10**9]


def test_unix_time(tmp_path: Path) -> None:
    assert times(tmp_path / "run.csv", ["1772373600", "1772373601"], {"unit": "s", "origin": "unix"}, None) == [
        1772373600 * 10**9,
        1772373601 * 10**9,
    ]


def test_absolute_times_with_and_without_zone(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    expected = [START_NS, START_NS + 250_000_000]
    zoned = ["2026-03-01T15:00:00+01:00", "2026-03-01T15:00:00.25+01:00"]
    assert times(path, zoned, {"format": "iso"}, None) == expected
    naive = ["01.03.2026 15:00:00.00", "01.03.2026 15:00:00.25"]
    pattern = {"format": "%d.%m.%Y %H:%M:%S.%f"}
    assert times(path, naive, {**pattern, "zone": "Europe/Zurich"}, None) == expected
    with pytest.raises(RefusedError, match="no zone"):
        times(path, naive, pattern, None)
    with pytest.raises(RefusedError, match=r"row 2 of the data"):
        times(path, [naive[0], "yesterday"], {**pattern, "zone": "UTC"}, None)
    with pytest.raises(RefusedError, match="Europe/Nowhere"):
        times(path, naive, {**pattern, "zone": "Europe/Nowhere"}, None)


@pytest.mark.parametrize(
    ("pattern", "cell"),
    [
        ("%d. %B %Y %H:%M:%S", "1. März 2026 14:00:00"),
        ("%d. %b %Y %H:%M:%S", "01. Mrz 2026 14:00:00"),
        ("%d-%b-%Y %H:%M:%S", "01-mars-2026 14:00:00"),
        ("%d %b. %Y %H:%M:%S", "1 mars 2026 14:00:00"),
        ("%d %B de %Y %H:%M:%S", "1 MARZO de 2026 14:00:00"),
        ("%Y/%m/%d %p %I:%M:%S", "2026/3/1 下午 02:00:00"),
        ("%d/%m/%Y %I:%M:%S %p", "01/03/2026 02:00:00 p. m."),
        ("%d-%b-%Y %H:%M:%S", "01-Mar-2026 14:00:00"),
    ],
)
def test_words_of_other_languages_in_times(tmp_path: Path, pattern: str, cell: str) -> None:
    time = {"format": pattern, "zone": "UTC"}
    assert times(tmp_path / "run.csv", [cell, cell.replace(":00:00", ":00:01")], time, None) == [
        START_NS,
        START_NS + 10**9,
    ]


@pytest.mark.parametrize(
    ("month", "cell"),
    [
        (1, "janv."),
        (2, "févr."),
        (4, "avr."),
        (5, "mai"),
        (7, "juil."),
        (8, "août"),
        (9, "sept."),
        (10, "oct."),
        (12, "déc."),
    ],
)
def test_months_that_are_cut_with_and_without_a_dot(tmp_path: Path, month: int, cell: str) -> None:
    time = {"format": "%d %b %Y %H:%M:%S", "zone": "UTC"}
    (found, _) = times(tmp_path / "run.csv", [f"02 {cell} 2025 12:00:00", f"02 {cell} 2025 12:00:01"], time, None)
    assert datetime.fromtimestamp(found / 1e9, UTC) == datetime(2025, month, 2, 12, tzinfo=UTC)


def test_a_month_of_no_language_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="row 1 of the data"):
        times(tmp_path / "run.csv", ["1 Nivôse 2026 14:00:00"], {"format": "%d %B %Y %H:%M:%S", "zone": "UTC"}, None)


@pytest.mark.parametrize("pattern", ["iso", "%Y-%m-%dT%H:%M:%S.%f%z"])
def test_nanoseconds_in_text_are_kept(tmp_path: Path, pattern: str) -> None:
    cells = ["2026-03-01T14:00:00.1234567+00:00", "2026-03-01T14:00:00.123456789+00:00"]
    expected = [START_NS + 123_456_700, START_NS + 123_456_789]
    assert times(tmp_path / "run.csv", cells, {"format": pattern}, None) == expected


@pytest.mark.parametrize("started", ["2026-03-01T15:00:00", datetime(2026, 3, 1, 15)])
def test_start_without_zone(tmp_path: Path, started: Any) -> None:
    path = tmp_path / "run.csv"
    assert times(path, ["0", "1"], {"unit": "s", "zone": "Europe/Zurich"}, started)[0] == START_NS
    with pytest.raises(RefusedError, match="started_at"):
        times(path, ["0", "1"], {"unit": "s"}, started)


def test_start_with_zone_is_not_moved_by_the_zone(tmp_path: Path) -> None:
    assert times(tmp_path / "run.csv", ["0", "1"], {"unit": "s", "zone": "Asia/Tokyo"})[0] == START_NS


def test_missing_start_and_missing_unit_are_named(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="started_at is missing"):
        times(tmp_path / "run.csv", ["0", "1"], {"unit": "s"}, None)
    with pytest.raises(RefusedError, match='time column "t" has no unit'):
        times(tmp_path / "run.csv", ["0", "1"], {})


def test_rows_without_time_are_left_out(tmp_path: Path) -> None:
    assert times(tmp_path / "run.csv", ["0", "", "2"], {"unit": "s"}) == [START_NS, START_NS + 2 * 10**9]


def test_absurd_time_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="2116"):
        times(tmp_path / "run.csv", ["0", "1e12"], {"unit": "s"})


@given(st.integers(0, 10**7), st.floats(0.1, 1e6))
def test_uniform_times_do_not_drift(count: int, rate: float) -> None:
    last = min(count, 1000)
    found = uniform(last + 1, rate, START_NS) - START_NS
    assert found[0] == 0
    assert abs(int(found[-1]) - last * 1e9 / rate) <= 1


@given(st.lists(st.integers(0, 10**15), min_size=1, max_size=50))
def test_seconds_to_nanoseconds(nanoseconds: list[int]) -> None:
    seconds = np.array(nanoseconds) * 1e-9
    start = int(datetime(2026, 1, 1, tzinfo=UTC).timestamp()) * 10**9
    found = from_seconds(seconds, start, "") - start
    assert np.abs(found - np.array(nanoseconds)).max() <= 128  # half a step of a double at 1e6 s


LOCAL = START_NS - 14 * 3600 * 10**9  # midnight UTC of the day of START


def test_hours_minutes_seconds_since_the_start(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    begin = START_NS + (23 * 3600 + 59 * 60 + 59) * 10**9
    cells = ["23:59:59.000", "24:00:00.500", "25:00:01"]
    assert times(path, cells, {"unit": "s"}) == [begin, begin + 1_500_000_000, begin + 3602 * 10**9]
    assert times(path, cells, {"format": "elapsed"}) == [begin, begin + 1_500_000_000, begin + 3602 * 10**9]
    assert times(path, ["00:00:00", "00:01:30"], {}) == [START_NS, START_NS + 90 * 10**9]
    assert times(path, ["00:00.2", "01:30.4"], {}) == [START_NS + 200_000_000, START_NS + 90_400_000_000]
    assert times(path, ["01:10", "01:30"], {"format": "mm:ss"}) == [START_NS + 70 * 10**9, START_NS + 90 * 10**9]


@pytest.mark.parametrize(
    ("cells", "expected_s"),
    [
        (["1.02:00:00", "1.02:00:00.25"], [93_600, 93_600.25]),  # .NET
        (["23:59:59.5", "1.00:00:00"], [86_399.5, 86_400]),
        (['"1 day, 2:00:00"', '"2 days, 2:00:01"'], [93_600, 180_001]),  # Python
        (["0 days 00:00:01.500000", "10 days 00:00:02"], [1.5, 864_002]),  # pandas
        (["00:00:01:500", "26:00:01:007"], [1.5, 93_601.007]),  # milliseconds behind a colon
    ],
)
def test_durations_with_days_and_milliseconds(tmp_path: Path, cells: list[str], expected_s: list[float]) -> None:
    found = times(tmp_path / "run.csv", cells, {"format": "elapsed"})
    assert (np.array(found) - START_NS).tolist() == [round(s * 1e9) for s in expected_s]


@pytest.mark.parametrize(
    "cell", ["00:00:01:25", "1:02:03:04", "1.5:00", "2 days", "00:00:01.5:500", "-1 day, 23:00:00"]
)
def test_durations_of_two_meanings_are_refused(tmp_path: Path, cell: str) -> None:
    with pytest.raises(RefusedError, match="row 2 of the data"):
        times(tmp_path / "run.csv", ["00:00:00", f'"{cell}"'], {"format": "elapsed"})


def test_times_of_day_take_their_date_from_the_start_and_pass_midnight(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    started = "2026-03-04T23:59:58+01:00"
    begin = int(datetime.fromisoformat(started).timestamp()) * 10**9
    cells = ["23:59:58.0", "23:59:59.5", "00:00:01.0", "00:00:02"]
    expected = [begin, begin + 1_500_000_000, begin + 3 * 10**9, begin + 4 * 10**9]
    assert times(path, cells, {}, started) == expected  # the start tells that they are times of day
    assert times(path, cells, {"format": "time_of_day"}, started) == expected
    late = ["00:00:01.0", "00:00:02"]
    assert times(path, late, {"format": "time_of_day"}, started) == expected[2:]
    with pytest.raises(RefusedError, match="no started_at"):
        times(path, cells, {"format": "%H:%M:%S.%f", "zone": "UTC"}, None)
    with pytest.raises(RefusedError, match="a time of day or a time since the start"):
        times(path, ["14:20:00", "14:20:01"], {}, "2026-03-01T08:00:00+00:00")
    with pytest.raises(RefusedError, match="may be a time of day"):
        times(path, ["14:00:00", "14:00:01"], {"unit": "s"})


def test_date_and_time_in_two_columns(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("d,t,F\n28.02.2026,23:59:59,1\n01.03.2026,00:00:00,2\n")
    content = {
        "time": {"column": "t", "date_column": "d", "format": "%d.%m.%Y %H:%M:%S", "zone": "UTC"},
        "columns": {"force": {"column": "F", "unit": "N"}},
        "recording": {},
    }
    raw = read_raw(path, FileMapping.parse(content, stem="run", suffix=".csv"))
    assert isinstance(raw, RawRecording)
    assert raw.channels[0].time_ns.tolist() == [LOCAL - 10**9, LOCAL]


@pytest.mark.parametrize(
    ("cells", "time"),
    [
        (["46082.5", "46082.500011574074"], {"origin": "excel", "zone": "UTC"}),
        (["46082.5", "46082.500011574074"], {"origin": "1899-12-30", "unit": "d", "zone": "UTC"}),
        (["44620.5", "44620.500011574074"], {"origin": "excel_1904", "zone": "UTC"}),
        (["740042.5", "740042.500011574074"], {"origin": "matlab", "zone": "UTC"}),
        (["3855211200", "3855211201"], {"origin": "labview", "unit": "s"}),
        (["3855211200", "3855211201"], {"origin": "1904-01-01T00:00:00Z", "unit": "s"}),
        (["1772366400000", "1772366401000"], {"origin": "unix", "unit": "ms"}),
        (["46082.541666666664", "46082.541678240744"], {"origin": "excel", "zone": "Europe/Zurich"}),
    ],
)
def test_serial_days_and_epochs(tmp_path: Path, cells: list[str], time: dict[str, Any]) -> None:
    noon = LOCAL + 12 * 3600 * 10**9  # 2026-03-01 12:00 UTC
    found = times(tmp_path / "run.csv", cells, time, None)
    assert np.abs(np.array(found) - [noon, noon + 10**9]).max() < 20_000  # a double holds a serial day to 10 µs


@pytest.mark.parametrize(
    ("cells", "time"),
    [
        (["46082.5", "46082.6"], {"origin": "unix", "unit": "d"}),  # the year 2096
        (["12", "13"], {"origin": "unix", "unit": "s"}),  # a clock that was never set
        (["1.7e9", "1.8e9"], {"origin": "labview", "unit": "s"}),  # 1957
    ],
)
def test_a_wrong_epoch_is_refused(tmp_path: Path, cells: list[str], time: dict[str, Any]) -> None:
    with pytest.raises(RefusedError, match="since 1980 that is not in the future"):
        times(tmp_path / "run.csv", cells, time)


def test_another_zone_or_day_than_the_start_is_a_problem(tmp_path: Path) -> None:
    def problems(cell: str, zone: str = "UTC") -> tuple[str, ...]:
        path = tmp_path / "run.csv"
        path.write_text(f"t,F\n{cell},1\n")
        content = {
            "time": {"column": "t", "format": "iso", "zone": zone},
            "columns": {"force": {"column": "F", "unit": "N"}},
            "recording": {"started_at": START},
        }
        return read_raw(path, FileMapping.parse(content, stem="run", suffix=".csv")).problems

    assert problems("2026-03-01 14:00:01") == ()
    assert problems("2026-03-01 15:00:01", "Europe/Zurich") == ()
    assert problems("2026-03-01 14:25:00") == ()
    assert "1 h after started_at, as if its zone were another" in problems("2026-03-01 15:00:01")[0]
    assert "31 d after started_at" in problems("2026-04-01 14:00:00")[0]


def test_the_hour_that_occurs_twice(tmp_path: Path) -> None:
    """Europe/Zurich goes from 03:00 summer time back to 02:00 on 2026-10-25, which is 01:00 UTC."""
    path = tmp_path / "run.csv"
    one = int(datetime(2026, 10, 25, 1, 0, tzinfo=UTC).timestamp()) * 10**9
    minute = 60 * 10**9
    time = {"format": "iso", "zone": "Europe/Zurich"}
    day = "2026-10-25 "

    def found(*clocks: str, started: str | None = None) -> list[float]:
        return [(t - one) / minute for t in times(path, [day + c for c in clocks], time, started)]

    assert found("02:58:00", "02:59:00", "02:00:00", "02:01:00", "03:00:00") == [-2, -1, 0, 1, 60]
    assert found("01:59:00", "02:00:00", "02:59:00") == [-61, -60, -1]
    assert found("02:58:00", "02:59:00", "03:00:00") == [58, 59, 60]  # else an hour would be missing
    assert found("02:30:00", "02:31:00", started="2026-10-25T01:30:00+00:00") == [30, 31]
    assert found("02:30:00", "02:31:00", started="2026-10-25T00:30:00+00:00") == [-30, -29]
    assert found("01:59:59", "03:00:00") == pytest.approx([-60 - 1 / 60, 60])


@pytest.mark.parametrize(
    ("zone", "cells", "gone"),
    [
        ("Europe/Berlin", ["2026-03-29 01:59:00", "2026-03-29 02:00:00", "2026-03-29 02:59:00"], 2),
        ("Europe/Berlin", ["2026-03-29 01:59:00", "2026-03-29 03:00:00"], 0),
        ("America/New_York", ["2026-03-08 02:30:00", "2026-03-08 02:31:00"], 2),
        ("Australia/Lord_Howe", ["2026-10-04 02:15:00", "2026-10-04 02:45:00"], 1),  # half an hour
        ("Asia/Shanghai", ["2026-03-29 02:00:00", "2026-03-29 02:59:00"], 0),
    ],
)
def test_times_in_the_hour_that_is_skipped_are_a_problem(
    tmp_path: Path, zone: str, cells: list[str], gone: int
) -> None:
    raw = raw_of(tmp_path / "run.csv", cells, {"format": "iso", "zone": zone}, None)
    told = [p for p in raw.problems if "do not exist" in p]
    assert len(told) == (gone > 0)
    assert all(f"{gone} times" in p and zone in p and "winter time" in p for p in told)


def test_the_unit_row_of_the_time_is_compared_too(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,F\nms,N\n0,1\n10,2\n")
    content = {
        "csv": {"unit_row": True},
        "time": {"column": "t", "unit": "s"},
        "columns": {"force": {"column": "F", "unit": "N"}},
        "recording": {"started_at": START},
    }
    with pytest.raises(RefusedError, match='the unit row says "ms" for column "t", the mapping says "s"'):
        read_raw(path, FileMapping.parse(content, stem="run", suffix=".csv"))


@pytest.mark.parametrize("name", ["Time (ms)", "t_ms", "Zeit ms", "Time in ms"])
def test_the_unit_in_the_name_of_the_time_is_compared_too(tmp_path: Path, name: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text(f"{name},F\n0,1\n10,2\n")
    columns = {"force": {"column": "F", "unit": "N"}}
    about = {"columns": columns, "recording": {"started_at": START}}
    time = {"column": name, "unit": "s"}
    with pytest.raises(RefusedError, match='the name says "ms" for column'):
        read_raw(path, FileMapping.parse({"time": time, **about}, stem="run", suffix=".csv"))
    raw = read_raw(
        path, FileMapping.parse({"time": {**time, "overrule_unit": True}, **about}, stem="run", suffix=".csv")
    )
    assert isinstance(raw, RawRecording)
    assert np.diff(raw.channels[0].time_ns).tolist() == [10 * 10**9]


def test_what_is_assumed_of_times_is_said(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"

    def assumed(cells: list[str], time: dict[str, Any], started: Any = START) -> dict[str, str]:
        return {one.what: one.value for one in raw_of(path, cells, time, started).assumptions}

    zurich = {"format": "%d.%m.%Y %H:%M:%S", "zone": "Europe/Zurich"}
    begins = {"start of the recording": "its first sample"}
    assert assumed(["0", "1"], {"unit": "s"}) == {}
    assert assumed(["0", "1"], {"unit": "s", "zone": "Europe/Zurich"}) == {}, "no time of the file needs the zone"
    assert assumed(["01.03.2026 15:00:00"], zurich, None) == {"time zone": "Europe/Zurich", **begins}
    assert assumed(["0", "1"], {"unit": "s", "zone": "UTC"}, "2026-03-01T15:00:00") == {"time zone": "UTC"}
    assert assumed(["2026-03-01T15:00:00+01:00"], {"format": "iso"}, None) == begins
