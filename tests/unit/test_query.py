"""Read-only SQL: what may be asked, what may not, and that nothing on the disk is touched or read on the way."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import time
import unicodedata
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline import Lab
from pipeline.cli import main
from pipeline.commands.show.rows import FORMATS, as_csv, as_json, as_parquet, as_table
from pipeline.lab.query import Limits, Query
from pipeline.lab.snapshot import Changes, publish
from schemas.database import connect
from schemas.errors import DealabError, LabError, UsageError
from schemas.tables import TABLES
from schemas.views import EXAMPLES

HOSTILE = "\x1b[2J<script>alert(1)</script>'; DROP TABLE recordings; --\u202e"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    made = Lab(tmp_path_factory.mktemp("query") / "lab [a]*'")
    made.create()
    relative = "samples/protocol=chirp/month=2026-03/r-1.parquet"
    path = made.folder / relative
    path.parent.mkdir(parents=True)
    pq.write_table(pa.table({"time_ns": np.arange(5), "force": np.arange(5) / 2}), path)
    (made.folder / "outside.parquet").write_bytes(path.read_bytes())
    rows = [
        {"recording_id": "r-1", "samples_path": relative, "notes": HOSTILE, "duration_s": 1.5},
        {"recording_id": "r-2", "samples_path": "outside.parquet", "duration_s": float("nan")},
        {"recording_id": "r-3", "samples_path": "samples/missing.parquet"},
    ]
    full = [row | {"status": "ok", "source_path": row["recording_id"]} for row in rows]
    publish(made, Changes(insertions=[{"recordings": TABLES["recordings"].rows(full)}]))
    return made


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty working folder that has to stay empty."""
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    assert list(tmp_path.iterdir()) == []


def ask(lab: Lab, query: str) -> pa.Table:
    with Query(lab) as database:
        return database.run(query)


@pytest.mark.parametrize(
    "query",
    [
        "SELECT recording_id FROM recordings",
        "SELECT 1;",
        "  -- a remark\n SELECT 1",
        "FROM recordings",
        "TABLE recordings",
        "VALUES (1), (2)",
        "WITH a AS (SELECT 1 AS x) SELECT * FROM a",
        "WITH a AS MATERIALIZED (SELECT 1 AS x) FROM a",
        "WITH RECURSIVE t(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM t WHERE i < 3) FROM t",
        "SELECT 1 UNION ALL SELECT 2 EXCEPT SELECT 3",
        "SELECT * FROM (PIVOT recordings ON status IN ('ok', 'damaged') USING count(*))",
        "DESCRIBE recordings",
        "SUMMARIZE recordings",
        "SHOW TABLES",
        "EXPLAIN SELECT 1",
        "explain /* ( */ analyze SELECT 1",
        "EXPLAIN (FORMAT JSON) SELECT 1",
        "EXPLAIN (SELECT 1)",
        "SELECT 'COPY x TO y; INSERT_QUERY_NODE' AS type",
        "SELECT * FROM query('SELECT 1')",
    ],
)
def test_reading_is_answered(lab: Lab, here: Path, query: str) -> None:
    assert ask(lab, query).num_rows > 0


