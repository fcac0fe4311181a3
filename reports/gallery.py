"""Every figure that the pages show of a specimen, a recording, a campaign or the lab, to be had as a file.

The pages decide what there is to show and gather its data; here their figures are found, with the finding that is their alt
text and the data that stand beside them.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from reports.blocks import Block, Figure, Findings, Fold, Many, Page, Pair
from reports.figures.picture import Picture
from reports.names import short
from reports.pages.campaign import page as campaign
from reports.pages.index import control
from reports.pages.recording import page as recording
from reports.pages.specimen import page as specimen
from reports.site import Site
from schemas.errors import UsageError

LAB = "lab"
"""The word for what belongs to no single thing: control charts."""
PRINTED = (
    "response", "spectrum", "correction", "amplification", "force-under-voltage", "blocked-force", "orders", "distortion",
    "voltage-squared", "slow-voltage", "step-response", "isotonic", "sensing", "force-map", "relaxation", "error-by-arms", "parameter-study", "cycle",
    "cycle-residual", "creep", "tension", "by-amplitude", "compliance", "master-curve", "shifts", "phase-over-magnitude",
    "misfits", "open-and-closed-loop", "gains", "controllers", "agreement", "constraint", "sensitivity-map", "coats", "migration",
    "force-stroke", "diagnosis", "residual-map", "held-out", "survival", "lifetimes", "against-voltage", "against-stress",
    "effects", "intervals", "cox-snell", "deviances", "incidence", "regions", "thickness-map", "control", "timeline",
)  # fmt: skip
"""Kinds of figures that can be had as files, in the order in which they are listed."""


@dataclass(frozen=True)
class Exhibit:
    """A figure of a page.

    Parameters
    ----------
    name : its kind; from the second of a kind on with a number
    about : what it shows, in a few words
    picture : what it is drawn from
    files : the data beside it: file name → CSV text
    """

    name: str
    about: str
    picture: Picture
    files: Mapping[str, str]

    @property
    def finding(self) -> str:
        """What it shows, in a sentence: the alt text."""
        return html.unescape(self.picture.finding)


def find_exhibits(site: Site, thing: str) -> list[Exhibit]:
    """The figures of a specimen, a recording, a campaign, or `lab`; those of one kind in the order of the page.

    Raises `UsageError` where nothing of that name has a page.
    """
    makers: list[tuple[bool, Callable[[], Page]]] = [
        (site.has_specimen(thing), lambda: specimen.page(site, thing)),
        (site.has_recording(thing), lambda: recording.page(site, thing)),
        (thing in site.campaigns, lambda: campaign.page(site, thing)),
        (thing == LAB, lambda: control.page(site)),
    ]
    pages = [make() for there, make in makers if there]
    if not pages:
        raise UsageError(
            f'nothing is called "{short(thing, 80)}" in this lab',
            expected=f"the id of a specimen, a recording or a campaign that is in it, or `{LAB}` for its control charts",
        )
    counts: dict[str, int] = {}
    found = []
    for page in pages:
        for figure in (f for part in (page, *(further for _, further in page.further)) for f in _figures(part)):
            picture = figure.image
            if not isinstance(picture, Picture) or picture.kind not in PRINTED or picture.options.get("phase"):
                continue
            counts[picture.kind] = counts.get(picture.kind, 0) + 1
            number = counts[picture.kind]
            addresses = (figure.data,) if isinstance(figure.data, str) else figure.data
            files = {a.rpartition("/")[2]: page.files[p] for a in addresses if (p := _find_file(page, a)) is not None}
            name = picture.kind if number == 1 else f"{picture.kind}-{number}"
            found.append(Exhibit(name, _begin(figure), picture, files))
    return sorted(found, key=lambda e: PRINTED.index(e.picture.kind))


def choose_exhibit(exhibits: Sequence[Exhibit], thing: str, kind: str) -> Exhibit:
    """The figure of that name; `UsageError` says which there are."""
    for exhibit in exhibits:
        if exhibit.name == kind:
            return exhibit
    names = ", ".join(e.name for e in exhibits)
    raise UsageError(
        f'there is no figure "{short(kind, 40)}" of {short(thing, 80)}',
        expected=f"one of {names}" if names else "a specimen, recording or campaign with figures: this one has none",
    )


def _find_file(page: Page, address: str) -> str | None:
    return next((path for path in page.files if address.endswith(path)), None)


def _begin(figure: Figure) -> str:
    """The beginning of the caption, which says what is shown."""
    text = str(figure.caption)
    begin = text[text.find("<b>") + 3 : text.find("</b>")] if "<b>" in text and "</b>" in text else text
    return html.unescape(begin).rstrip(".")


def _figures(page: Page) -> Iterator[Figure]:
    for block in page.opening:
        yield from _inside(block)
    for section in page.sections:
        for block in section.blocks:
            yield from _inside(block)


def _inside(block: Block | Fold) -> Iterator[Figure]:
    if isinstance(block, Figure):
        yield block
    elif isinstance(block, (Pair, Many)):
        yield from block.figures
    elif isinstance(block, Findings):
        yield from (item.figure for item in block.items if item.figure is not None)
    elif isinstance(block, Fold):
        for inner in block.blocks:
            yield from _inside(inner)
