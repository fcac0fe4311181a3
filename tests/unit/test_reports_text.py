"""Names that anybody may have typed: file names, visible text, CSV, SQL literals, escaping."""

from __future__ import annotations

import csv as reader
import io
import unicodedata

import duckdb
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from markupsafe import Markup

from reports import blocks
from reports.csvfile import csv
from reports.names import FileNames, Verbatim, short, visible
from reports.render import keep_ranges, unbroken
from reports.results import Query

ANY = st.text(st.characters(codec="utf-8"), max_size=120)


@settings(deadline=None)
@given(st.lists(ANY, max_size=8))
def test_every_name_has_a_file_of_its_own(names: list[str]) -> None:
    files = FileNames(names)
    found = {name: files(name) for name in names}
    assert len({f.casefold() for f in found.values()}) == len(set(names))
    for file in found.values():
        assert file.isascii()
        assert 0 < len(file) <= 60
        assert not set(file) & set("/\\:*?\"<>| '")
        assert not file.startswith((".", "-"))


@pytest.mark.parametrize("name", ["../x", "..", ".", "", "CON", "nul.txt", "a/b", "x" * 200, "a.", "Straße"])
def test_dangerous_names_are_changed(name: str) -> None:
    assert FileNames([name])(name) != name


def test_ordinary_names_are_kept() -> None:
    assert FileNames(["P-07", "chirp_1.2"])("P-07") == "P-07"


def test_names_that_differ_in_case_only_are_kept_apart() -> None:
    files = FileNames(["p-07", "P-07", "S-01"])
    assert files("p-07").casefold() != files("P-07").casefold()
    assert files("S-01") == "S-01"


@settings(deadline=None)
@given(ANY)
def test_nothing_shown_acts_on_the_text_around(text: str) -> None:
    shown = visible(text).replace("\n", "").replace("\t", "")
    assert not {unicodedata.category(c) for c in shown} & {"Cc", "Cf", "Cs", "Zl", "Zp"}


def test_direction_overrides_are_spelt_out() -> None:
    assert visible("a\u202eb\u0000") == "a\\u202eb\\u0000"


def test_long_text_is_cut() -> None:
    assert short("x " * 9000, 20) == "x x x x x x x x x x…"


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(ANY, st.floats(allow_nan=False, allow_infinity=False, width=32)), min_size=1, max_size=5))
def test_csv_reads_back(rows: list[tuple[str, float]]) -> None:
    text = csv({"name": [r[0] for r in rows], "value": [r[1] for r in rows]})
    found = list(reader.reader(io.StringIO(text, newline="")))
    assert found[0] == ["name", "value"]
    for (name, value), (shown, number) in zip(rows, found[1:], strict=True):
        assert shown in (name, "'" + name)
        assert float(number) == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize("cell", ["=cmd|' /C calc'!A0", "+1", "@SUM(A1)", "-2+3"])
def test_csv_text_is_no_formula(cell: str) -> None:
    assert csv({"a": [cell]}).splitlines()[1].lstrip('"').startswith("'")


@settings(max_examples=60, deadline=None)
@given(ANY.filter(lambda t: "\x00" not in t))
def test_shown_sql_selects_the_same(value: str) -> None:
    query = Query("SELECT $item AS found, $item_2 AS other", {"item": value, "item_2": 2.5})
    with duckdb.connect() as connection:
        assert connection.execute(query.shown()).fetchall() == [(value, 2.5)]


@settings(deadline=None)
@given(ANY)
def test_pieces_escape_what_they_hold(text: str) -> None:
    hostile = f'<script>{text}</script>"'
    for piece in (
        blocks.name(hostile, 400),
        blocks.code(hostile),
        blocks.tag("named", hostile),
        blocks.link(hostile, "x"),
    ):
        assert "<script" not in piece
        assert "&lt;script" in piece
    assert "<script" not in blocks.flow("a", hostile)


def test_quantities_are_kept_together_and_sql_is_not_touched() -> None:
    assert unbroken("5 % of 3 kV") == "5\u00a0% of 3\u00a0kV"
    assert unbroken(Markup("<b>5 s</b> <code>run 5 s.csv</code>")) == "<b>5\u00a0s</b> <code>run 5 s.csv</code>"
    assert unbroken(Verbatim("SELECT 5 % 3")) == "SELECT 5 % 3"
    assert unbroken("2Δ ln L of 40 µm, 3 Pa") == "2Δ ln\u00a0L of 40\u00a0µm, 3\u00a0Pa"
    assert unbroken("5 days, 3 models") == "5 days, 3 models"


def test_an_equation_has_its_indices_below_and_exponents_above_and_is_escaped() -> None:
    assert blocks.equation("τ_r V̇ = u − V") == "τ<sub>r</sub> V̇ = u − V"
    assert blocks.equation("ε (1 − a (E/E_max)^p)") == "ε (1 − a (E/E<sub>max</sub>)<sup>p</sup>)"
    assert blocks.equation("d (1 − e^{−A_max/a})") == "d (1 − e<sup>−A<sub>max</sub>/a</sup>)"
    assert blocks.equation("drive_lag <b> 1^") == "drive_lag &lt;b&gt; 1^"


def test_ranges_stay_on_one_line_and_the_text_is_as_written() -> None:
    """No character is put into a number that somebody may copy; cells of numbers are not broken anyway."""
    kept = '<span class="one">(6.40–7.00)</span>'
    assert keep_ranges("<h1>from 6.70 (6.40–7.00) kV</h1>") == f"<h1>from 6.70 {kept} kV</h1>"
    assert keep_ranges("<p>1–100 Hz <b>x</b></p>") == '<p><span class="one">1–100</span> Hz <b>x</b></p>'
    for text in (
        '<td class="n">6.70 (6.40–7.00)</td>',
        "<p><code>1–2</code> Kaplan–Meier</p>",
        '<p><a href="1–2">a</a></p>',
    ):
        assert keep_ranges(text) == text
