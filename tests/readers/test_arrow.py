"""Parquet, Feather and Arrow: files of DuckDB's own writer, of pandas and of pyarrow, sound, odd and damaged."""

from __future__ import annotations

import datetime
import decimal
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet
import pytest

from ingest import arrow_reader
from ingest.arrow_reader import ArrowFile, read_arrow
from ingest.draft import make_draft
from ingest.inspect import FITS, REFUSED, inspect
from ingest.mapping import FileMapping
from ingest.reader_kit import check_reader
from schemas.errors import RefusedError

TIME = np.arange(400) / 100
COLUMNS = {"t": TIME, "x": np.sin(TIME), "F": 0.3 * np.sin(TIME)}
ALL = FileMapping("recording", None, {}, None, {}, {}, {})
READER = SimpleNamespace(suffixes=(".parquet", ".pq", ".feather", ".arrow"), options={}, read=read_arrow)
BERLIN = datetime.timezone(datetime.timedelta(hours=1))


def write_stream(table: pa.Table, path: Path) -> None:
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_stream(file, table.schema) as writer:
        writer.write_table(table, max_chunksize=70)


WRITERS: dict[str, Callable[[pa.Table, Path], Any]] = {
    "a.parquet": lambda table, path: pyarrow.parquet.write_table(table, path, row_group_size=70),
    "a.feather": lambda table, path: pyarrow.feather.write_feather(table, path, compression="lz4", chunksize=70),
    "a.arrow": write_stream,
}


@pytest.fixture(params=WRITERS)
def write(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[pa.Table], Path]:
    def written(table: pa.Table) -> Path:
        path = tmp_path / request.param
        WRITERS[request.param](table, path)
        return path

    return written


@pytest.mark.parametrize("compression", ["snappy", "zstd", "uncompressed"])
def test_a_table_of_duckdb_is_read(tmp_path: Path, compression: str) -> None:
    path = tmp_path / "run.parquet"
    about = f"FORMAT parquet, COMPRESSION {compression}, ROW_GROUP_SIZE 2048"
    rows = 5000
    with duckdb.connect() as base:
        base.execute(
            f"COPY (SELECT i / 1000 AS t, (i % 7)::SMALLINT AS n, CASE WHEN i % 5 > 0 THEN i * 0.5 END AS F,"
            f" (i * 0.25)::DECIMAL(9, 2) AS d, TIMESTAMPTZ '2026-03-01 14:05:00+01' + INTERVAL (i) MILLISECOND AS at"
            f" FROM range({rows}) r(i)) TO '{path}' ({about})"
        )
    file = read_arrow(path, ALL)
    i = np.arange(rows)
    np.testing.assert_array_equal(file.numbers("t").values, i / 1000)
    np.testing.assert_array_equal(file.numbers("n").values, i % 7)
    np.testing.assert_array_equal(file.numbers("F").values, np.where(i % 5 > 0, i * 0.5, np.nan))
    np.testing.assert_array_equal(file.numbers("F").empty, i % 5 == 0)
    np.testing.assert_array_equal(file.numbers("d").values, i * 0.25)
    first = datetime.datetime(2026, 3, 1, 14, 5, tzinfo=BERLIN)
    assert file.cells("at")[:2] == [first, first + datetime.timedelta(milliseconds=1)]


def test_every_kind_of_column_is_read_for_what_it_is(write: Callable[[pa.Table], Path]) -> None:
    naive = datetime.datetime(2026, 3, 1, 14, 5)
    table = pa.table(
        {
            "lag": pa.array([1500, None, 0], pa.duration("ms")),
            "at": pa.array([naive.replace(tzinfo=datetime.UTC)] * 3, pa.timestamp("ns", "Europe/Berlin")),
            "clock": pa.array([naive, None, naive], pa.timestamp("us")),
            "half": pa.array(np.array([1, 2, 3], dtype=np.float16)),
            "failed": pa.array([True, False, None]),
            "money": pa.array([decimal.Decimal("1.50"), None, decimal.Decimal("-2.25")]),
            "text": pa.array(["2.5 N", "OVLD", "3"]).dictionary_encode(),
            "word": pa.array(["ok", "cut", "ok"], pa.large_string()),
            "deep": pa.array([{"a": i, "b": {"c": i / 2}} for i in range(3)]),
            "several": pa.array([[1.0, 2.0]] * 3),
        }
    )
    force = pa.field("F", pa.float64(), metadata={"unit": "mN"})
    path = write(table.append_column(force, pa.array([1.0, None, float("nan")])))
    file = read_arrow(path, ALL)
    nan = np.nan
    expected = {"lag": [1.5, nan, 0], "half": [1, 2, 3], "failed": [1, 0, nan], "money": [1.5, nan, -2.25],
                "deep.a": [0, 1, 2], "deep.b.c": [0, 0.5, 1], "F": [1, nan, nan], "text": [2.5, nan, 3]}  # fmt: skip
    for name, values in expected.items():
        np.testing.assert_array_equal(file.numbers(name).values, values, err_msg=name)
    assert file.numbers("F").empty.tolist() == [False, True, False]
    assert file.numbers("text").units["N"].tolist() == [0]
    assert (file.unit("F"), file.unit("lag"), file.unit("half")) == ("mN", "s", None)
    assert file.cells("word") == ["ok", "cut", "ok"]
    assert file.cells("clock") == [naive, None, naive]
    assert file.cells("at")[0] == naive.replace(tzinfo=datetime.UTC)
    for name, said in (("several", "a column of list"), ("at", "times, not numbers"), ("word", "holds text")):
        with pytest.raises(RefusedError, match=said):
            file.numbers(name)
    with pytest.raises(RefusedError, match="no matrices"):
        file.numbers("half", 1)


