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
    path.write_text("t,F\n" + "".join(f"{c},{i}.5\n" for i, c in enumerate(cells)))
    content = {
        "time": {"column": "t", **time},
        "columns": {"force": {"column": "F", "unit": "N"}},
        "recording": {} if started is None else {"started_at": started},
    }
    raw = read_raw(path, FileMapping.parse(content, stem="run", suffix=".csv", source="run.csv.toml"))
    assert isinstance(raw, RawRecording)
    return raw.channels[0].time_ns.tolist()


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