@pytest.mark.long_after(45)
@pytest.mark.parametrize(
    "query",
    [
        "",
        "-- nothing",
        "SELECT 1; SELECT 2",
        "SELECT 1; DROP TABLE recordings",
        "COPY recordings TO 'x.csv'",
        "COPY (SELECT 1) TO 'x.parquet' (FORMAT parquet)",
        "EXPLAIN ANALYZE COPY (SELECT 1) TO 'x.csv'",
        "EXPLAIN COPY recordings TO 'x.csv'",
        "EXPLAIN (FORMAT JSON) COPY recordings TO 'x.csv'",
        "EXPLAIN ANALYZE INSERT INTO recordings (recording_id) VALUES ('x')",
        "WITH a AS (COPY (SELECT 1) TO 'x.csv') SELECT 1",
        "EXPLAIN ANALYZE WITH a AS (COPY (SELECT 1) TO 'x.csv') SELECT 1",
        "WITH a AS (INSERT INTO recordings (recording_id) VALUES ('x') RETURNING *) SELECT * FROM a",
        "WITH b AS (WITH a AS (DELETE FROM recordings RETURNING *) FROM a) SELECT * FROM b",
        "SELECT (WITH a AS (UPDATE recordings SET status = 'x' RETURNING 1) SELECT count(*) FROM a)",
        "SELECT * FROM query('COPY (SELECT 1) TO ''x.csv''')",
        "EXPORT DATABASE 'x'",
        "IMPORT DATABASE 'x'",
        "ATTACH 'x.duckdb'",
        "ATTACH ':memory:' AS m",
        "INSTALL httpfs",
        "LOAD httpfs",
        "SET threads = 1",
        "RESET threads",
        "SET enable_external_access = true",
        "PRAGMA database_list",
        "PRAGMA enable_profiling",
        "CALL pragma_version()",
        "CREATE TABLE x AS SELECT 1",
        "CREATE TEMP TABLE x AS SELECT 1",
        "CREATE MACRO f() AS 1",
        "INSERT INTO recordings (recording_id) VALUES ('x')",
        "DELETE FROM recordings",
        "UPDATE recordings SET status = 'x'",
        "DROP TABLE recordings",
        "ALTER TABLE recordings RENAME TO r",
        "MERGE INTO recordings USING runs ON true WHEN MATCHED THEN DELETE",
        "TRUNCATE recordings",
        "VACUUM",
        "CHECKPOINT",
        "FORCE CHECKPOINT",
        "BEGIN",
        "PREPARE p AS SELECT 1",
        "EXECUTE p",
        "USE memory",
        "COMMENT ON TABLE recordings IS 'x'",
        "PIVOT recordings ON status USING count(*)",
        "SELECT * FROM read_csv('/etc/passwd')",
        "SELECT * FROM read_text('/etc/passwd')",
        "SELECT * FROM read_blob('/etc/passwd')",
        "SELECT * FROM '/etc/passwd'",
        "SELECT * FROM 'x.csv'",
        "SELECT * FROM glob('/*')",
        "SELECT * FROM parquet_metadata('/etc/passwd')",
        "SELECT * FROM read_parquet('http://localhost/x.parquet')",
        "SELECT * FROM sqlite_scan('x', 'y')",
        "SELECT * FROM here",
        "SELECT getenv('HOME')",
    ],
)
def test_everything_else_is_refused_and_nothing_is_written(lab: Lab, here: Path, query: str) -> None:
    before = lab.database.read_bytes()
    with pytest.raises(DealabError):
        ask(lab, query)
    assert lab.database.read_bytes() == before


def test_no_query_reads_a_parquet_file_that_is_not_offered(lab: Lab, here: Path) -> None:
    path = lab.folder / "samples/protocol=chirp/month=2026-03/r-1.parquet"
    for query in (f"SELECT * FROM '{path}'", f"SELECT * FROM read_parquet('{path}')", f"COPY (SELECT 1) TO '{path}'"):
        with pytest.raises(DealabError):
            ask(lab, query.replace("lab [a]*'", "lab [a]*''"))
    assert pq.ParquetFile(path).metadata.num_rows == 5


def test_samples_of_a_recording_in_the_same_query(lab: Lab, here: Path) -> None:
    found = ask(
        lab, "SELECT r.recording_id, max(s.force) AS f FROM recordings r, samples('r-1') s GROUP BY 1 ORDER BY 1"
    )
    assert found.to_pylist()[0] == {"recording_id": "r-1", "f": 2.0}
    assert ask(lab, "SELECT count(*) AS n FROM samples('r-1') WHERE force > 0.9").to_pylist() == [{"n": 3}]