@pytest.mark.long_after(1)
def test_the_kit_passes(write: Callable[[pa.Table], Path]) -> None:
    path = write(pa.table(COLUMNS))
    check_reader(READER, path, {name: list(values) for name, values in COLUMNS.items()})


def test_a_frame_of_pandas_is_drafted_and_fits(tmp_path: Path) -> None:
    start = pd.Timestamp("2026-03-01T14:05:00.123456+01:00")
    stamps = start + pd.to_timedelta(np.arange(2000) * 500, unit="us")
    frame = pd.DataFrame(
        {"travel_mm": np.sin(np.arange(2000) / 50), "force_N": np.arange(2000) % 50 / 10}, index=stamps
    )
    path = tmp_path / "run.parquet"
    frame.rename_axis("time").to_parquet(path)
    draft = make_draft(path)
    assert {name: column["unit"] for name, column in draft.content["columns"].items()} == {
        "displacement": "mm",
        "force": "N",
    }
    assert draft.content["time"]["column"] == "time"
    toml = draft.as_toml()
    path.with_name("run.parquet.toml").write_text(toml, encoding="utf-8")
    found = inspect(path)
    assert found.verdict == FITS, found.as_text()
    assert found.channels[0].rate_hz == pytest.approx(2000)
    assert dict(found.metadata)["started_at"].startswith("2026-03-01T13:05:00.123456")


def test_two_columns_of_a_name_are_told_apart_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    table = pa.Table.from_arrays([pa.array([1.0, 2.0]), pa.array([3.0, 4.0])], names=["F", "F"])
    pyarrow.parquet.write_table(table, path)
    file = read_arrow(path, ALL)
    for column in ("F", 1):
        with pytest.raises(RefusedError, match="columns"):
            file.numbers(column)


def test_what_is_no_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    for content, said in ((b"", "cannot be read"), (b"PAR1 no", "cannot be read"), (b"FEA1" * 9, "version 1")):
        path.write_bytes(content)
        with pytest.raises(RefusedError, match=said):
            read_arrow(path, ALL)
    pyarrow.parquet.write_table(pa.table({"F": pa.array([], pa.float64())}), path)
    with pytest.raises(RefusedError, match="no rows"):
        read_arrow(path, ALL)
    path.with_name("run.parquet.toml").write_text('[columns.force]\ncolumn = "F"\n', encoding="utf-8")
    assert inspect(path).verdict == REFUSED


def test_a_column_that_inflates_without_end_is_refused_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.parquet"
    pyarrow.parquet.write_table(pa.table({"F": np.zeros(100_000)}), path, use_dictionary=False, compression="zstd")
    assert path.stat().st_size < 5000
    monkeypatch.setattr(arrow_reader, "_LARGEST", 100_000)
    with pytest.raises(RefusedError, match="inflates to"):
        read_arrow(path, ALL).numbers("F")
    monkeypatch.setattr(arrow_reader, "CELL_LIMIT", 1000)
    with pytest.raises(RefusedError, match="100000 rows"):
        read_arrow(path, ALL)


def test_only_what_is_mapped_is_read(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    pyarrow.parquet.write_table(pa.table({"F": [1.0], "l": [[1, 2]]}), path)
    file: ArrowFile = read_arrow(path, ALL)
    assert file.names() == ("F", "l")
    assert file.numbers("F").values.tolist() == [1.0]


def test_thousands_of_columns_are_told_apart_in_a_moment(tmp_path: Path) -> None:
    names = [f"c{i}" for i in range(15_000)]
    table = pa.table([pa.array([1.0])] * 15_001, names=[*names, "c7"])
    pyarrow.feather.write_feather(table, tmp_path / "wide.feather", compression="uncompressed")
    begin = time.process_time()
    found = read_arrow(tmp_path / "wide.feather", ALL)
    assert time.process_time() - begin < 2.0
    assert {one.name for one in found.listed if one.refusal} == {"c7"}
