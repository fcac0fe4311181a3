"""The site as files: the same bytes again, nothing made twice, links, tables and their SQL, hostile names, empty labs."""

from __future__ import annotations

import functools
import itertools
import json
import re
import shutil
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from html.parser import HTMLParser
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import duckdb
import pytest

from reports import build, plan
from reports.build import build_reports
from reports.manifest import NAME
from reports.results import MEMORY, Query, Results, Row
from schemas.errors import LabError
from tests.faults import many_pages
from tests.helpers import synthetic_lab

VOID = {"meta", "img", "br", "link", "hr", "input"}
HOSTILE_IDS = {"hostile-1"}


class Parsed(HTMLParser):
    """A page taken apart; elements that are not closed, or closed twice, are an error."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: Counter[str] = Counter()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.headings: list[int] = []
        self.tables: list[dict[str, object]] = []
        self.text: list[str] = []
        self.prose: list[str] = []
        self._pre = False
        self.feed(text)
        self.close()
        assert not self.open, f"not closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags[tag] += 1
        assert not [a for a in found if a.startswith("on")], "event handler"
        if "id" in found and "svg" not in self.open:
            assert found["id"] not in self.ids, f"id {found['id']} twice"
            self.ids.add(str(found["id"]))
        if tag == "a":
            self.links.append(str(found["href"]))
        if tag == "img":
            self.images.append(found)
        if tag in ("h1", "h2", "h3", "h4"):
            self.headings.append(int(tag[1]))
        if tag == "table":
            self.tables.append({"caption": False, "heads": 0, "rows": 0, "unscoped": 0, "cells": set(), "sql": ""})
        if (self.tables and "table" in self.open) or tag == "table":
            table = self.tables[-1]
            if tag == "caption":
                table["caption"] = True
            if tag == "th" and "scope" not in found:
                table["unscoped"] = 1
            if tag == "tr" and "tbody" in self.open:
                table["rows"] = int(str(table["rows"])) + 1
        self._pre = self._pre or tag == "pre"
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> without start"
        assert self.open[-1] == tag, f"</{tag}> closes <{self.open[-1]}>"
        self.open.pop()
        if tag == "pre":
            self._pre = False

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1

    def handle_data(self, data: str) -> None:
        self.text.append(data)
        if not {"code", "pre", "style", "title", "dd", "bdi"} & set(self.open):
            self.prose.append(data)
        if self._pre and self.tables and "footer" not in self.open:
            self.tables[-1]["sql"] = str(self.tables[-1]["sql"]) + data


@functools.cache
def parsed(path: Path, changed: int) -> Parsed:
    return Parsed(path.read_text(encoding="utf-8"))


def pages(site: Path) -> Iterator[tuple[Path, Parsed]]:
    for path in sorted(site.rglob("*.html")):
        yield path, parsed(path, path.stat().st_mtime_ns)


def contents(site: Path) -> dict[str, bytes]:
    return {p.relative_to(site).as_posix(): p.read_bytes() for p in sorted(site.rglob("*")) if p.is_file()}


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A small lab of its own, its report built."""
    lab = synthetic_lab.small_story().write(tmp_path / "small")
    build_reports(lab)
    return lab


def test_same_database_same_bytes(small: Path, tmp_path: Path) -> None:
    """In another place; of the lab with everything, below, with workers."""
    other = tmp_path / "elsewhere" / "lab"
    other.mkdir(parents=True)
    shutil.copy(small / "results.duckdb", other)
    build_reports(other)
    assert contents(other / "reports") == contents(small / "reports")


def test_forced_everything_is_made_and_nothing_changes(small: Path) -> None:
    before = contents(small / "reports")
    assert build_reports(small, force=True).pages_unchanged == 0
    assert contents(small / "reports") == before


@pytest.mark.long
def test_workers_make_the_same_pages(lab: Path, tmp_path: Path) -> None:
    other = tmp_path / "lab"
    other.mkdir()
    shutil.copy(lab / "results.duckdb", other)
    spawned = get_context("spawn")
    made = build_reports(other, workers=lambda: ProcessPoolExecutor(2, mp_context=spawned), jobs=2)
    assert made.pages_written > 50
    assert contents(other / "reports") == contents(lab / "reports")


