"""The published snapshot: built aside, checked, put in place whole; the journal and what it carries."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa
import pytest

from ingest.atomic import written_whole
from pipeline.analyse.carried import Codec, carried_table, results_of
from pipeline.analyse.description import recordings_rows
from pipeline.lab import snapshot as publishing
from pipeline.lab.checks import find_violations
from pipeline.lab.journal import Freshness, Outcome, list_entries, read_outcome, read_tables, write_entry
from pipeline.lab.lab import Lab
from pipeline.lab.reader import Reader
from pipeline.lab.snapshot import BATCH_PIECES, Changes, Deletion, gather, publish
from pipeline.nightly.ledger import Ledger, learn_lab
from pipeline.transform.response import STIFFNESS, FrequencyResponse
from schemas.errors import LabError
from schemas.lifetimes import LifetimeRow
from schemas.tables import TABLES
from schemas.views import VIEWS, fingerprint


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    made = Lab(tmp_path / "lab [1] 'x'")
    made.create()
    return made


def recording(name: str, **more: Any) -> dict[str, Any]:
    row = {"recording_id": name, "specimen_id": f"s-{name}", "status": "ok", "source_path": f"/raw/{name}"}
    return row | {"source_sha256": name * 8} | more


def added(*rows: dict[str, Any], **tables: Any) -> Changes:
    return Changes(insertions=[{"recordings": TABLES["recordings"].rows(rows), **tables}])


def select(lab: Lab, query: str) -> list[tuple[Any, ...]]:
    with duckdb.connect(str(lab.database), read_only=True) as connection:
        found: list[tuple[Any, ...]] = connection.execute(query).fetchall()
    return found


def test_every_table_and_column_has_a_comment_and_every_view_answers(lab: Lab) -> None:
    publish(lab, added(recording("a")))
    with duckdb.connect(str(lab.database), read_only=True) as connection:
        silent = connection.execute(
            "SELECT table_name, column_name FROM duckdb_columns() WHERE NOT internal AND comment IS NULL "
            "AND table_name NOT IN (SELECT view_name FROM duckdb_views())"
        ).fetchall()
        assert silent == []
        assert connection.execute("SELECT table_name FROM duckdb_tables() WHERE comment IS NULL").fetchall() == []
        for view in VIEWS:
            call = f"{view.name}({', '.join('60' for _ in view.parameters)})" if view.parameters else view.name
            connection.execute(f"SELECT * FROM {call}").fetchall()
        assert list(find_violations(connection)) == []


def test_changes_delete_then_insert_and_keep_the_rest(lab: Lab) -> None:
    publish(lab, added(recording("a"), recording("b"), recording("c")))
    changes = Changes(
        deletions=[Deletion("recordings", {"recording_id": ["a", "c"]}), Deletion("runs")],
        insertions=[{"recordings": [recording("a", status="damaged", problem="cut")]}, {"runs": [{"run_id": "1"}]}],
    )
    publish(lab, changes)
    assert select(lab, "SELECT recording_id, status FROM recordings ORDER BY 1") == [("a", "damaged"), ("b", "ok")]
    assert sorted(path.name for path in lab.folder.iterdir()) == [".work", "results.duckdb"]
    assert list(lab.work.iterdir()) == []


def test_deletion_matches_null(lab: Lab) -> None:
    pending = {"source_path": "/raw/p", "source_sha256": None, "status": "pending", "problem": "grows"}
    publish(lab, added(recording("a"), pending))
    keys = {"source_path": ["/raw/p"], "source_sha256": [None]}
    publish(lab, Changes(deletions=[Deletion("recordings", keys)]))
    assert select(lab, "SELECT recording_id FROM recordings") == [("a",)]


@pytest.mark.long_after(1)
@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([recording("a"), recording("a", source_path="/raw/other")], "belongs to one analysed recording"),
        ([recording("a", status="fine")], "every status is one"),
        ([recording("a", status="quarantined")], "a refused recording has a reason"),
        ([recording("a", recording_id=None)], "an analysed recording has an id"),
    ],
)
def test_a_database_that_breaks_a_rule_is_not_published(lab: Lab, rows: list[dict[str, Any]], says: str) -> None:
    publish(lab, added(recording("first")))
    before = lab.database.read_bytes()
    with pytest.raises(LabError, match=says):
        publish(lab, added(*rows))
    assert lab.database.read_bytes() == before
    assert list(lab.work.iterdir()) == []


def test_rows_without_their_recording_are_not_published(lab: Lab) -> None:
    fits = TABLES["model_fits"].rows([{"specimen_id": "nobody", "model_order": 1}])
    with pytest.raises(LabError, match="model_fits: every specimen_id"):
        publish(lab, added(recording("a"), model_fits=fits))
    assert not lab.database.exists()


def test_refuses_while_somebody_writes(lab: Lab) -> None:
    publish(lab, added(recording("a")))
    journal = lab.database.with_name("results.duckdb.wal")
    journal.write_bytes(b"")
    with pytest.raises(LabError, match="for writing"):
        publish(lab, added(recording("b")))
    journal.unlink()
    publish(lab, added(recording("b")))
    assert len(select(lab, "SELECT * FROM recordings")) == 2


def test_readers_keep_what_they_opened(lab: Lab) -> None:
    publish(lab, added(recording("a")))
    with duckdb.connect(str(lab.database), read_only=True) as reader:
        publish(lab, added(recording("b")))
        assert reader.execute("SELECT count(*) FROM recordings").fetchone() == (1,)
    assert select(lab, "SELECT count(*) FROM recordings") == [(2,)]


def test_an_older_schema_is_brought_up_to_date(lab: Lab) -> None:
    """As an earlier release could have left it: a column less, one of another type, one that is no more, a table less."""
    publish(lab, added(recording("a", duration_s=2.5)))
    with duckdb.connect(str(lab.database)) as connection:
        for view in VIEWS:
            connection.execute(f"DROP {'MACRO TABLE' if view.parameters else 'VIEW'} {view.name}")
        connection.execute("ALTER TABLE recordings DROP COLUMN notes")
        connection.execute("ALTER TABLE recordings ADD COLUMN mood VARCHAR")
        connection.execute("ALTER TABLE recordings ALTER duration_s TYPE VARCHAR")
        connection.execute("DROP TABLE carried")
        connection.execute("UPDATE lab SET value = 'older'")
    with Reader(lab.database) as reader:
        assert [(row["recording_id"], row["notes"]) for row in reader.each("recordings")] == [("a", None)]
        assert reader.rows("carried") == []
    publish(lab, added(recording("b")))
    assert select(lab, "SELECT recording_id, duration_s, notes FROM recordings ORDER BY 1") == [
        ("a", 2.5, None),
        ("b", None, None),
    ]
    assert select(lab, "SELECT value FROM lab WHERE key = 'schema'") == [(fingerprint(),)]


def test_a_file_that_is_no_database_is_named_and_left(lab: Lab) -> None:
    lab.database.write_bytes(b"not a database at all" * 1000)
    with pytest.raises(LabError, match="cannot be read"), Reader(lab.database):
        pass
    with pytest.raises(LabError, match="cannot be read"):
        publish(lab, added(recording("a")))
    assert lab.database.read_bytes().startswith(b"not a database")


OUTCOME = Outcome("specimen:'; DROP TABLE x --/../é", "specimen", Freshness("a", "b", "c"), "ok", 1.5, None, {"n": 1})


def test_journal_keeps_outcome_and_rows(tmp_path: Path) -> None:
    tables = {
        "lifetimes": TABLES["lifetimes"].rows([{"recording_id": "a", "lifetime_s": 1.25, "failed": True}]),
        "distortions": TABLES["distortions"].empty(),
    }
    path = write_entry(tmp_path, OUTCOME, tables)
    assert path.parent == tmp_path
    assert read_outcome(path) == OUTCOME
    assert read_tables(path) == {"lifetimes": tables["lifetimes"]}
    assert list(list_entries(tmp_path)) == [(path, OUTCOME)]


def test_a_night_learns_what_is_published(lab: Lab) -> None:
    """Of every table the columns in the order of the ledger's."""
    files = [{"path": "/raw/a", "size": 1, "mtime_ns": 2, "inode": 3, "sha256": "a" * 8}]
    carried = [{"recording_id": "a", "kind": kind} for kind in ("x", "y")]
    items = [{"item_id": "recording:1", "stage": "recording", "input_hash": "i", "outcome": "ok"}]
    publish(lab, added(recording("a", run_id="000007"), files=files, items=items, runs=[{"run_id": "000007"}],
                       carried=TABLES["carried"].rows(carried)))  # fmt: skip
    with Ledger(lab.ledger) as ledger:
        assert learn_lab(lab, ledger) == 7
        assert ledger.row("SELECT source_path, source_sha256, recording_id, status, run_id FROM known") == (
            "/raw/a", "a" * 8, "a", "ok", "000007",
        )  # fmt: skip
        assert list(ledger.each("SELECT item_id, stage, input_hash, outcome FROM items")) == [
            ("recording:1", "recording", "i", "ok")
        ]
        assert list(ledger.each("SELECT * FROM files")) == [("/raw/a", 1, 2, 3, "a" * 8)]
        assert set(ledger.each("SELECT * FROM carried")) == {("a", "x"), ("a", "y")}
    assert not lab.work.exists()


