"""Which pages the site has, the digest of what each is made from, and how each is made."""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from reports import manifest
from reports.blocks import Page
from reports.digests import Digests
from reports.pages.index import lists
from reports.site import CONTROL, INDEX, Site


@dataclass(frozen=True)
class Planned:
    """A page to be, told by its address, its kind (of a list: the address that it begins with) and what it is about (the part's number)."""

    path: str
    kind: str
    item: str


def _made_by(module: str) -> Callable[..., Page]:
    """`page` of a module, which is imported with the first page of its kind."""

    def page(*of: Site | str) -> Page:
        made: Page = importlib.import_module(module).page(*of)
        return made

    return page


_ALONE: dict[str, Callable[[Site], Page]] = {
    "index": _made_by("reports.pages.index.page"),
    "control": _made_by("reports.pages.index.control"),
}
_ABOUT: dict[str, Callable[[Site, str], Page]] = {
    "campaign": _made_by("reports.pages.campaign.page"),
    "specimen": _made_by("reports.pages.specimen.page"),
    "recording": _made_by("reports.pages.recording.page"),
}


def make(site: Site, planned: Planned) -> Page:
    """The page."""
    if planned.kind in _ALONE:
        return _ALONE[planned.kind](site)
    if planned.kind in _ABOUT:
        return _ABOUT[planned.kind](site, planned.item)
    return lists.page(site, planned.kind, int(planned.item))


def further_paths(site: Site, planned: Planned) -> tuple[str, ...]:
    """Addresses of pages that are made with this one where it would be too long."""
    return site.parts_of(planned.item) if planned.kind == "campaign" else ()


def plan(site: Site, digests: Digests) -> Iterator[tuple[Planned, str]]:
    """All pages of the site with their digests, the index first so that it is the first to be there."""

    def digest(*parts: str) -> str:
        return hashlib.sha256("\n".join((shared, *parts)).encode()).hexdigest()

    shared = f"{manifest.code_digest()}\n{site.shape}"
    yield Planned(INDEX, "index", ""), digest(digests.everything)
    if site.controlled:
        last = site.last_run["run_id"] if site.last_run else ""
        yield Planned(CONTROL, "control", ""), digest(digests.control, last)
    for parts in (lists.recordings_digests(site), lists.specimens_digests(site), lists.refused_digests(site)):
        for part, rows in parts:
            yield Planned(part.address, part.list, str(part.number)), digest(part.list, rows)
    for item in site.campaigns:
        rows = digests.of("campaign", item)
        yield Planned(site.campaign_path(item), "campaign", item), digest(item, digests.groups, rows)
    for item, rows in site.ledger.each(
        "SELECT s.specimen_id, ifnull(d.digest, '') FROM specimens AS s"
        " LEFT JOIN digests AS d ON d.kind = 'specimen' AND d.item = s.specimen_id ORDER BY s.specimen_id"
    ):
        yield Planned(site.specimen_path(item), "specimen", item), digest(item, rows)
    for item, rows, linked in site.ledger.each(
        "SELECT r.recording_id, ifnull(d.digest, ''), s.specimen_id IS NOT NULL FROM recordings AS r"
        " LEFT JOIN digests AS d ON d.kind = 'recording' AND d.item = r.recording_id"
        " LEFT JOIN specimens AS s ON s.specimen_id = r.specimen_id ORDER BY r.recording_id"
    ):
        yield Planned(site.recording_path(item), "recording", item), digest(item, rows, str(linked))