def test_nothing_new_nothing_made(lab: Path) -> None:
    before = {p: p.stat().st_mtime_ns for p in (lab / "reports").rglob("*.html")}
    result = build_reports(lab)
    with_another = [p for p in before if p.parent.name == "checks"]
    assert (result.pages_written, result.pages_unchanged) == (0, len(before) - len(with_another))
    assert {p: p.stat().st_mtime_ns for p in (lab / "reports").rglob("*.html")} == before


def test_one_new_recording_makes_only_what_it_touches(lab: Path, tmp_path: Path) -> None:
    copy = tmp_path / "lab"
    shutil.copytree(lab, copy)
    before = contents(copy / "reports")
    with duckdb.connect(str(copy / "results.duckdb")) as connection:
        connection.execute(
            "INSERT INTO recordings BY NAME SELECT * REPLACE ('P-05_chirp-4' AS recording_id, 'new' AS source_path)"
            " FROM recordings WHERE recording_id = 'P-05_chirp-1' AND status = 'ok'"
        )
    result = build_reports(copy)
    after = contents(copy / "reports")
    changed = {p for p in after if before.get(p) != after[p] and p.endswith(".html")}
    expected = {
        "index.html",
        "recordings.html",
        "specimens.html",
        "specimens/P-05.html",
        "recordings/P-05_chirp-4.html",
    }
    assert changed == expected | {"campaigns/film-dynamics.html"}
    assert result.pages_written <= len(changed) + 1


def test_pages_of_what_is_gone_are_removed(lab: Path, tmp_path: Path) -> None:
    copy = tmp_path / "lab"
    shutil.copytree(lab, copy)
    with duckdb.connect(str(copy / "results.duckdb")) as connection:
        for table in ("recordings", "previews", "frequency_responses", "model_fits", "diagnoses"):
            column = "specimen_id" if table in ("model_fits", "diagnoses", "recordings") else "recording_id"
            connection.execute(f"DELETE FROM {table} WHERE {column} LIKE 'S-02%'")
    build_reports(copy)
    assert not [p for p in contents(copy / "reports") if "S-02" in p]


@pytest.mark.long
def test_a_lost_or_broken_manifest_makes_everything_anew(small: Path) -> None:
    before = contents(small / "reports")
    lines = (small / "reports" / NAME).read_text().splitlines(keepends=True)
    cut, odd = "".join(lines[:3]), f'{lines[0]}"index.html": {{"digest": 3, "files": []}}\n}}}}\n'
    earlier = json.dumps(json.loads("".join(lines)))
    for text in ("{", "[]", '{"pages": {"index.html": 3}}', cut, odd, earlier):
        (small / "reports" / NAME).write_text(text)
        assert build_reports(small).pages_unchanged == 0
    (small / "reports" / "specimens" / "A-1.html").unlink()
    (small / "reports" / "data" / "recordings" / "A-1_chirp-1_samples.csv").unlink()
    assert build_reports(small).pages_written == 2
    assert contents(small / "reports") == before


def test_every_page_is_whole_and_safe(site: Path) -> None:
    for path, page in pages(site):
        text = path.read_text(encoding="utf-8")
        assert (
            "Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\"" in text
        ), path
        assert not page.tags["script"], path
        assert not page.tags["iframe"], path
        assert page.tags["main"] == page.tags["h1"] == 1, path
        assert page.tags["nav"] == 1, path
        levels = page.headings
        assert levels[0] == 1, path
        assert all(b - a <= 1 for a, b in itertools.pairwise(levels)), (path, levels)
        for image in page.images:
            assert str(image["src"]).startswith("data:image/svg+xml;base64,"), path
            assert len(image["alt"] or "") > 20, (path, image["alt"])
            assert int(image["width"] or 0) > 100, path
        for table in page.tables:
            assert table["caption"], path
            assert not table["unscoped"], path