def test_a_ledger_that_cannot_be_written_is_the_labs_fault(tmp_path: Path) -> None:
    (tmp_path / "work").write_text("in the way")
    with pytest.raises(LabError, match="cannot be written"), Ledger(tmp_path / "work" / "ledger.sqlite"):
        pass
    with Ledger(tmp_path / "ledger.sqlite") as ledger:
        ledger.run("PRAGMA max_page_count = 60")
        with pytest.raises(LabError, match="full"):
            ledger.add("reached", ((str(number) * 100,) for number in range(10_000)))


def test_of_an_entry_only_the_tables_that_are_wanted_are_read(tmp_path: Path) -> None:
    tables = {
        name: TABLES[name].rows([{"recording_id": name, **more}])
        for name, more in (
            ("carried", {"kind": "x"}),
            ("lifetimes", {"failed": True}),
            ("recordings", {"status": "ok"}),
        )
    }
    path = write_entry(tmp_path, OUTCOME, tables)
    assert read_tables(path) == tables
    for wanted in (("lifetimes",), ("recordings", "carried"), ("no such",)):
        assert read_tables(path, wanted) == {name: table for name, table in tables.items() if name in wanted}


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_half_an_entry_is_no_entry(tmp_path: Path, share: float) -> None:
    path = write_entry(tmp_path, OUTCOME, {})
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    assert read_outcome(path) is None
    path.write_bytes(content[:-5] + bytes(5))
    assert read_outcome(path) is None
    assert list(list_entries(tmp_path)) == []


