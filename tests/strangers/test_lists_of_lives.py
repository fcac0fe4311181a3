"""Lists of lives as laboratories keep them: cycles, marks with a legend, sheets, means below the table; and sheets that belong together."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from ingest.answers import answered, as_suggested, draft_with
from ingest.draft import make_draft
from ingest.faults import find_faults
from ingest.mapping import FileMapping
from ingest.outcomes import ALIVE, FAILED, NO_TEST, deal_marks, read_legend, tell_outcome
from ingest.parts import list_parts, part_of
from ingest.read import read_raw
from ingest.tables import LifetimeTable, ResponseTable
from pipeline.cli import main
from schemas.errors import RefusedError, UsageError
from schemas.recording import RawRecording
from tests.helpers.xlsx_files import write_xlsx

CYCLES: list[list[Any]] = [
    ["Dauerlauf PA-T, Rechteck 2 Hz", "", "", "", ""],
    ["", "", "", "", ""],
    ["lfd. Nr.", "Spannung", "Zyklen", "Status", "Schaden"],
    ["", "kV", "×1000", "", ""],
    [1, "1,6", 269.5, "A", "Rand"],
    [2, "1,6", 655.0, "läuft noch", ""],
    [3, "1,6", 1000.0, "DL", ""],
    [4, "2,0", 9.3, "A", "Riss"],
    [5, "2,0", 58.3, "AB", ""],
    [6, "2,0", 12.0, "X", ""],
    ["", "", "", "", ""],
    ["Mittel", "1,6", 641.5, "", ""],
    ["", "", "", "", ""],
    ["A = ausgefallen, DL = Durchläufer, AB = abgebrochen ohne Ausfall, X = ungültig (Montage)", "", "", "", ""],
]


def read_lives(path: Path, content: dict[str, Any]) -> LifetimeTable:
    found = read_raw(path, FileMapping.parse(content, stem=path.stem, suffix=path.suffix))
    assert isinstance(found, LifetimeTable)
    return found


def test_cycles_marks_and_a_legend_are_drafted_and_no_survivor_is_lost(tmp_path: Path) -> None:
    path = write_xlsx(tmp_path / "lives.xlsx", {"Notizen": [["Kanal 3"], ["neu"]], "Tabelle1": CYCLES})
    draft = make_draft(path)
    columns = draft.content["columns"]
    assert columns["lifetime"] == {"column": "Zyklen", "unit": "kcycles"}
    assert columns["frequency"] == {"value": 2.0, "unit": "Hz"}
    assert columns["failed"]["failed_values"] == ["A"]
    assert columns["failed"]["censored_values"] == ["läuft noch", "DL", "AB"]
    assert columns["failed"]["no_test_values"] == ["X"]
    assert any("the sheet Tabelle1" in text for text in draft.told)
    table = read_lives(path, tomllib.loads(draft.as_toml()))
    assert [(row.lifetime_s, row.failed) for row in table.rows] == [
        (269.5e3 / 2, True),
        (655e3 / 2, False),
        (1e6 / 2, False),
        (9.3e3 / 2, True),
        (58.3e3 / 2, False),
    ]
    said = " ".join(table.notes).replace("\xa0", " ")
    assert "one specimen marked as no test" in said
    assert "one row of means or sums" in said
    assert table.problems == ()


@pytest.mark.parametrize(
    ("header", "mark", "unit"),
    [
        (("Probe", "Zyklen in Tausend", "Status"), ("ausgefallen", "Durchläufer"), "kcycles"),
        (("Specimen", "cycles to failure", "Status"), ("F", "suspended"), "cycles"),
        (("Specimen", "Cycles (x1000)", "Outcome"), ("failed", "runout"), "kcycles"),
        (("Nr.", "Lastwechsel [Mio.]", "Ergebnis"), ("Bruch", "läuft noch"), "Mcycles"),
        (("Aktor", "Hübe /1000", "Ende"), ("A", "ohne Ausfall"), "kcycles"),
        (("Muster", "Standzeit [h]", "Zustand"), ("defekt", "i.O."), "h"),
    ],
)
def test_headers_of_many_kinds(tmp_path: Path, header: tuple[str, ...], mark: tuple[str, str], unit: str) -> None:
    rows = [[f"S-{i}", 100.0 + i, mark[i % 3 == 0]] for i in range(8)]
    path = write_xlsx(tmp_path / "lives.xlsx", {"Liste": [["Test mit 10 Hz"], list(header), *rows]})
    draft = make_draft(path)
    assert draft.content["kind"] == "lifetimes"
    assert draft.content["columns"]["lifetime"]["unit"] == unit
    table = read_lives(path, tomllib.loads(draft.as_toml()))
    assert [row.failed for row in table.rows] == [i % 3 != 0 for i in range(8)]


def test_marks_that_nothing_tells_are_asked_and_never_guessed(tmp_path: Path) -> None:
    rows = [[f"S-{i}", 100.0 + i, "ABC"[i % 3]] for i in range(9)]
    path = write_xlsx(tmp_path / "lives.xlsx", {"Liste": [["Probe", "Lebensdauer (h)", "Status"], *rows]})
    draft, _ = as_suggested(make_draft(path))
    assert [q.key for q in draft.questions] == ["columns.failed.failed_values"]
    said = {"failed.failed_values": "[A]", "failed.censored_values": "[B]", "failed.no_test_values": "[C]"}
    again, placed = draft_with(path, said)
    table = read_lives(path, tomllib.loads(answered(again, placed).as_toml()))
    assert (len(table.rows), sum(row.failed for row in table.rows)) == (6, 3)


def test_what_a_person_says_of_kind_columns_and_sheet_is_taken(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lives = [["Stück", "Dauer", "wie"], *[[f"S-{i}", 10.0 * (5 - i), "tot" if i else "lebt"] for i in range(5)]]
    curve = [["Zeit (s)", "Kraft (N)"], *[[0.1 * i, 1.0] for i in range(30)]]
    path = write_xlsx(tmp_path / "all.xlsx", {"Kraft": curve, "Leben": lives})
    with pytest.raises(RefusedError, match="no columns of a table of kind lifetimes"):
        draft_with(path, {"kind": "lifetimes", "sheet": "Kraft"})
    with pytest.raises(RefusedError, match="there is no sheet"):
        draft_with(path, {"sheet": "Nirgends"})
    with pytest.raises(UsageError, match="kind=lives: no kind"):
        draft_with(path, {"kind": "lives"})
    answers = ["kind=lifetimes", "sheet=Leben", "Dauer=lifetime", "wie=failed", "lifetime.unit=min"]
    assert main(["add", str(path), "--yes", *answers]) == 0
    told = capsys.readouterr().out
    assert "read is the sheet Leben; not Kraft" in told
    assert "5 lives from 600 to 3000 s: 4 failed, 1 still alive" in told


@pytest.mark.parametrize(
    ("mark", "outcome"),
    [
        ("no failure", ALIVE),
        ("kein Durchschlag", ALIVE),
        ("Durchschlag", FAILED),
        ("läuft noch", ALIVE),
        ("run-out", ALIVE),
        ("ungültig", NO_TEST),
        ("nein", ALIVE),
        ("ja", FAILED),
        ("Q", None),
    ],
)
def test_words_of_outcomes(mark: str, outcome: str | None) -> None:
    assert tell_outcome(mark, {}) == outcome


def test_a_legend_is_read_in_many_forms() -> None:
    marks = ["D", "R", "E", "X", "L"]
    words = ["Legende: D: Durchschlag; R: Riss; E: Versuchsende; X: ungültig", "L = läuft noch"]
    told, unknown = deal_marks(marks, read_legend(words, marks))
    assert told == {"D": FAILED, "R": FAILED, "E": ALIVE, "X": NO_TEST, "L": ALIVE}
    assert unknown == []
    assert deal_marks(["P", "Q"], {}) == ({}, ["P", "Q"])
    assert deal_marks(["P", "DL"], {}) == ({"P": FAILED, "DL": ALIVE}, [])


def test_sheets_with_the_same_columns_are_one_table(tmp_path: Path) -> None:
    head = [["Sweep"], ["f", "Storage modulus", "Loss modulus", "Temperature"], ["Hz", "MPa", "MPa", "°C"]]
    sheets = {
        f"Sweep {n}": [*head, *[[10.0**i, 1.0 + i - 0.01 * warm, 0.1, warm + 0.02] for i in range(4)]]
        for n, warm in enumerate((0.0, 20.0, 40.0))
    }
    path = write_xlsx(tmp_path / "dma.xlsx", {"Details": [["Sample name", "PU-3"]], **sheets})
    draft = make_draft(path)
    content = tomllib.loads(draft.as_toml())
    assert content["excel"]["sheet"] == ["Sweep 0", "Sweep 1", "Sweep 2"]
    assert content["recording"]["specimen_id"] == "PU-3"
    assert find_faults(path, content) == ()
    mapping = FileMapping.parse(content, stem="dma", suffix=".xlsx")
    assert list_parts(path, mapping) == ("0", "20", "40")
    table = read_raw(path, part_of(mapping, "20"))
    assert isinstance(table, ResponseTable)
    assert table.value.real == pytest.approx([0.8, 1.8, 2.8, 3.8])
    content["excel"]["sheet"] = ["Sweep 0", "Details"]
    assert any("other columns" in str(fault) or "rows" in str(fault) for fault in find_faults(path, content))


def test_sheets_of_samples_become_a_recording_each(tmp_path: Path) -> None:
    def sheet(rows: list[list[Any]]) -> list[list[Any]]:
        return [["Zeit", "Weg", "Kraft"], ["s", "mm", "N"], *rows]

    held = [[0.1 * i, min(i, 20) * 0.1, min(i, 20) * 0.01] for i in range(300)]
    moved = [[0.1 * i, 5 - abs(i % 100 - 50) * 0.1, 0.5 - abs(i % 100 - 50) * 0.01] for i in range(301)]
    path = write_xlsx(tmp_path / "strip.xlsx", {"Relaxation": sheet(held), "Zyklen": sheet(moved)})
    content = tomllib.loads(make_draft(path).as_toml())
    mapping = FileMapping.parse(content, stem="strip", suffix=".xlsx")
    assert list_parts(path, mapping) == ("Relaxation", "Zyklen")
    found = [read_raw(path, part_of(mapping, name)) for name in ("Relaxation", "Zyklen")]
    for raw, protocol, size in zip(found, ("step", "cycle"), (300, 301), strict=True):
        assert isinstance(raw, RawRecording)
        assert raw.metadata["protocol"] == protocol
        assert raw.channels[0].values.size == size


def test_a_unit_under_one_name_and_a_legend_in_two_columns(tmp_path: Path) -> None:
    rows: list[list[Any]] = [
        ["Dauerversuch", "", "", ""],
        ["Probe", "Elektrode", "Zyklen", "Status"],
        ["", "", "[Tsd.]", ""],
        *[[f"P{i:02}", "KF", 100.0 + i, "DRAX"[i % 4]] for i in range(12)],
        ["Charge 2", "", "", ""],
        ["P20", "RS", "> 2000", "L"],
        ["Mittelwert", "", 105.5, ""],
        ["", "", "", ""],
        ["Legende", "", "", ""],
        ["D", "Durchschlag (Ausfall)", "", ""],
        ["R", "Riss (Ausfall)", "", ""],
        ["L", "läuft noch / bei Versuchsende intakt", "", ""],
        ["A", "abgebrochen ohne Ausfall", "", ""],
        ["X", "ungültig, nicht werten", "", ""],
    ]
    cover = [["Ansteuerung", "Sinus 3 kV, 10 Hz"]]
    path = write_xlsx(tmp_path / "lives.xlsx", {"Deckblatt": cover, "Lebensdauer": rows})
    draft = make_draft(path)
    failed = draft.content["columns"]["failed"]
    assert (failed["failed_values"], failed["no_test_values"]) == (["D", "R"], ["X"])
    assert sorted(failed["censored_values"]) == ["A", "L"]
    assert draft.content["columns"]["frequency"]["value"] == 10.0
    table = read_lives(path, tomllib.loads(draft.as_toml()))
    assert (len(table.rows), sum(row.failed for row in table.rows)) == (10, 6)
    assert max(row.lifetime_s for row in table.rows) == 200_000.0
