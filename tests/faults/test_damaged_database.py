"""A block of the database that cannot be read: never published, told as what it is, mended as the night and doctor say."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import duckdb
import pytest

import pipeline.nightly.night
from pipeline import Lab
from pipeline.cli import main
from pipeline.lab import snapshot
from pipeline.lab.checks import find_damage
from pipeline.nightly.night import nightly
from schemas.errors import LabError
from tests.faults.lab_state import content, healthy, left_over
from tests.helpers.small_lab import make_lab_of_one_life

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

HEADERS, BLOCK = 3 * 4096, 256 << 10
"""Bytes of the headers of a DuckDB file, and of each block behind them."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A raw folder and the lab of a night over it."""
    raw, lab = make_lab_of_one_life(tmp_path_factory.mktemp("damaged"))
    return raw, lab.folder


@pytest.fixture
def lab(made: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lab:
    """A copy of the lab; its nights write no pages."""
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
    shutil.copytree(made[1], tmp_path / "lab")
    return Lab(tmp_path / "lab")


def flip(database: Path, place: int) -> None:
    """Changes one bit of a file."""
    with database.open("r+b") as file:
        file.seek(place)
        (byte,) = file.read(1)
        file.seek(place)
        file.write(bytes([byte ^ 0x10]))


def find_place(database: Path, table: str = "recordings", column: str = "metadata") -> int:
    """The middle of the block that holds a column."""
    with duckdb.connect(str(database), read_only=True) as connection:
        (block,) = connection.execute(
            "SELECT max(block_id) FROM pragma_storage_info(?) WHERE column_name = ? AND block_id >= 0", [table, column]
        ).fetchone() or (None,)
    assert block is not None
    return int(HEADERS + (block + 0.5) * BLOCK)


def damaged(database: Path) -> list[str]:
    """The tables that cannot be read."""
    return list(find_damage(lambda: duckdb.connect(str(database), read_only=True)))


def test_every_block_in_use_is_read(lab: Lab) -> None:
    with duckdb.connect(str(lab.database), read_only=True) as connection:
        ((blocks, free),) = connection.execute(
            "SELECT total_blocks, free_blocks FROM pragma_database_size()"
        ).fetchall()
    whole = lab.database.read_bytes()
    seen = 0
    looked = range(0, blocks, 4)
    for block in looked:
        flip(lab.database, HEADERS + block * BLOCK + BLOCK // 2)
        try:
            seen += bool(damaged(lab.database))
        except duckdb.Error:
            seen += 1
        lab.database.unlink()
        lab.database.write_bytes(whole)
    assert seen >= len(looked) - free
    assert seen > len(looked) / 2
    assert damaged(lab.database) == []


def test_a_new_database_with_a_broken_block_is_not_published(
    made: tuple[Path, Path], lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = lab.database.read_bytes()
    refuse = snapshot._refuse_damaged

    def flipped(published: Path, building: Path) -> None:
        flip(building, find_place(building))
        refuse(published, building)

    with monkeypatch.context() as broken:
        broken.setattr(snapshot, "_refuse_damaged", flipped)
        with pytest.raises(LabError, match="the new database is damaged: recordings") as told:
            nightly([made[0]], lab, jobs=0)
    assert "The published database is as it was" in str(told.value)
    assert lab.database.read_bytes() == before
    assert nightly([made[0]], lab, jobs=0).exit_status == 0
    assert healthy(lab) == []
    assert left_over(lab) == []


@pytest.mark.long_after(1)
@pytest.mark.parametrize("where", [("recordings", "metadata"), ("previews", "low")], ids=lambda where: where[0])
def test_a_published_database_with_a_broken_block_is_told_and_left(
    made: tuple[Path, Path], lab: Lab, tmp_path: Path, where: tuple[str, str]
) -> None:
    """Whether the night reads the block for itself, or copies it only."""
    whole = content(lab)
    flip(lab.database, find_place(lab.database, *where))
    before = lab.database.read_bytes()
    assert any("all of the database can be read" in finding for finding in healthy(lab))
    for _ in range(2):
        with pytest.raises(LabError, match=r"the published database (is damaged|cannot be read)") as told:
            nightly([made[0]], lab, jobs=0)
        assert "Move it away" in str(told.value)
        assert lab.database.read_bytes() == before
    lab.database.rename(tmp_path / "away.duckdb")
    assert nightly([made[0]], lab, jobs=0).exit_status == 0, "the remedy helps"
    assert content(lab) == whole
    assert healthy(lab) == []


@pytest.mark.long_after(1)
@pytest.mark.parametrize(
    ("edit", "told"),
    [
        ("ALTER TABLE lifetimes DROP COLUMN failed", "lifetimes lacks failed"),
        ("ALTER TABLE lifetimes ADD COLUMN mood VARCHAR", "lifetimes also has mood"),
        ("DROP VIEW best_models", "best_models is missing"),
        ("DROP TABLE previews", "previews is missing"),
    ],
)
def test_a_database_that_somebody_edited_is_told_and_left(
    made: tuple[Path, Path], lab: Lab, tmp_path: Path, edit: str, told: str
) -> None:
    whole = content(lab)
    with duckdb.connect(str(lab.database)) as connection:
        connection.execute(edit)
    before = lab.database.read_bytes()
    assert any(told in finding and "move it away" in finding for finding in healthy(lab))
    with pytest.raises(LabError, match=f"somebody has edited the published database: {told}") as refused:
        nightly([made[0]], lab, jobs=0)
    assert "Move it away" in str(refused.value)
    assert lab.database.read_bytes() == before
    lab.database.rename(tmp_path / "away.duckdb")
    assert nightly([made[0]], lab, jobs=0).exit_status == 0, "the remedy helps"
    assert content(lab) == whole


def test_a_database_without_recordings_is_told_and_not_called_empty(
    lab: Lab, capsys: pytest.CaptureFixture[str]
) -> None:
    with duckdb.connect(str(lab.database)) as connection:
        for (view,) in connection.execute("SELECT view_name FROM duckdb_views() WHERE NOT internal").fetchall():
            connection.execute(f"DROP VIEW {view}")
        connection.execute("DROP TABLE recordings")
    assert main(["status", "--lab", str(lab.folder)]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert "has no table recordings" in said.err
    assert "Move it away" in said.err


def put_sqlite(path: Path) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE t (a)")
    connection.close()


def put_another_duckdb(path: Path) -> None:
    with duckdb.connect(str(path)) as connection:
        connection.execute("CREATE TABLE t AS SELECT 1 AS a")


@pytest.mark.long_after(1)
@pytest.mark.parametrize("put", [put_sqlite, put_another_duckdb, Path.touch, Path.mkdir, os.mkfifo])
def test_what_is_no_database_of_ours_is_told_at_once(
    put: Callable[[Path], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By every command, without a download and without waiting for a pipe."""
    raw, lab = make_lab_of_one_life(tmp_path)
    lab.database.unlink()
    put(lab.database)
    for words in (["sql", "SELECT 1"], ["status"], ["report"], ["doctor"], ["nightly", str(raw), "--jobs", "0"]):
        assert main([*words, "--lab", str(lab.folder)]) == 1, words
        told = "".join(capsys.readouterr())
        assert not any(word in told for word in ("Traceback", "http", "download")), told
        assert "nightly" in told, "the remedy"