def test_carried_results_come_back_to_the_bit() -> None:
    rng = np.random.default_rng(seed=1)
    response = FrequencyResponse(
        frequency_hz=np.array([1.0, 2.0]),
        value=rng.normal(size=2) + 1j * rng.normal(size=2),
        variance=np.array([np.nan, 1e-300]),
        usable=np.array([True, False]),
        unusable_because=("", 'quotes " and \x00'),
        quantity=STIFFNESS,
        loading="mechanical",
        effective_lines=1.5,
        details={"amplitudes": (0.1, None), "deep": {"n": np.int64(3)}},
    )
    life = LifetimeRow(specimen_id="s", lifetime_s=float("inf"), failed=False, warnings=("a", "b"))
    back, back_life = results_of(carried_table("r", [response, life]).to_pylist())
    for name in ("frequency_hz", "value", "variance", "usable"):
        np.testing.assert_array_equal(getattr(back, name), getattr(response, name))
        assert getattr(back, name).dtype == getattr(response, name).dtype
    assert back.unusable_because == response.unusable_because
    assert back.details == {"amplitudes": (0.1, None), "deep": {"n": 3}}
    assert back.coherence is None
    assert back_life == life


@pytest.mark.parametrize("text", ['{"$type":"Popen"}', '{"$type":"LifetimeRow","x":1}', '{"$array":["O",[1],"AAAA"]}'])
def test_carried_text_makes_only_known_kinds(text: str) -> None:
    with pytest.raises(ValueError, match=r"carried|array"):
        Codec([LifetimeRow]).unpack(text)


@pytest.mark.parametrize("value", [object(), np.array(["a"]), np.array([None]), {"$type": 1}, {1: 2}])
def test_what_cannot_be_carried_is_refused(value: Any) -> None:
    with pytest.raises(TypeError):
        Codec([]).pack(value)