@pytest.mark.parametrize("name", ["r-2", "r-3", "nobody", "../../outside", "samples/*"])
def test_samples_that_are_not_in_the_lab_are_told(lab: Lab, here: Path, name: str) -> None:
    with pytest.raises(DealabError, match="no samples of recording"):
        ask(lab, f"SELECT * FROM samples('{name}')")


def test_errors_name_the_right_column(lab: Lab) -> None:
    with pytest.raises(DealabError, match="recording_id") as caught:
        ask(lab, "SELECT recrding_id FROM recordings")
    assert "LINE 1" in str(caught.value)


def test_the_examples_are_answered(lab: Lab) -> None:
    for _question, query in EXAMPLES:
        ask(lab, query.replace("RECORDING_ID", "r-1"))


def test_the_examples_can_be_typed_between_double_quotes() -> None:
    assert not [query for _, query in EXAMPLES if set(query) & set('"$`\\!')]


def test_without_a_database_the_remedy_is_named(tmp_path: Path) -> None:
    with pytest.raises(LabError, match="dealab nightly"):
        ask(Lab(tmp_path), "SELECT 1")
    (tmp_path / "results.duckdb").write_bytes(os.urandom(8192))
    with pytest.raises(LabError, match="cannot be opened"):
        ask(Lab(tmp_path), "SELECT 1")


def test_a_lab_in_python_gives_frames(lab: Lab) -> None:
    frame = Lab(lab.folder).sql("SELECT recording_id, duration_s FROM recordings ORDER BY 1")
    assert list(frame["recording_id"]) == ["r-1", "r-2", "r-3"]


ODD = "SELECT 1.5 AS x, 'nan'::DOUBLE AS n, NULL AS z, TIMESTAMPTZ '2026-03-01 08:00:00+00' AS t, [1, 2] AS l, {'a': 'b'} AS s"


def test_formats(lab: Lab) -> None:
    rows = ask(lab, ODD)
    assert json.loads(as_json(rows)) == [
        {"x": 1.5, "n": None, "z": None, "t": "2026-03-01T08:00:00+00:00", "l": [1, 2], "s": {"a": "b"}}
    ]
    assert as_csv(rows) == 'x,n,z,t,l,s\n1.5,nan,,2026-03-01T08:00:00+00:00,"[1, 2]","{""a"": ""b""}"'
    content = FORMATS["parquet"](rows)
    assert isinstance(content, bytes)
    assert pq.read_table(pa.BufferReader(content)).num_rows == 1
    assert as_table(rows).splitlines()[-1] == "(1 row)"


def make_rows(**columns: list[object]) -> pa.Table:
    return pa.table(columns)


def test_rows_fit_into_the_terminal() -> None:
    rows = make_rows(specimen_id=["P-07", "P-08"], k0=[1.25, 0.5], notes=["a long story " * 5, "试样七号" * 9])
    whole = as_table(rows).splitlines()
    assert max(map(len, whole)) > 60
    narrow = as_table(rows, width=40).splitlines()
    assert [line.split()[:2] for line in narrow[2:4]] == [["P-07", "1.25"], ["P-08", "0.5"]], (
        "numbers and names are whole"
    )
    assert narrow[2].endswith("…")
    assert len(narrow[2]) == 40
    assert len(narrow[3]) < measure(narrow[3]) <= 40, "its letters take two columns each"
    assert as_table(rows, width=500) == as_table(rows)


def test_rows_that_fit_into_no_line_are_expanded() -> None:
    rows = make_rows(**{f"a_rather_long_name_{i}": [i, 10 * i] for i in range(6)}, notes=["x" * 200, None])
    assert as_table(rows, width=60) == as_table(rows, width=60, expanded=True)
    lines = as_table(rows, width=60).splitlines()
    assert lines[0].startswith("── row 1 ─")
    assert lines[1] == "a_rather_long_name_0  0"
    assert lines[7] == "notes" + " " * 17 + "x" * 200, "in full"
    assert lines[-1] == "(2 rows)"
    assert len(lines) == 1 + 2 * 8