def test_every_link_leads_somewhere(site: Path) -> None:
    anchors = {path.resolve(): page.ids for path, page in pages(site)}
    seen = Counter()
    for path, page in pages(site):
        for link in page.links:
            assert ":" not in link, (path, link)
            target, _, anchor = unquote(link).partition("#")
            file = (path.parent / target).resolve() if target else path.resolve()
            assert file.is_file(), (path, link)
            if anchor:
                assert anchor in anchors[file], (path, link)
            seen[file.suffix] += 1
    assert seen[".csv"] > 20
    reached = {
        (p.parent / unquote(x).partition("#")[0]).resolve()
        for p, page in pages(site)
        for x in page.links
        if x[0] != "#"
    }
    assert {p.resolve() for p in site.rglob("*.html")} - reached == set()
    assert {p.resolve() for p in site.rglob("*.csv")} - reached == set()


def test_shown_sql_gives_as_many_rows_as_the_table_has(lab: Path, site: Path) -> None:
    checked = 0
    several = ("SELECT *\nFROM model_fits", "SELECT *\nFROM sensing_fits", "SELECT smallest_detectable", "SELECT notes")
    with duckdb.connect(str(lab / "results.duckdb"), read_only=True) as connection:
        for path, page in pages(site):
            if path.parent.name == "recordings" and path.stem.startswith("L-"):
                continue
            for table in page.tables:
                sql = str(table["sql"])
                if not sql.startswith(("SELECT", "WITH")):
                    continue
                count = connection.sql(sql).to_arrow_table().num_rows
                if not sql.startswith(several) and "FROM discrepancies" not in sql:
                    assert count == table["rows"], (path, sql)
                checked += 1
    assert checked > 60