def test_written_whole_leaves_the_old_file_when_the_new_one_fails(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text("old")

    def fail() -> None:
        with written_whole(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


def test_a_copied_lab_is_a_lab(lab: Lab, tmp_path: Path) -> None:
    publish(lab, added(recording("a")))
    shutil.copytree(lab.folder, tmp_path / "copy")
    copy = Lab(tmp_path / "copy")
    publish(copy, added(recording("b")))
    assert select(copy, "SELECT count(*) FROM recordings") == [(2,)]
    assert select(lab, "SELECT count(*) FROM recordings") == [(1,)]


def test_rows_are_ordered_within_a_publish(lab: Lab) -> None:
    previews = pa.concat_tables(
        [
            TABLES["previews"].arrays(1, recording_id="a", quantity=q, time_s=t)
            for q, t in (("x", 1.0), ("f", 2.0), ("f", 1.0))
        ]
    )
    publish(lab, added(recording("a"), previews=previews))
    assert select(lab, "SELECT quantity, time_s FROM previews") == [("f", 1.0), ("f", 2.0), ("x", 1.0)]


def test_rows_of_recordings_keep_their_times_to_the_microsecond() -> None:
    at = datetime(2026, 3, 1, 8, 0, 0, 123457, tzinfo=UTC)
    given = [{"recording_id": "a", "started_at": at, "duration_s": float("nan")}, {"recording_id": "b"}]
    table = TABLES["recordings"].rows(given)
    assert recordings_rows(table) == table.to_pylist()


def test_small_tables_are_inserted_in_parts_however_few_bytes_they_have() -> None:
    """Arrow holds ten times as much for a table of one row as the row has."""
    small = TABLES["runs"].rows([{"run_id": "1"}])
    parts = [{"runs": small, "recordings": [recording(str(i))]} for i in range(3 * BATCH_PIECES)]
    batches = list(gather(parts))
    assert sum(len(batch.get("runs", ())) for batch in batches) == len(parts)
    assert [row for batch in batches for rows in batch.get("recordings", ()) for row in rows] == [
        row for part in parts for row in part["recordings"]
    ]
    assert max(sum(map(len, batch.values())) for batch in batches) <= BATCH_PIECES + 1


def test_long_texts_get_the_memory_that_they_ask_for(lab: Lab) -> None:
    """DuckDB holds all long texts of a row group at once: more than what it may use at first."""
    rows = [{"recording_id": "a", "kind": "x", "position": i, "payload": str(i % 10) * 1_000_000} for i in range(60)]
    publish(lab, Changes(insertions=[{"recordings": TABLES["recordings"].rows([recording("a")])}, {"carried": rows}]))
    assert select(lab, "SELECT count(*), min(length(payload)) FROM carried") == [(60, 1_000_000)]
    assert list(lab.work.iterdir()) == []


@pytest.mark.long_after(1)
@pytest.mark.parametrize(
    "told",
    [
        'Checkpoint failed for database "building". Original error: could not allocate block of size 2.0 MiB (29.6 MiB/30.5 MiB used)',
        "failed to pin block of size 256.0 KiB (30.5 MiB/30.5 MiB used)",
    ],
)
def test_a_build_that_is_short_of_memory_is_made_again_with_more(
    lab: Lab, monkeypatch: pytest.MonkeyPatch, told: str
) -> None:
    """DuckDB says it in several ways, and not always as an error of memory."""
    allowed = []
    finish = publishing._finish

    def short_at_first(connection: duckdb.DuckDBPyConnection) -> Any:
        allowed.append(connection.execute("SELECT current_setting('memory_limit')").fetchone())
        if len(allowed) == 1:
            raise duckdb.IOException(told)
        return finish(connection)

    monkeypatch.setattr(publishing, "_finish", short_at_first)
    publish(lab, added(recording("a")))
    assert select(lab, "SELECT recording_id FROM recordings") == [("a",)]
    assert len(set(allowed)) == 2


def test_a_file_of_large_row_groups_is_made_anew(lab: Lab) -> None:
    publish(lab, added(recording("a")))
    with duckdb.connect(str(lab.database)) as connection:
        connection.execute("DELETE FROM lab WHERE key = 'row_group'")
        connection.execute("INSERT INTO previews (recording_id, time_s) SELECT 'a', i FROM range(20000) AS t(i)")
    publish(lab, added(recording("b")))
    assert select(lab, "SELECT count(*) FROM previews") == [(20_000,)]
    groups = select(lab, "SELECT max(count) FROM pragma_storage_info('previews')")
    assert groups[0][0] <= 4096
    assert select(lab, "SELECT value FROM lab WHERE key = 'row_group'") == [("4096",)]
