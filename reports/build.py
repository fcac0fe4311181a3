"""The static site of a lab, from LAB/results.duckdb alone.

A page is made again only when its rows, the code that makes pages or the links it depends on have changed. The same
database gives the same bytes: no clock, no random names, no order left to chance. What is known of each page lies in a
ledger on disk: memory does not grow with the number of recordings.
"""

from __future__ import annotations

import functools
import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, as_completed, wait
from dataclasses import dataclass, field
from pathlib import Path

from reports import manifest
from reports.blocks import Link, Page, flow, name
from reports.digests import digests
from reports.figures.drawn import drawn_before
from reports.ledger import Ledger, batches
from reports.names import short
from reports.plan import Planned, further_paths, make, plan
from reports.render import html
from reports.results import DATABASE, MEMORY, Results, short_of_memory
from reports.site import INDEX, Site
from schemas.errors import LabError, describe_error

_PAGES_AT_ONCE = 200
"""Pages that a worker makes for one task, at most."""
_TASKS_EACH = 8
"""Tasks that the pages make for every worker, so that all end at about the same time."""
_FEWEST = 50
"""Pages below which workers are not worth their start."""

_OF_A_PAGE = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError)
"""What goes wrong in the making of one page, not with the lab, its disk or the memory."""

Made = tuple[str, list[str], str]
"""The address of a page that was written, its data files, and what went wrong in making it; empty for nothing."""


@dataclass(frozen=True)
class ReportResult:
    """What a build did.

    Parameters
    ----------
    pages_written, pages_unchanged : numbers of pages made anew and left as they were
    index : path of the first page
    seconds : time it took, s
    problems : address → why, of pages that say only that they could not be made; they are tried again by the next build
    """

    pages_written: int
    pages_unchanged: int
    index: Path
    seconds: float
    problems: Mapping[str, str] = field(default_factory=dict)

    def describe_problems(self) -> str | None:
        """The pages that could not be made, in a sentence; None where there are none."""
        if not self.problems:
            return None
        (first, why), *_ = self.problems.items()
        others = f", and {len(self.problems) - 1} other pages" if len(self.problems) > 1 else ""
        return f"{first}: {why}{others}; every other page is written"


def build_reports(
    lab: Path,
    *,
    force: bool = False,
    interactive: bool | None = None,
    workers: Callable[[], Executor] | None = None,
    jobs: int = 1,
) -> ReportResult:
    """Writes LAB/reports; `force` makes every page anew. Raises `LabError` without a readable database or folder.

    `interactive`: with a script or without; None leaves it as the pages are that are there, none at first. `workers`
    opens an executor with `jobs` workers, which many pages are shared among.
    """
    if interactive is None:
        interactive = manifest.interactive(lab / "reports")
    start = time.perf_counter()
    for memory in MEMORY:
        try:
            written, unchanged, problems = _build(lab, memory, force, interactive, workers if jobs > 1 else None, jobs)
            break
        except Exception as error:
            if memory == MEMORY[-1] or not short_of_memory(error):
                raise
    return ReportResult(written, unchanged, lab / "reports" / INDEX, time.perf_counter() - start, problems)


def _build(
    lab: Path, memory: str, force: bool, interactive: bool, workers: Callable[[], Executor] | None, jobs: int
) -> tuple[int, int, dict[str, str]]:
    """Numbers of pages that were written and left alone, and what went wrong with which."""
    problems: dict[str, str] = {}
    folder = lab / "reports"
    with Results(lab, memory) as results:
        ledger, site = results.ledger, Site(results, interactive=interactive)
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
                _note(ledger, problems, (_write(folder, site, one, force) for one in waiting))
            else:
                _note(ledger, problems, [_write(folder, site, next(waiting), force)])
                _note(ledger, problems, _shared(lab, memory, interactive, force, waiting, stale - 1, workers, jobs))
            manifest.remove_stale(folder, ledger)
            if stale or ledger.number("SELECT count(*) FROM known") != count:
                manifest.write(folder, ledger, script=interactive)
        except OSError as error:
            raise LabError(f"the report cannot be written: {error}", where=str(folder)) from error
    return stale, count - stale, problems


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


