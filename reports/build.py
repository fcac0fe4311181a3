"""The static site of a lab, from LAB/results.duckdb alone.

A page is made again only when its rows, the code that makes pages or the links it depends on have changed. The same
database gives the same bytes: no clock, no random names, no order left to chance.
"""

from __future__ import annotations

import functools
import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from reports import manifest
from reports.blocks import Page
from reports.manifest import Entry
from reports.pages import campaign, control, index, lists, recording, specimen
from reports.render import html
from reports.results import Digests, Query, Results
from reports.site import CONTROL, INDEX, Site
from schemas.errors import LabError

_PAGES_AT_ONCE = 200
"""Pages that a worker makes for one task, at most."""
_FEWEST = 50
"""Pages below which workers are not worth their start."""


@dataclass(frozen=True)
class ReportResult:
    """What a build did: pages made anew and left as they were, the index, the time it took in s."""

    pages_written: int
    pages_unchanged: int
    index: Path
    seconds: float


@dataclass(frozen=True)
class _Plan:
    """A page to be: its address, the digest of what it is made from, how to make it."""

    path: str
    digest: str
    make: Callable[[], Page]


def build_reports(
    lab: Path, *, force: bool = False, workers: Callable[[], Executor] | None = None, jobs: int = 1
) -> ReportResult:
    """Writes LAB/reports; `force` makes every page anew. Raises `LabError` without a readable database or folder.

    `workers` opens an executor with `jobs` workers, which many pages are shared among.
    """
    start = time.perf_counter()
    folder = lab / "reports"
    with Results(lab) as results:
        site = Site(results)
        plans = list(_plans(site, results.digests()))
        before = {} if force else manifest.read(folder)
        there = manifest.present(folder)
        after: dict[str, Entry] = {}
        stale = []
        for plan in plans:
            known = before.get(plan.path)
            if known is not None and known.digest == plan.digest and there.issuperset((plan.path, *known.files)):
                after[plan.path] = known
            else:
                stale.append(plan)
        try:
            if workers is None or jobs < 2 or len(stale) < _FEWEST:
                after.update((plan.path, _write(folder, plan)) for plan in stale)
            else:
                after.update(_shared(lab, stale, workers, jobs))
            manifest.remove_stale(folder, there, {*after, *(f for e in after.values() for f in e.files)})
            manifest.write(folder, after)
        except OSError as error:
            raise LabError(f"the report cannot be written: {error}", where=str(folder)) from error
    return ReportResult(len(stale), len(plans) - len(stale), folder / INDEX, time.perf_counter() - start)


def _shared(lab: Path, stale: Sequence[_Plan], workers: Callable[[], Executor], jobs: int) -> list[tuple[str, Entry]]:
    """Pages written by workers. Which they are is told by their addresses: a page itself holds on to the database."""
    first, *others = stale
    made = [(first.path, _write(lab / "reports", first))]
    parts = max(2 * jobs, -(-len(others) // _PAGES_AT_ONCE))
    state = (lab / "results.duckdb").stat()
    with workers() as executor:
        tasks = [
            executor.submit(write_pages, lab, (state.st_ino, state.st_mtime_ns), [p.path for p in others[part::parts]])
            for part in range(parts)
        ]
        for task in tasks:
            made += task.result()
    return made


def write_pages(lab: Path, state: tuple[int, int], addresses: Sequence[str]) -> list[tuple[str, Entry]]:
    """Writes some pages of a lab whose database is in this `state`; a worker that is asked again knows the site already."""
    plans = _known_plans(lab, state)
    return [(address, _write(lab / "reports", plans[address])) for address in addresses]


@functools.lru_cache(maxsize=1)
def _known_plans(lab: Path, state: tuple[int, int]) -> dict[str, _Plan]:
    results = Results(lab)
    return {plan.path: plan for plan in _plans(Site(results), results.digests())}


def _write(folder: Path, plan: _Plan) -> Entry:
    page = plan.make()
    text = html(page)
    for path, data in page.files.items():
        manifest.write_text(folder / path, data)
    manifest.write_text(folder / plan.path, text)
    return Entry(plan.digest, tuple(sorted(page.files)))


def _plans(site: Site, digests: Digests) -> Iterator[_Plan]:
    """All pages of the site, the index first so that it is the first to be there."""

    def digest(*parts: str) -> str:
        return hashlib.sha256("\n".join((manifest.code_digest(), site.shape, *parts)).encode()).hexdigest()

    yield _Plan(INDEX, digest(digests.everything), functools.partial(index.page, site))
    if site.controlled:
        last = site.last_run["run_id"] if site.last_run else ""
        yield _Plan(CONTROL, digest(digests.control, last), functools.partial(control.page, site))
    for listed, make in (
        (lists.recordings_parts(site) if site.recordings else [], lists.recordings),
        (lists.specimens_parts(site, digests.specimens), lists.specimens),
        (lists.refused_parts(site), lists.refused),
    ):
        all_parts = [part for part, _ in listed]
        for part, its_rows in listed:
            yield _Plan(part.address, digest(part.list, its_rows), functools.partial(make, site, part, all_parts))
    survival = "".join((*(value for _, value in sorted(digests.configurations.items())), digests.comparisons))
    for item in site.campaigns:
        rows = site.results.rows(
            Query(
                "SELECT DISTINCT specimen_id FROM (SELECT specimen_id, campaign FROM recordings"
                " UNION ALL SELECT specimen_id, campaign FROM lifetimes)"
                " WHERE campaign = $item AND specimen_id IS NOT NULL ORDER BY specimen_id",
                {"item": item},
            )
        )
        parts = [digests.specimens.get(r["specimen_id"], "") for r in rows]
        yield _Plan(
            site.campaign_path(item), digest(item, survival, *parts), functools.partial(campaign.page, site, item)
        )
    for item in site.specimens:
        yield _Plan(
            site.specimen_path(item),
            digest(item, digests.specimens.get(item, "")),
            functools.partial(specimen.page, site, item),
        )
    for item, row in site.recordings.items():
        parts = [digests.recordings.get(item, ""), str(site.has_specimen(row["specimen_id"]))]
        yield _Plan(site.recording_path(item), digest(item, *parts), functools.partial(recording.page, site, item))
