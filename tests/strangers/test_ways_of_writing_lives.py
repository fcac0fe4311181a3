"""Lists of lives as people write them: dates alone, hours with a colon, places of failures, names once for a block, what came from outside."""

from __future__ import annotations

import csv
import tomllib
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pytest

from ingest.draft import make_draft
from ingest.mapping import FileMapping
from ingest.outcomes import ALIVE, FAILED, NO_TEST, tell_outcome
from ingest.read import read_raw
from ingest.tables import LifetimeTable
from pipeline.cli import main
from tests.helpers.xlsx_files import write_xlsx
from tests.strangers.nights import run_night


def read_drafted(path: Path) -> LifetimeTable:
    content = tomllib.loads(make_draft(path).as_toml())
    found = read_raw(path, FileMapping.parse(content, stem=path.stem, suffix=path.suffix))
    assert isinstance(found, LifetimeTable)
    return found


def kaplan_meier(lives: list[tuple[float, bool]], until: float) -> float:
    """The restricted mean by its definition, the area below the steps."""
    alive, area, before = 1.0, 0.0, 0.0
    for i, (life, failed) in enumerate(sorted(lives)):
        area += alive * (life - before)
        before = life
        alive *= 1 - 1 / (len(lives) - i) if failed else 1.0
    return area + alive * (until - before)


def write_french(path: Path) -> dict[str, list[tuple[float, bool]]]:
    """A semicolon table of starts and ends alone, the kind of film written once for its block; returns the true lives in s."""
    draw = np.random.default_rng(11)
    rows: list[list[str]] = [["Film", "Échantillon", "Tension (kV)", "Début", "Fin", "Défaillance"]]
    true: dict[str, list[tuple[float, bool]]] = {}
    begin = datetime(2026, 2, 9, 9, 0)
    for block, scale in (("silicone", 40.0), ("acrylique", 400.0)):
        for i in range(10):
            minutes = int(scale * draw.weibull(2.0)) + 2
            how = ("claquage au bord", "claquage au centre", "coupure de courant", "retiré")[i % 4]
            end = begin + timedelta(minutes=minutes)
            name = block if i == 0 else ""
            rows.append([name, f"{block[0]}{i}", "4,5", f"{begin:%d/%m/%Y %H:%M}", f"{end:%d/%m/%Y %H:%M}", how])
            true.setdefault(block, []).append((60.0 * minutes, i % 4 < 2))
            begin = end + timedelta(minutes=30)
    with path.open("w", encoding="cp1252", newline="") as file:
        csv.writer(file, delimiter=";").writerows(rows)
    return true