def _note(ledger: Ledger, problems: dict[str, str], made: Iterable[Made]) -> None:
    """Data files of pages to the ledger, what went wrong to the problems; such a page is made again by the next build."""

    def note() -> Iterator[tuple[str, str]]:
        for page, files, problem in made:
            if problem:
                problems[page] = problem
            yield from ((page, path) for path in files)

    ledger.add("data", note())
    for page in problems:
        ledger.run("UPDATE pages SET digest = '' WHERE path = ?", (page,))


def _shared(
    lab: Path,
    memory: str,
    interactive: bool,
    force: bool,
    waiting: Iterator[Planned],
    count: int,
    workers: Callable[[], Executor],
    jobs: int,
) -> Iterator[Made]:
    """Pages written by workers, neighbours by the same one; as many tasks wait as keep the workers busy.

    Whatever is ready first makes room for the next: pages of campaigns and specimens come first and take much longer than others, and
    no worker waits for another one's.
    """
    state = (lab / DATABASE).stat()
    with workers() as executor:
        tasks: set[Future[list[Made]]] = set()
        for some in batches(waiting, min(_PAGES_AT_ONCE, -(-count // (_TASKS_EACH * jobs)))):
            tasks.add(
                executor.submit(write_pages, lab, memory, interactive, force, (state.st_ino, state.st_mtime_ns), some)
            )
            if len(tasks) > 2 * jobs:
                done, tasks = wait(tasks, return_when=FIRST_COMPLETED)
                yield from itertools.chain.from_iterable(task.result() for task in done)
        for task in as_completed(tasks):
            yield from task.result()


def write_pages(
    lab: Path, memory: str, interactive: bool, force: bool, state: tuple[int, int], pages: list[Planned]
) -> list[Made]:
    """Writes some pages of a lab whose database is in this `state`; a worker that is asked again knows the site already."""
    site = _known_site(lab, memory, interactive, state)
    return [_write(lab / "reports", site, one, force) for one in pages]


@functools.lru_cache(maxsize=1)
def _known_site(lab: Path, memory: str, interactive: bool, state: tuple[int, int]) -> Site:
    return Site(Results(lab, memory), interactive=interactive)


def _write(folder: Path, site: Site, planned: Planned, force: bool) -> Made:
    """Makes a page; figures that it had already from the same data are taken over, unless `force`."""
    problem = ""
    try:
        before = () if force else tuple(folder / path for path in (planned.path, *further_paths(site, planned)))
        with drawn_before(*before, with_values=site.interactive):
            page = make(site, planned)
        entries = site.entries() if site.interactive and planned.kind == "index" else ()
        text = html(page, interactive=site.interactive, site=entries)
        further = {path: html(one, interactive=site.interactive) for path, one in page.further}
        files = page.files | further
    except _OF_A_PAGE as error:
        if short_of_memory(error):
            raise
        problem = describe_error(error)
        page = _apologise(planned, problem)
        text, files = html(page), page.files
    for path, data in files.items():
        manifest.write_text(folder / path, data)
    manifest.write_text(folder / planned.path, text)
    return planned.path, list(files), problem


def _apologise(planned: Planned, problem: str) -> Page:
    """The page in place of one that could not be made."""
    up = "../" * planned.path.count("/")
    words = (
        f"An error of dealab's own, not of the recordings: {problem}. All results of this page stand in the database (`dealab sql"
        " --examples` shows how to ask it). Please report the error with this sentence."
    )
    subject = planned.item or planned.kind
    return Page(
        title=f"{short(subject, 40)}: could not be made",
        heading=flow(name(subject), ": this page could not be made"),
        bar=(Link("Last night", f"{up}{INDEX}"),),
        lede=words,
        sections=(),
    )
