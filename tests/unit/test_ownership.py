"""The night's decisions: identity of contents, conflicts, what becomes of rows."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from pipeline.nightly.ledger import TABLES, Ledger
from pipeline.nightly.ownership import (
    Reading,
    Row,
    collect_readings,
    place_contents,
    set_aside,
    write_rows,
)
from schemas.errors import DealabError, PendingError, RefusedError


@pytest.fixture(autouse=True)
def ledger(tmp_path: Path) -> Iterator[Ledger]:
    """The ledger that `decide` fills, empty."""
    global LEDGER
    with Ledger(tmp_path / "work" / "ledger.sqlite") as LEDGER:
        yield LEDGER
    assert list(tmp_path.iterdir()) == [], "nothing is left of it"


LEDGER: Ledger


def columns(table: str) -> list[str]:
    return [part.split()[0] for part in TABLES[table].split(", ") if not part.startswith("PRIMARY")]


def add(table: str, **values: object) -> None:
    LEDGER.add(table, [tuple(values.get(name) for name in columns(table))])


@dataclass(frozen=True)
class Look:
    path: str
    sha256: str | None
    error: DealabError | None = None


@dataclass(frozen=True)
class Known:
    path: str
    sha256: str | None
    recording_id: str | None
    status: str
    problem: str | None = None


@dataclass(frozen=True)
class Verdicts:
    refusals: dict[str, DealabError]
    superseded: set[str]
    usable: set[str]

    def accepted(self, sha256: str) -> bool:
        return sha256 in self.usable


def look(path: str, sha256: str | None, error: DealabError | None = None) -> Look:
    return Look(path, sha256, error)


def known(path: str, sha256: str | None, recording_id: str | None, status: str, problem: str | None = None) -> Known:
    return Known(path, sha256, recording_id, status, problem)


def decide(
    looks: list[Look],
    readings: dict[str, Reading],
    before: list[Known] | None = None,
    *,
    gone: bool = True,
    excluded: tuple[str, ...] = (),
    changing: tuple[str, ...] = (),
) -> tuple[dict[tuple[str, str | None], Row], Verdicts]:
    for table in TABLES:
        LEDGER.run(f"DELETE FROM {table}")
    for one in looks:
        told = {} if one.error is None else {"problem": str(one.error), "refusal": json.dumps(one.error.as_dict())}
        pending = one.error is not None and one.error.transient
        add("looks", path=one.path, place=one.path.encode(), sha256=one.sha256, pending=pending, **told)
    for row in before or []:
        add(
            "known",
            source_path=row.path,
            source_sha256=row.sha256,
            recording_id=row.recording_id,
            status=row.status,
            problem=row.problem,
            source_present=True,
            run_id="1",
        )
    for sha256, reading in readings.items():
        about = {"recording_id": reading.recording_id, "status": reading.status, "problem": reading.problem}
        add("outcomes", item_id=f"recording:{sha256}", entry=sha256, done=True, **about)
    place_contents(LEDGER, lambda _path: not gone)
    set_aside(LEDGER, dict.fromkeys(changing, "the file changed while it was read"))
    collect_readings(LEDGER)
    write_rows(LEDGER, ["/raw"], excluded)
    rows = LEDGER.each("SELECT source_path, source_sha256, status, problem, recording_id, source_present FROM rows")
    found = [Row(*row[:5], bool(row[5])) for row in rows]
    keys = [(row.source_path, row.source_sha256) for row in found]
    assert len(keys) == len(set(keys)), "one row per file and content"
    refused = LEDGER.each("SELECT sha256, refusal FROM judged")
    verdicts = Verdicts(
        {sha256: RefusedError(**json.loads(text)) for sha256, text in refused},
        {sha256 for (sha256,) in LEDGER.each("SELECT sha256 FROM superseded")},
        {sha256 for (sha256,) in LEDGER.each("SELECT sha256 FROM readings WHERE accepted")},
    )
    return dict(zip(keys, found, strict=True)), verdicts


OK_X = Reading("X", "ok", None)


def test_same_content_twice_is_a_duplicate_of_the_shorter_name() -> None:
    found, _ = decide([look("/raw/a-copy.mcap", "1"), look("/raw/a.mcap", "1")], {"1": OK_X})
    assert found["/raw/a.mcap", "1"].status == "ok"
    copy = found["/raw/a-copy.mcap", "1"]
    assert copy.status == "duplicate"
    assert copy.recording_id == "X"
    assert "/raw/a.mcap" in (copy.problem or "")


def test_same_id_with_other_content_is_refused_and_names_the_first() -> None:
    found, verdicts = decide([look("/raw/a.mcap", "1"), look("/raw/b.mcap", "2")], {"1": OK_X, "2": OK_X})
    assert found["/raw/a.mcap", "1"].status == "ok"
    refused = found["/raw/b.mcap", "2"]
    assert refused.status == "quarantined"
    assert '"X"' in (refused.problem or "")
    assert "/raw/a.mcap" in (refused.problem or "")
    assert isinstance(verdicts.refusals["2"], RefusedError)


def test_the_content_that_came_first_keeps_its_id_whatever_its_name() -> None:
    before = [known("/raw/zz-long-name.mcap", "1", "X", "ok")]
    looks = [look("/raw/a.mcap", "2"), look("/raw/zz-long-name.mcap", "1")]
    found, _ = decide(looks, {"1": OK_X, "2": OK_X}, before)
    assert found["/raw/zz-long-name.mcap", "1"].status == "ok"
    assert found["/raw/a.mcap", "2"].status == "quarantined"


def test_a_changed_file_does_not_take_the_place_of_a_good_recording() -> None:
    found, _ = decide([look("/raw/a.mcap", "2")], {"1": OK_X, "2": OK_X}, [known("/raw/a.mcap", "1", "X", "ok")])
    assert found["/raw/a.mcap", "2"].status == "quarantined"
    assert "earlier content" in (found["/raw/a.mcap", "2"].problem or "")
    kept = found["/raw/a.mcap", "1"]
    assert (kept.status, kept.source_present) == ("ok", False)


def test_a_whole_file_takes_the_place_of_its_damaged_beginning() -> None:
    damaged = Reading("X", "damaged", "cut")
    before = [known("/raw/a.mcap", "1", "X", "damaged", problem="cut")]
    found, verdicts = decide([look("/raw/a.mcap", "2")], {"1": damaged, "2": OK_X}, before)
    assert {key: row.status for key, row in found.items()} == {("/raw/a.mcap", "2"): "ok"}
    assert verdicts.superseded == {"1"}


def test_a_moved_file_is_the_same_recording_at_a_new_place() -> None:
    before = [known("/raw/old/a.mcap", "1", "X", "ok")]
    found, _ = decide([look("/raw/new/a.mcap", "1")], {"1": OK_X}, before)
    assert {key: row.status for key, row in found.items()} == {("/raw/new/a.mcap", "1"): "ok"}


def test_a_copy_beside_a_known_file_elsewhere_is_a_duplicate() -> None:
    before = [known("/elsewhere/a.mcap", "1", "X", "ok")]
    found, _ = decide([look("/raw/a.mcap", "1")], {"1": OK_X}, before, gone=False)
    assert found["/raw/a.mcap", "1"].status == "duplicate"
    assert found["/elsewhere/a.mcap", "1"].status == "ok"


def test_a_file_that_has_gone_leaves_its_results_and_is_marked() -> None:
    before = [
        known("/raw/a.mcap", "1", "X", "ok"),
        known("/elsewhere/b.mcap", "2", "Y", "ok"),
        known("/raw/c.mcap", "1", "X", "duplicate"),
        known("/raw/d.mcap", "4", None, "quarantined", problem="bad"),
    ]
    readings = {"1": OK_X, "2": Reading("Y", "ok", None), "3": Reading("Z", "ok", None)}
    found, _ = decide([look("/raw/e.mcap", "3")], readings, before)
    assert found["/raw/a.mcap", "1"].source_present is False
    assert found["/raw/a.mcap", "1"].status == "ok"
    assert found["/elsewhere/b.mcap", "2"].source_present is True, "nobody looked there tonight"
    assert ("/raw/c.mcap", "1") not in found, "a copy that has gone leaves nothing"
    assert found["/raw/d.mcap", "4"].source_present is False


def test_a_refused_file_that_was_mended_leaves_no_row_behind() -> None:
    before = [known("/raw/a.mcap", "1", None, "quarantined", problem="bad")]
    found, _ = decide([look("/raw/a.mcap", "2")], {"2": OK_X}, before)
    assert {key: row.status for key, row in found.items()} == {("/raw/a.mcap", "2"): "ok"}


def test_pending_and_unreadable_files_have_no_content_and_are_told_apart() -> None:
    looks = [
        look("/raw/a.mcap", None, PendingError("the file is being written")),
        look("/raw/b.mcap", None, RefusedError("the file cannot be read")),
    ]
    found, _ = decide(looks, {}, [known("/raw/a.mcap", "1", "X", "duplicate")])
    assert found["/raw/a.mcap", None].status == "pending"
    assert found["/raw/b.mcap", None].status == "quarantined"
    assert len(found) == 2


def test_excluded_recordings_say_so_and_come_back() -> None:
    before = [known("/raw/a.mcap", "1", "X", "excluded")]
    found, _ = decide([look("/raw/a.mcap", "1")], {"1": OK_X}, before, excluded=("X",))
    assert found["/raw/a.mcap", "1"].status == "excluded"
    found, _ = decide([look("/raw/a.mcap", "1")], {"1": OK_X}, before)
    assert found["/raw/a.mcap", "1"].status == "ok"


def test_refused_content_at_two_places_is_refused_once() -> None:
    refused = Reading(None, "quarantined", "bad")
    found, verdicts = decide([look("/raw/a.mcap", "1"), look("/raw/bb.mcap", "1")], {"1": refused})
    assert sorted(row.status for row in found.values()) == ["duplicate", "quarantined"]
    assert not verdicts.accepted("1")


def test_a_known_file_that_changes_while_it_is_read_waits_and_keeps_its_results() -> None:
    before = [known("/raw/a.mcap", "1", "X", "ok")]
    found, verdicts = decide([look("/raw/a.mcap", "1")], {"1": OK_X}, before, changing=("1",))
    assert found["/raw/a.mcap", None].status == "pending"
    assert found["/raw/a.mcap", "1"].status == "ok"
    assert verdicts.accepted("1")


def test_a_new_file_that_changes_while_it_is_read_only_waits() -> None:
    found, verdicts = decide([look("/raw/a.mcap", "1")], {"1": OK_X}, changing=("1",))
    assert {key: row.status for key, row in found.items()} == {("/raw/a.mcap", None): "pending"}
    assert not verdicts.accepted("1")
