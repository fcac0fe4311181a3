"""What tables say of the pages that show them, against what the pages ask for."""

from __future__ import annotations

import re
import typing
from pathlib import Path

import pytest

from pipeline.nightly.freshness import find_sources
from schemas.tables import TABLES
from schemas.tables.table import Page
from schemas.views import VIEWS
from tests.browser.conftest import Built

PAGES: tuple[str, ...] = typing.get_args(Page)
OF_NIGHTS = {"runs"}
"""Pages quote the run that made them; they are not made again for every run."""


def tables_in(words: set[str]) -> set[str]:
    """Tables among some names, those behind views included."""
    behind = [tables_in(asked_from(view.sql)) for view in VIEWS if view.name in words]
    return words & set(TABLES) | {table for tables in behind for table in tables}


def asked_from(sql: str) -> set[str]:
    return set(re.findall(r"\b(?:FROM|JOIN) (\w+)", sql))


def declared(page: str) -> set[str]:
    return {table.name for table in TABLES.values() if page in table.pages}


@pytest.fixture(scope="session")
def asked(built: Built) -> dict[str, set[str]]:
    """Tables that each kind of page asks for, of a lab with findings of many kinds."""
    return {page: {t for sql in built.asked[page] for t in tables_in(asked_from(sql))} for page in PAGES}


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_asks_for_says_so(page: str, asked: dict[str, set[str]]) -> None:
    assert asked[page], "the page was made"
    assert asked[page] - OF_NIGHTS <= declared(page)


@pytest.mark.parametrize("page", PAGES)
def test_what_says_so_is_asked_for(page: str) -> None:
    module = {"control": "reports.pages.index.control"}.get(page, f"reports.pages.{page}.page")
    sources: list[Path] = [path for path in find_sources([module]) if path.parts[-3:-1] != ("schemas", "tables")]
    named = {
        table for path in sources for table in tables_in(set(re.findall(r"\w+", path.read_text(encoding="utf-8"))))
    }
    assert declared(page) <= named
