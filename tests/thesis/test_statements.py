"""The table of the thesis' figures and tables: none is left out, every query can be asked, every difference has its reason."""

from __future__ import annotations

import json
from dataclasses import replace

import duckdb
import pytest

from schemas.tables import TABLES
from schemas.views import VIEWS
from tests.thesis.__main__ import RESULTS, ask, judge, table
from tests.thesis.statements import STATEMENTS, Statement

FIGURES = {3: 13, 4: 17, 5: 13}
"""Figures of each chapter with results."""


@pytest.fixture(scope="module")
def empty() -> duckdb.DuckDBPyConnection:
    """A database with every table and view, and nothing in it."""
    connection = duckdb.connect()
    for made in (*TABLES.values(), *VIEWS):
        connection.execute(made.ddl())
    return connection


def test_no_figure_and_no_table_is_left_out() -> None:
    places = [s.where for s in STATEMENTS]
    for chapter, count in FIGURES.items():
        for number in range(1, count + 1):
            name = f"figure {chapter}-{number}"
            assert any(p == name or p.rstrip("abc") == name for p in places), name
    assert {f"table 4.{n}" for n in range(1, 5)} <= set(places)
    assert len(STATEMENTS) >= 60
    assert len({(s.where, s.what) for s in STATEMENTS}) == len(STATEMENTS)


def test_every_query_can_be_asked(empty: duckdb.DuckDBPyConnection) -> None:
    for statement in STATEMENTS:
        value = ask(empty, statement)
        assert len(value) == 3


def test_pictures_say_what_they_are() -> None:
    assert all(s.why for s in STATEMENTS if s.answer is None or s.thesis is None)
    assert all(".html#" in s.page or s.page == "control.html" for s in STATEMENTS)


def test_a_number_is_the_same_where_its_limits_hold_the_printed_one() -> None:
    one = Statement("figure 0-0", "a", "a.html#b", "SELECT 1", 2.0)
    assert judge(one, (1.9, 1.7, 2.1)) == "same"
    assert judge(one, (1.9, 1.8, 1.95)) == "differs"
    assert judge(replace(one, accuracy=0.1), (1.9, 1.8, 1.95)) == "same"
    assert judge(one, (2.0, None, None)) == "same"
    assert judge(one, (None, None, None)) == "missing"
    assert judge(replace(one, thesis=None), (1.0, None, None)) == "no number"
    assert judge(replace(one, answer=None), (None, None, None)) == "no number"


def test_the_demonstration_answers_all_and_differs_with_a_reason() -> None:
    kept = {(r["where"], r["what"]): r for r in json.loads(RESULTS.read_text(encoding="utf-8"))}
    assert kept.keys() == {(s.where, s.what) for s in STATEMENTS}
    for s in STATEMENTS:
        row = kept[s.where, s.what]
        assert row["verdict"] == judge(s, (row["value"], row["lower"], row["upper"])), s.what
        assert row["verdict"] != "missing", s.what
        assert row["verdict"] != "differs" or s.why, s.what
    lines = table().splitlines()
    assert len(lines) == len(STATEMENTS) + 4
    assert all(line.count("|") == 8 for line in lines[2:])
