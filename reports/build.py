"""The static site of a lab, from LAB/results.duckdb alone.

A page is made again only when its rows, the code that makes pages or the links it depends on have changed. The same
database gives the same bytes: no clock, no random names, no order left to chance. What is known of each page lies in a
ledger on disk: memory does not grow with the number of recordings.
"""

from __future__ import annotations

import functools
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from pathlib import Path

from reports import manifest
from reports.digests import digests
from reports.ledger import Ledger, batches
from reports.plan import Planned, make, plan
from reports.render import html
from reports.results import DATABASE, MEMORY, Results, short_of_memory
from reports.site import INDEX, Site
from schemas.errors import LabError

_PAGES_AT_ONCE = 200
"""Pages that a worker makes for one task, at most."""
_FEWEST = 50
"""Pages below which workers are not worth their start."""

Made = tuple[str, list[str]]
"""The address of a page that was written, and its data files."""


@dataclass(frozen=True)
class ReportResult:
    """What a build did: pages made anew and left as they were, the index, the time it took in s."""

    pages_written: int
    pages_unchanged: int
    index: Path
    seconds: float


def build_reports(
    lab: Path, *, force: bool = False, workers: Callable[[], Executor] | None = None, jobs: int = 1
) -> ReportResult:
    """Writes LAB/reports; `force` makes every page anew. Raises `LabError` without a readable database or folder.

    `workers` opens an executor with `jobs` workers, which many pages are shared among.
    """
    start = time.perf_counter()
    for memory in MEMORY:
        try:
            written, unchanged = _build(lab, memory, force, workers if jobs > 1 else None, jobs)
            break
        except Exception as error:
            if memory == MEMORY[-1] or not short_of_memory(error):
                raise
    return ReportResult(written, unchanged, lab / "reports" / INDEX, time.perf_counter() - start)


def _build(lab: Path, memory: str, force: bool, workers: Callable[[], Executor] | None, jobs: int) -> tuple[int, int]:
    """Numbers of pages that were written and left alone."""
    folder = lab / "reports"
    with Results(lab, memory) as results:
        ledger, site = results.ledger, Site(results)
        pages = plan(site, digests(results))
        ledger.add("pages", ((None, one.path, one.kind, one.item, digest) for one, digest in pages))
        try:
            if not force:
                manifest.read(folder, ledger)
            manifest.look(folder, ledger)
            _find_stale(ledger)
            count, stale = (ledger.number(f"SELECT count(*) FROM {table}") for table in ("pages", "stale"))
            waiting = (Planned(*row) for row in ledger.each(_STALE))
            if workers is None or stale < _FEWEST:
                _note(ledger, (_write(folder, site, one) for one in waiting))
            else:
                _note(ledger, [_write(folder, site, next(waiting))])
                _note(ledger, _shared(lab, memory, waiting, stale - 1, workers, jobs))
            manifest.remove_stale(folder, ledger)
            if stale or ledger.number("SELECT count(*) FROM known") != count:
                manifest.write(folder, ledger)
        except OSError as error:
            raise LabError(f"the report cannot be written: {error}", where=str(folder)) from error
    return stale, count - stale


_STALE = "SELECT path, kind, item FROM pages JOIN stale USING (place) ORDER BY place"


def _find_stale(ledger: Ledger) -> None:
    """Which pages are to be made: new, from other rows than before, or without one of their files. Keeps the others' data files."""
    ledger.run(
        "INSERT INTO stale SELECT p.place FROM pages AS p LEFT JOIN known AS k ON k.path = p.path AND k.digest = p.digest"
        " WHERE k.path IS NULL OR p.path NOT IN (SELECT path FROM found)"
        " OR EXISTS (SELECT 1 FROM data AS d WHERE d.page = p.path AND d.path NOT IN (SELECT path FROM found))"
    )
    ledger.run(
        "DELETE FROM data WHERE page NOT IN (SELECT path FROM pages WHERE place NOT IN (SELECT place FROM stale))"
    )


def _note(ledger: Ledger, made: Iterable[Made]) -> None:
    ledger.add("data", ((page, path) for page, files in made for path in files))


def _shared(
    lab: Path,
    memory: str,
    waiting: Iterator[Planned],
    count: int,
    workers: Callable[[], Executor],
    jobs: int,
) -> Iterator[Made]:
    """Pages written by workers, neighbours by the same one; as many tasks wait as keep the workers busy."""
    state = (lab / DATABASE).stat()
    with workers() as executor:
        tasks: deque[Future[list[Made]]] = deque()
        for some in batches(waiting, min(_PAGES_AT_ONCE, -(-count // (2 * jobs)))):
            if len(tasks) > 2 * jobs:
                yield from tasks.popleft().result()
            tasks.append(executor.submit(write_pages, lab, memory, (state.st_ino, state.st_mtime_ns), some))
        for task in tasks:
            yield from task.result()


def write_pages(lab: Path, memory: str, state: tuple[int, int], pages: list[Planned]) -> list[Made]:
    """Writes some pages of a lab whose database is in this `state`; a worker that is asked again knows the site already."""
    site = _known_site(lab, memory, state)
    return [_write(lab / "reports", site, one) for one in pages]


@functools.lru_cache(maxsize=1)
def _known_site(lab: Path, memory: str, state: tuple[int, int]) -> Site:
    return Site(Results(lab, memory))


def _write(folder: Path, site: Site, planned: Planned) -> Made:
    page = make(site, planned)
    text = html(page)
    for path, data in page.files.items():
        manifest.write_text(folder / path, data)
    manifest.write_text(folder / planned.path, text)
    return planned.path, list(page.files)