def test_starts_and_ends_of_blocks_become_lives_on_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Dates of ends were taken for outcomes, blocks of merged names for specimens without a name."""
    folder = tmp_path / "files"
    folder.mkdir()
    true = write_french(folder / "durees.csv")
    assert main(["add", str(folder / "durees.csv"), "--yes", "campaign=essais"]) == 0
    told = capsys.readouterr().out
    assert "['coupure de courant', 'retiré'] mean censored" in told
    made = run_night(folder, tmp_path / "night")
    with duckdb.connect(str(made.lab / "results.duckdb"), read_only=True) as connection:
        asked = "SELECT configuration, specimens, failures, restricted_mean_s, restricted_to_s FROM survival_summaries"
        groups = {row[0]: row[1:] for row in connection.sql(asked).fetchall()}
        assumed = connection.sql("SELECT value FROM assumptions WHERE what LIKE 'life of row%'").fetchall()
    assert assumed == [("the time between start and end",)]
    for name, lives in true.items():
        specimens, failures, mean, until = groups[name]
        assert (specimens, failures) == (10, sum(failed for _, failed in lives))
        assert mean == pytest.approx(kaplan_meier([(min(t, until), f and t <= until) for t, f in lives], until))
    page = (made.lab / "reports" / "campaigns" / "essais.html").read_text(encoding="utf-8")
    assert "acrylique" in page


def write_list(path: Path, header: str, lives: list[str]) -> Path:
    ends = ["failed", "still running"]
    rows = [["Specimen", header, "Status"], *[[f"S{i}", life, ends[i % 3 == 2]] for i, life in enumerate(lives)]]
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    return path


@pytest.mark.parametrize(
    ("header", "lives", "seconds"),
    [
        ("Lifetime [hh:mm]", ["64:33", "1:05", "168:00", "2:00"], [232380.0, 3900.0, 604800.0, 7200.0]),
        ("Lifetime (mm:ss)", ["64:33", "1:05", "168:00", "2:00"], [3873.0, 65.0, 10080.0, 120.0]),
        ("Lifetime [hh:mm:ss]", ["64:33:47", "1:5:09", "168:00:00", "2:00:00"], [232427.0, 3909.0, 604800.0, 7200.0]),
        ("Lifetime [h]", ["64:33:47", "1:05:09", "168:00:00", "2:00:00"], [232427.0, 3909.0, 604800.0, 7200.0]),
        ("Lifetime", ["00:10:00", "11:00:30", "> 24:00:00", "02:00:00"], [600.0, 39630.0, 86400.0, 7200.0]),
        ("Lifetime [h]", ["64.5", "1.25", "168", "2"], [232200.0, 4500.0, 604800.0, 7200.0]),
    ],
)
def test_durations_with_colons(tmp_path: Path, header: str, lives: list[str], seconds: list[float]) -> None:
    table = read_drafted(write_list(tmp_path / "l.csv", header, lives))
    assert [row.lifetime_s for row in table.rows] == pytest.approx(seconds, rel=1e-12)
    assert [row.failed for row in table.rows] == [True, True, False, True]


@pytest.mark.parametrize("header", ["Standzeit", "Lebensdauer [h]", "Lebensdauer (hh:mm:ss)"])
def test_durations_of_a_workbook(tmp_path: Path, header: str) -> None:
    lives = [timedelta(hours=20 * i + 1, minutes=3, seconds=5) for i in range(6)]
    ends = ["läuft noch", "ausgefallen", "ausgefallen"]
    rows: list[list[Any]] = [["Probe", header, "Status"]]
    rows += [[f"S{i}", life, ends[i % 3]] for i, life in enumerate(lives)]
    table = read_drafted(write_xlsx(tmp_path / "x.xlsx", {"Liste": rows}))
    assert [row.lifetime_s for row in table.rows] == pytest.approx([life.total_seconds() for life in lives], rel=1e-12)


def test_two_parts_without_a_name_are_asked(tmp_path: Path) -> None:
    draft = make_draft(write_list(tmp_path / "l.csv", "Lifetime", ["64:33", "1:05", "168:00", "2:00"]))
    (asked,) = [q for q in draft.questions if q.key == "columns.lifetime.format"]
    assert (asked.suggestion, asked.choices) == (None, ("hh:mm", "mm:ss"))


@pytest.mark.parametrize(
    ("mark", "outcome"),
    [
        ("Stromausfall, Probe unbeschädigt", ALIVE),
        ("Netzausfall", ALIVE),
        ("power cut", ALIVE),
        ("power failure in the building", ALIVE),
        ("supply failed, film still good", ALIVE),
        ("PC crashed", ALIVE),
        ("coupure de courant", ALIVE),
        ("interlock opened", ALIVE),
        ("Not-Aus gedrückt", ALIVE),
        ("nach 7 Tagen abgeschaltet", ALIVE),
        ("switched off", ALIVE),
        ("Durchschlag Zuleitung", FAILED),
        ("breakdown at the edge", FAILED),
        ("failed after power-up", FAILED),
        ("no test", NO_TEST),
        ("film ok", ALIVE),
        ("not ok", FAILED),
        ("nicht in Ordnung", FAILED),
        ("n. i. O.", FAILED),
        ("film still fine", ALIVE),
    ],
)
def test_what_ends_a_test_from_outside_is_no_failure(mark: str, outcome: str) -> None:
    """`Stromausfall` has the word of a failure in it."""
    assert tell_outcome(mark, {}) == outcome


def test_dates_that_may_begin_with_day_or_month_are_asked(tmp_path: Path) -> None:
    """They were taken for American ones, whatever the decimal mark."""
    path = tmp_path / "d.csv"
    write_french(path)
    lines = [line for line in path.read_text(encoding="cp1252").splitlines() if "/02/" in line.replace("09/02", "")]
    assert len(lines) > 4  # days beyond twelve tell the order
    draft = make_draft(path)
    assert draft.content["columns"]["started"]["format"] == "%d/%m/%Y %H:%M"
    rows = ["Sample;Start;End;Result", *[f"S{i};0{i}/04/2026 10:00;0{i}/05/2026 11:00;failed" for i in range(1, 7)]]
    path.write_text("\n".join(rows) + "\n")
    assert "columns.started.format" in [q.key for q in make_draft(path).questions]


def test_places_tell_failures_only_in_a_column_of_outcomes() -> None:
    assert tell_outcome("lead / tab", {}) is None
    assert tell_outcome("lead / tab", {}, is_named=True) == FAILED
    assert tell_outcome("none", {}, is_named=True) == ALIVE


def test_an_end_before_its_start_is_refused_and_a_life_beyond_them_is_told(tmp_path: Path) -> None:
    day = datetime(2026, 5, 4, 10, 0)
    rows: list[list[Any]] = [["Sample", "Start", "End", "Life [s]", "Result"]]
    rows += [[f"S{i}", day, day + timedelta(minutes=10), 590.0, "failed"] for i in range(4)]
    rows[2][3] = 3000.0
    path = write_xlsx(tmp_path / "a.xlsx", {"lives": rows})
    problems = " ".join(read_drafted(path).problems).replace("\xa0", " ")
    assert "one life is longer than their start and end are apart, by up to 2400 s (row 2)" in problems
    rows[3][2], rows[3][3] = day - timedelta(minutes=10), None
    path = write_xlsx(tmp_path / "b.xlsx", {"lives": rows})
    with pytest.raises(Exception, match=r"row 3 of the data: the test ends before it starts"):
        read_drafted(path)