def test_hostile_metadata_is_text(site: Path) -> None:
    for path, page in pages(site):
        text = path.read_text(encoding="utf-8")
        for bad in ("<script", "<img src=x", "</style><", "\u202e", "onerror=alert(1)>\n", "<b>film"):
            assert bad not in text, (path, bad)
        assert not [link for link in page.links if "javascript" in link]
    shown = "".join(Parsed((site / "recordings" / "hostile-1.html").read_text(encoding="utf-8")).text)
    assert "<script>alert(1)</script>" in shown
    assert "'; DROP TABLE recordings; --" in shown
    assert shown.count("long note ") >= 1000
    names = [p.name for p in site.rglob("*")]
    assert all(set(n) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-") for n in names)


PROSE = {
    "an unrounded number": re.compile(r"\d\.\d{7,}"),
    "a number as a program writes it": re.compile(r"\d[eE][+-]?\d"),
    "a p of nothing": re.compile(r"\bp 0\b|p = 0(?![.\d])"),
    "a column's name": re.compile(r"\b[a-z0-9]+(?:_[a-z0-9]+){2,}\b"),
    "a power with a caret": re.compile(r"\w\^"),
    "no number": re.compile(r"\b(?:None|nan|NaN|inf)\b"),
}


def test_prose_reads_as_a_physicist_writes(site: Path) -> None:
    """In headings, sentences, tables and alt texts; ids and settings stand in code, metadata as somebody typed them."""
    for path, page in pages(site):
        if "script" in path.name or "hostile" in path.name or "style" in path.name:
            continue
        spoken = [*page.prose, *(str(image["alt"]) for image in page.images)]
        for what, pattern in PROSE.items():
            found = [
                text for text in spoken if pattern.search(text.replace("\u00a0", " ")) and not text.startswith("Data:")
            ]
            assert not found, (path, what, found[:3])


def test_what_was_refused_damaged_or_taken_out_appears(site: Path) -> None:
    index = "".join(Parsed((site / "index.html").read_text(encoding="utf-8")).text)
    for words in (
        "sphs_P-11_b.mcap", "Correct the channel's unit on the rig", "no end of file", "P-06_chirp-2", "clamp not tightened",
        "growing.mcap", "chirp_P-05_copy.mcap", "readme.txt", "the fit did not converge",
    ):  # fmt: skip
        assert words in index, words
    assert "Traceback" not in index
    assert "the fit did not converge" in (site / "specimens" / "P-06.html").read_text(encoding="utf-8")


def test_what_lives_depend_on_and_what_was_left_out_stand_on_the_page(site: Path) -> None:
    page = Parsed((site / "campaigns" / "Endurance.html").read_text(encoding="utf-8"))
    text = "".join(page.text).replace("\u00a0", " ")
    for said in (
        "Life depends on electrode and voltage", "D-left-out: negative lifetime", "Log-normal check.", "Causes compete.",
        "Dashed where nothing was tested", "Each group against the regression", "Effects on each mode of failure", "6 kV over 4 kV",
    ):  # fmt: skip
        assert said in text, said
    drawn = " ".join(str(image["alt"]) for image in page.images)
    for figure in (
        "Median life against voltage, tested from 4 to 6",
        "Effects on life",
        "Cox–Snell",
        "Deviance residuals",
    ):
        assert figure in drawn


def test_findings_stand_in_the_index(site: Path) -> None:
    index = "".join(Parsed((site / "index.html").read_text(encoding="utf-8")).text).replace("\u00a0", " ")
    assert "Three specimens need a look; four behave as simulated; the other two are fitted, not diagnosed" in index
    assert "the load cell is stiffer than its file says, by 6.3 ± 0.3 %" in index
    assert "none of the 23 listed causes explains it" in index
    assert "times the median life of “single AR”" in index
    assert "Specimen P-07: the film wrinkles from 6.70 (6.40–7.00) kV on" in index
    assert "one film wrinkles" in index
    assert index.index("the film wrinkles") < index.index("none of the 23 listed causes"), "ranked by what one acts on"


def test_empty_lab(tmp_path: Path) -> None:
    result = build_reports(synthetic_lab.Story().write(tmp_path / "lab"))
    text = result.index.read_text(encoding="utf-8")
    assert "No recordings yet" in text
    assert "dealab nightly RAW" in text
    assert [p.name for p in (tmp_path / "lab" / "reports").rglob("*.html")] == ["index.html"]


def test_only_refused_files(tmp_path: Path) -> None:
    lab = synthetic_lab.only_refused().write(tmp_path / "lab")
    page = Parsed(build_reports(lab).index.read_text(encoding="utf-8"))
    text = "".join(page.text).replace("\u00a0", " ")
    assert "Nothing could be used: all three files were refused" in text
    assert "Check the connector of the load cell" in text


def test_recordings_without_any_analysis(tmp_path: Path) -> None:
    story = synthetic_lab.Story()
    story.recording(
        "a-1", "A", "chirp", "mechanical", metadata=None, source_sha256=None, duration_s=None, campaign=None
    )
    story.recording("a-2", None, "tap", "calibration", started_at=None, status="damaged", problem="cut")
    story.run()
    lab = story.write(tmp_path / "lab")
    text = build_reports(lab).index.read_text(encoding="utf-8").replace("\u00a0", " ")
    assert "Two recordings, no model fitted yet" in text
    for path, _ in pages(lab / "reports"):
        assert "None" not in "".join(Parsed(path.read_text(encoding="utf-8")).text), path


def test_no_database(tmp_path: Path) -> None:
    with pytest.raises(LabError, match="no database"):
        build_reports(tmp_path)
    (tmp_path / "results.duckdb").write_bytes(b"not a database" * 400)
    with pytest.raises(LabError, match="cannot be read"):
        build_reports(tmp_path)


def test_database_of_another_version(tmp_path: Path) -> None:
    with duckdb.connect(str(tmp_path / "results.duckdb")) as connection:
        connection.execute("CREATE TABLE recordings (recording_id VARCHAR)")
    with pytest.raises(LabError, match="has no table"):
        build_reports(tmp_path)


def test_database_of_an_earlier_version_without_a_column(tmp_path: Path) -> None:
    """The page of a specimen ended in a KeyError, and the report was not whole."""
    story = synthetic_lab.Story()
    story.run()
    lab = story.write(tmp_path / "lab")
    with duckdb.connect(str(lab / "results.duckdb")) as connection:
        connection.execute("ALTER TABLE diagnoses DROP COLUMN would_tell")
    with pytest.raises(LabError, match=r"has no column diagnoses\.would_tell"):
        build_reports(lab)


def work(lab: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[int, int, int]:
    """Pages that a build makes, the queries it asks and the rows it gets."""
    asked: list[int] = []
    rows, columns = Results.rows, Results.columns

    def counted_rows(self: Results, query: Query | str) -> list[Row]:
        found = rows(self, query)
        asked.append(len(found))
        return found

    def counted_columns(self: Results, query: Query) -> dict[str, Any]:
        found = columns(self, query)
        asked.append(max((v.size for v in found.values()), default=0))
        return found

    with monkeypatch.context() as patch:
        patch.setattr(Results, "rows", counted_rows)
        patch.setattr(Results, "columns", counted_columns)
        result = build_reports(lab)
    return result.pages_written, len(asked), sum(asked)


@pytest.mark.long
def test_hundreds_of_recordings_stay_small_and_cost_in_proportion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Queries and rows per page do not grow with the campaign: what 70 recordings cost, 500 cost seven times."""
    labs = {count: synthetic_lab.many(count, points=200).write(tmp_path / str(count)) for count in (30, 70)}
    few, many = (work(lab, monkeypatch) for lab in labs.values())
    assert many[0] > few[0] + 40
    assert many[1] / many[0] <= 1.2 * few[1] / few[0], "a square would double it"
    assert many[2] / many[0] <= 1.2 * few[2] / few[0]
    index = (labs[70] / "reports" / "index.html").stat().st_size
    before = (labs[30] / "reports" / "index.html").stat().st_size
    assert index <= 300_000
    assert index - before < 60_000, "small multiples stop at 24 and tables at their limits"


def test_a_preview_of_full_length_stays_small(tmp_path: Path) -> None:
    lab = synthetic_lab.many(10).write(tmp_path / "lab")
    build_reports(lab)
    largest = max((lab / "reports" / "recordings").glob("*.html"), key=lambda p: p.stat().st_size)
    assert largest.stat().st_size <= 200_000


@pytest.mark.long
def test_one_new_recording_in_a_large_campaign_touches_a_handful_of_pages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counted: its own page, its specimen, its campaign, the index and the last part of the list."""
    lab = synthetic_lab.many(40, points=40).write(tmp_path / "lab")
    whole = work(lab, monkeypatch)
    with duckdb.connect(str(lab / "results.duckdb")) as connection:
        connection.execute(
            "INSERT INTO recordings BY NAME SELECT * REPLACE ('M-000_chirp-10' AS recording_id, 'new' AS source_path)"
            " FROM recordings WHERE recording_id = 'M-000_chirp-1'"
        )
    pages_made, queries, _ = work(lab, monkeypatch)
    assert pages_made <= 7
    assert queries < whole[1] / 3


def test_long_lists_come_in_parts_and_the_index_stays_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for kind in ("recording", "specimen"):  # hundreds of them, which have tests of their own
        monkeypatch.setitem(plan._ABOUT, kind, many_pages.page)
    story = synthetic_lab.Story()
    for i in range(210):
        story.recording(
            None,
            None,
            "chirp",
            "mechanical",
            source_path=f"/raw/{i:04d}.mcap",
            status="quarantined",
            problem="broken. Mend it again",
        )
        story.recording(f"r-{i:04d}", f"s-{i:04d}", "chirp", "mechanical")
        story.fits(f"s-{i:04d}", synthetic_lab.SILICONE)
    story.run()
    lab = story.write(tmp_path / "lab")
    for row in story.rows["model_fits"]:
        assert row["specimen_id"]
    assert build_reports(lab).index.stat().st_size <= 300_000
    names = {p.name for p in (lab / "reports").glob("*.html")}
    assert {"recordings-1.html", "refused-2.html", "specimens-2.html"} <= names
    for path in (lab / "reports").glob("*.html"):
        Parsed(path.read_text(encoding="utf-8"))


@pytest.mark.long
def test_where_memory_does_not_do_more_is_taken(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / "lab"
    other.mkdir()
    shutil.copy(small / "results.duckdb", other)
    tried = []
    usual = build._build

    def counted(lab: Path, memory: str, *more: Any) -> Any:
        tried.append(memory)
        return usual(lab, memory, *more)

    monkeypatch.setattr(build, "MEMORY", ("1MB", *MEMORY))
    monkeypatch.setattr(build, "_build", counted)
    build_reports(other)
    assert tried == ["1MB", MEMORY[0]]
    assert contents(other / "reports") == contents(small / "reports")


def test_manifest_holds_no_place_and_no_time(site: Path) -> None:
    manifest = json.loads((site / NAME).read_text())
    assert set(manifest) == {"pages"}
    assert str(site.parent) not in (site / NAME).read_text()
