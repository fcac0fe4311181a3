"""The labs whose reports the tests look at, and the browser they look with."""

from __future__ import annotations

import typing
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from reports import build
from reports.plan import Planned
from reports.results import Query, Results
from schemas.tables.table import Page
from tests.helpers import chromium, synthetic_lab


@dataclass(frozen=True)
class Built:
    """A lab with its report, and the SQL that each kind of page asked for it."""

    lab: Path
    asked: Mapping[str, set[str]]


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """A lab with findings of every kind, its report built."""
    folder = synthetic_lab.whole_story().write(tmp_path_factory.mktemp("whole") / "lab")
    asked: dict[str, set[str]] = defaultdict(set)
    now: list[str] = []

    def noting(method: Callable[..., Any], spell: Callable[[Any], str]) -> Callable[..., Any]:
        def ask(self: Results, what: Any, *more: Any) -> Any:
            for page in now:
                asked[page].add(spell(what))
            return method(self, what, *more)

        return ask

    def make(site: Any, planned: Planned) -> Any:
        now[:] = [planned.kind if planned.kind in typing.get_args(Page) else "index"]
        page = usual(site, planned)
        now.clear()
        return page

    usual = build.make
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "make", make)
        for name in ("rows", "columns", "each"):
            patch.setattr(Results, name, noting(getattr(Results, name), lambda q: q.sql if isinstance(q, Query) else q))
        patch.setattr(Results, "has", noting(Results.has, lambda table: f"FROM {table}"))
        build.build_reports(folder)
    return Built(folder, asked)


@pytest.fixture(scope="session")
def lab(built: Built) -> Path:
    """The lab."""
    return built.lab


@pytest.fixture(scope="session")
def site(lab: Path) -> Path:
    """The report of that lab."""
    return lab / "reports"


@pytest.fixture(scope="session")
def browser() -> Iterator[chromium.Chromium]:
    """A running Chromium; the test is skipped where there is none and none can be installed."""
    binary, reason = chromium.find()
    if binary is None:
        pytest.skip(reason)
    with chromium.running(binary) as found:
        yield found