@given(
    st.lists(st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=30), min_size=1, max_size=6, unique=True),
    st.lists(st.text(max_size=100), min_size=1, max_size=4),
    st.integers(10, 120),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_no_line_of_a_table_is_wider_than_the_terminal(names: list[str], texts: list[str], width: int) -> None:
    rows = make_rows(**{name: list(texts) for name in names})
    lines = as_table(rows, width=width).splitlines()
    if len(names) > 1 and not lines[0].startswith("── row 1"):
        assert all(measure(line) <= width for line in lines[:-1])


def measure(line: str) -> int:
    """Columns of a terminal, by the standard's table alone."""
    return sum(0 if unicodedata.combining(c) else 1 + (unicodedata.east_asian_width(c) in "WF") for c in line)


def test_expanded_goes_with_tables_alone(lab: Lab, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sql", "SELECT 1 AS one", "--expanded", "--lab", str(lab.folder)]) == 0
    assert capsys.readouterr().out.splitlines()[1] == "one  1"
    assert main(["sql", "SELECT 1", "--expanded", "--format", "csv", "--lab", str(lab.folder)]) == 2
    assert "--expanded with --format csv" in capsys.readouterr().err


def test_text_of_others_cannot_control_the_terminal(lab: Lab) -> None:
    shown = as_table(ask(lab, "SELECT notes, recording_id FROM recordings WHERE recording_id = 'r-1'"))
    assert "\x1b" not in shown
    assert "\u202e" not in shown
    assert "<script>" in shown, "it is shown as text"


def test_a_plan_is_shown_as_it_is(lab: Lab) -> None:
    assert "SEQ_SCAN" in as_table(ask(lab, "EXPLAIN SELECT * FROM recordings")).upper().replace(" ", "_")


def test_parquet_is_refused_for_what_is_no_select(lab: Lab) -> None:
    with pytest.raises(UsageError, match="PIVOT"):
        ask(lab, "PIVOT recordings ON status USING count(*)")


ENDLESS = "SELECT count(*) FROM range(10000000000) a, range(1000) b WHERE hash(a.range, b.range) = 1"


def test_a_query_keeps_to_its_limits(lab: Lab) -> None:
    """Of time, rows and memory; nothing is spilt into the lab, and each refusal names the switch."""
    before = sorted(lab.folder.rglob("*"))
    for limits, query, remedy in (
        (Limits(seconds=0.3), ENDLESS, "--timeout-s"),
        (Limits(rows=1000), "SELECT * FROM range(2000)", "--rows"),
        (Limits(memory_mb=64), "SELECT range AS r FROM range(100000000) ORDER BY hash(r)", "--memory-mb"),
    ):
        began = time.monotonic()
        with Query(lab, limits) as database, pytest.raises(DealabError, match=remedy):
            database.run(query)
        assert time.monotonic() - began < 20
        assert sorted(lab.folder.rglob("*")) == before
    with Query(lab, Limits(seconds=0, rows=0, memory_mb=0)) as database:
        assert database.run("SELECT * FROM range(2000)").num_rows == 2000


class Deaf:
    """A connection whose query takes no notice of interrupts, as one that makes a single text of gigabytes."""

    def __init__(self, connection: Any) -> None:
        self.real = connection

    def __getattr__(self, name: str) -> Any:
        return (lambda: None) if name == "interrupt" else getattr(self.real, name)


def test_a_query_that_does_not_listen_is_left_behind(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.lab.query._STOPPED_S", 0.2)
    deaf: list[Deaf] = []

    def connect_deaf(path: Path, **options: Any) -> Deaf:
        deaf.append(Deaf(connect(path, **options)))
        return deaf[0]

    monkeypatch.setattr("pipeline.lab.query.connect", connect_deaf)
    with pytest.raises(DealabError, match="--timeout-s"), Query(lab, Limits(seconds=0.2)) as database:
        database.run(ENDLESS)
    deaf[0].real.interrupt()
    monkeypatch.undo()
    for _ in range(100):  # it closes its connection, whose locked settings nobody else could open the database with
        with contextlib.suppress(LabError), Query(lab) as database:
            assert database.run("SELECT 1").num_rows == 1
            return
        time.sleep(0.1)
    pytest.fail("the connection stays open")


def test_an_interrupt_ends_a_query_at_once(lab: Lab) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        began = time.monotonic()
        with pytest.raises(KeyboardInterrupt), Query(lab) as database:
            database.run(ENDLESS)
        assert time.monotonic() - began < 5
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_an_interrupt_before_the_query_begins_is_one(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    """DuckDB made an error of its own of it: a traceback where Ctrl-C fell into the look-up of the recordings."""

    def fail(*_: object) -> None:
        raise RuntimeError("Query interrupted")

    monkeypatch.setattr(Query, "_offer_samples", fail)
    with pytest.raises(KeyboardInterrupt), Query(lab) as database:
        database.run("SELECT 1")


@pytest.mark.parametrize("form", ["table", "csv", "json"])
def test_columns_of_one_name_are_all_there(lab: Lab, form: str) -> None:
    with Query(lab) as database:
        rows = database.run("SELECT 11 AS a, 22 AS a, 33 AS a_1, 44 AS a, 55 AS A")
    assert rows.column_names == ["a", "a_1", "a_1_1", "a_2", "A"]
    text = FORMATS[form](rows)
    assert isinstance(text, str)
    assert all(value in text for value in ("11", "22", "33", "44", "55"))
    assert lab.sql("SELECT 1 AS a, 2 AS a").iloc[0].tolist() == [1, 2]


def test_recordings_whose_ids_differ_by_case_are_two(tmp_path: Path) -> None:
    made = Lab(tmp_path)
    rows = []
    for number, name in enumerate(("run-a", "RUN-A", "Run-A")):
        path = tmp_path / f"samples/protocol=chirp/month=2026-03/{number}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table({"time_ns": np.arange(3), "force": np.full(3, float(number))}), path)
        about = {"status": "ok", "source_path": name, "samples_path": path.relative_to(tmp_path).as_posix()}
        rows.append({"recording_id": name} | about)
    publish(made, Changes(insertions=[{"recordings": TABLES["recordings"].rows(rows)}]))
    for number, name in enumerate(("run-a", "RUN-A", "Run-A")):
        assert made.sql(f"SELECT force FROM samples('{name}')")["force"].tolist() == [number] * 3
    both = made.sql("SELECT a.force, b.force FROM samples('run-a') a JOIN samples('RUN-A') b USING (time_ns)")
    assert both.iloc[0].tolist() == [0.0, 1.0]


BEYOND = (
    "SELECT TIMESTAMP '290000-01-01 12:00:00' AS late, DATE '5000-01-01 (BC)' AS early, 'infinity'::TIMESTAMP AS never,"
    " '-infinity'::DATE AS before, 'infinity'::TIMESTAMPTZ AS zoned, {'day': 'infinity'::DATE, 'n': [DATE '2026-03-01']} AS s,"
    " TIMESTAMP '2026-03-01 14:00:00' AS plain, MAP {'k': 'infinity'::DATE} AS m"
)


@pytest.mark.parametrize("form", [as_table, as_csv, as_json])
def test_dates_that_python_does_not_have_are_texts(form: Callable[[pa.Table], str]) -> None:
    with duckdb.connect() as connection:
        text = form(connection.sql(BEYOND).to_arrow_table())
    assert text.count("infinity") == 5
    assert "2026-03-01T14:00:00" in text, "the others are as they were"
    assert "290000-01-01" in text or "out of range" in text


def test_parquet_names_the_columns_that_it_has_no_type_for() -> None:
    with duckdb.connect() as connection:
        rows = connection.sql("SELECT 1 AS a, INTERVAL 1 YEAR AS b, union_value(n := 1) AS c").to_arrow_table()
    with pytest.raises(UsageError, match=r"no type for b \(month_day_nano_interval\), c"):
        as_parquet(rows)
