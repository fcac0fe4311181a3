"""Long lists in parts: everything stands on one page, and full parts stay as they are when rows come."""

from __future__ import annotations

import re
from pathlib import Path

import duckdb
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.build import build_reports
from reports.pages.index import lists
from tests.helpers import synthetic_lab


@given(st.integers(0, 2000))
def test_parts_cover_everything_once(count: int) -> None:
    for make in (lists.from_the_first, lists.from_the_last):
        parts = make("x.html", count)
        rows = sorted(row for part in parts for row in range(part.begin, part.end))
        assert rows == list(range(count))
        assert len({part.address for part in parts}) == len(parts)
        assert parts[0].address == "x.html"
        by_number = {part.number: part for part in parts}
        for part in parts:
            assert part.end - part.begin <= 2 * lists.PART
            assert part.after is None or by_number[part.after].begin == part.end
            assert part.before is None or by_number[part.before].end == part.begin


@given(st.integers(0, 2000), st.integers(1, 300))
def test_a_full_part_stays_where_it_is(count: int, more: int) -> None:
    for make in (lists.from_the_first, lists.from_the_last):
        later = {part.number: part for part in make("x.html", count + more)}
        for part in make("x.html", count)[1:]:
            if part.end - part.begin == lists.PART:
                assert (later[part.number].begin, later[part.number].end) == (part.begin, part.end)


def lists_of(lab: Path) -> dict[str, bytes]:
    names = (*lab.glob("reports/recordings*.html"), *lab.glob("reports/specimens*.html"))
    return {path.name: path.read_bytes() for path in names}


@pytest.mark.long
def test_a_new_recording_leaves_the_full_parts_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lists, "PART", 4)
    story = synthetic_lab.Story()
    for i in range(26):
        story.recording(f"r-{i:02d}", f"s-{i:02d}", "chirp", "mechanical")
        story.fits(f"s-{i:02d}", synthetic_lab.SILICONE)
    story.run()
    lab = story.write(tmp_path / "lab")
    build_reports(lab)
    before = lists_of(lab)
    assert len(before) > 6
    linked = re.findall(rb'<a href="(recordings/[^"]+)"', b"".join(before.values()))
    assert set(linked) == {b"recordings/" + path.name.encode() for path in lab.glob("reports/recordings/*.html")}
    with duckdb.connect(str(lab / "results.duckdb")) as connection:
        connection.execute(
            "INSERT INTO recordings BY NAME SELECT * REPLACE ('r-26' AS recording_id, 'new' AS source_path,"
            " (SELECT max(started_at) FROM recordings) AS started_at)"
            " FROM recordings WHERE recording_id = 'r-01'"
        )
    build_reports(lab)
    after = lists_of(lab)
    changed = {name for name in after if before.get(name) != after[name]}
    assert "recordings.html" in changed
    assert len([name for name in changed if name.startswith("recordings")]) <= 3
    assert len([name for name in changed if name.startswith("specimens")]) <= 2
    build_reports(lab, force=True)
    assert lists_of(lab) == after, "what was left alone is what would be made"
