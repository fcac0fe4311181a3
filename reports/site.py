"""Which pages there are, how they link to each other, and what every page shares.

A page exists for every recording that was used at least in part or taken out by somebody, for every specimen that has
one, and for every campaign. Refused files have no page of their own: they stand in the lists with their reason.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from reports.blocks import Fold, Link, Piece, Pre, Text, code, link, name, separated
from reports.names import FileNames, Verbatim, short
from reports.results import Results, Row, day, moment

USED_SQL = "status IN ('ok', 'damaged', 'excluded')"
INDEX = "index.html"
RECORDINGS = "recordings.html"
SPECIMENS = "specimens.html"
REFUSED = "refused.html"
CONTROL = "control.html"
PARTS = ("failures", "forces", "checks")
"""Parts of a campaign with pages of their own, by their folder: what lives depend on and where films fail, force and sensing, and the
publication that the campaign follows against its own numbers and ours."""
_ENTRIES = 5000
"""Specimens, and recordings, that a search in the whole site finds; beyond, the lists have their own."""


class Site:
    """All pages of a lab's report, by what they are about.

    Which recordings and specimens have one stands in the ledger; `recordings` and `specimens` are their numbers.
    `interactive`: the pages carry the script.
    """

    def __init__(self, results: Results, *, interactive: bool = False) -> None:
        self.results, self.ledger = results, results.ledger
        self.interactive = interactive
        used = results.each(
            "SELECT recording_id, min(specimen_id) AS specimen_id, min(kind) AS kind"
            f" FROM recordings WHERE {USED_SQL} AND recording_id IS NOT NULL GROUP BY ALL ORDER BY recording_id"
        )
        self.ledger.add("recordings", (tuple(row.values()) for row in used))
        self.ledger.run(
            "INSERT INTO specimens SELECT DISTINCT specimen_id FROM recordings"
            " WHERE specimen_id <> '' AND kind IS NOT 'lifetimes' ORDER BY specimen_id"
        )
        campaigns = results.rows(
            f"SELECT DISTINCT campaign FROM (SELECT campaign FROM recordings WHERE {USED_SQL}"
            " UNION ALL SELECT campaign FROM lifetimes) WHERE campaign <> '' ORDER BY campaign"
        )
        self.campaigns = [r["campaign"] for r in campaigns]
        self.recordings = self.ledger.number("SELECT count(*) FROM recordings")
        self.specimens = self.ledger.number("SELECT count(*) FROM specimens")
        self._recording_file = FileNames(self._alike("recordings", "recording_id"))
        self._specimen_file = FileNames(self._alike("specimens", "specimen_id"))
        self._campaign_file = FileNames(self.campaigns)
        self.runs = results.rows("SELECT * FROM runs ORDER BY run_id")
        self._runs_by_id = {r["run_id"]: r for r in self.runs}

    def _alike(self, table: str, column: str) -> list[str]:
        """Names that differ in nothing but case."""
        twice = f"SELECT casefold({column}) FROM {table} GROUP BY 1 HAVING count(*) > 1"
        if self.ledger.row(twice) is None:
            return []
        return [n for (n,) in self.ledger.each(f"SELECT {column} FROM {table} WHERE casefold({column}) IN ({twice})")]

    @functools.cached_property
    def controlled(self) -> bool:
        """Some control chart has enough points for limits."""
        found = self.results.rows("SELECT 1 AS one FROM control_points WHERE upper IS NOT NULL LIMIT 1")
        return bool(found)

    def has_recording(self, recording_id: str | None) -> bool:
        """There is a page about that recording."""
        return self.ledger.row("SELECT 1 FROM recordings WHERE recording_id = ?", (recording_id,)) is not None

    def has_specimen(self, specimen_id: str | None) -> bool:
        """There is a page about that specimen."""
        return self.ledger.row("SELECT 1 FROM specimens WHERE specimen_id = ?", (specimen_id,)) is not None

    @property
    def last_run(self) -> Row | None:
        return self.runs[-1] if self.runs else None

    def run(self, run_id: str | None) -> Row | None:
        """The run of that id, where it is still known."""
        return self._runs_by_id.get(run_id) if run_id else None

    def recording_path(self, recording_id: str) -> str:
        return f"recordings/{self._recording_file(recording_id)}.html"

    def specimen_path(self, specimen_id: str) -> str:
        return f"specimens/{self._specimen_file(specimen_id)}.html"

    def campaign_path(self, campaign: str) -> str:
        return f"campaigns/{self._campaign_file(campaign)}.html"

    def part_path(self, campaign: str, part: str) -> str:
        """The page of a part of a campaign (`PARTS`) that would make its own page too long."""
        return f"{part}/{self._campaign_file(campaign)}.html"

    def parts_of(self, campaign: str) -> tuple[str, ...]:
        """Addresses that parts of a campaign may have."""
        return tuple(self.part_path(campaign, part) for part in PARTS)

    def data_path(self, kind: str, item: str, figure: str) -> str:
        """Address of the CSV file of a figure."""
        if kind == "lab":
            return f"data/{figure}.csv"
        files = {"specimen": self._specimen_file, "campaign": self._campaign_file, "recording": self._recording_file}
        return f"data/{kind}s/{files[kind](item)}_{figure}.csv"

    def entries(self) -> list[tuple[str, str]]:
        """What a search in the whole site finds: names of campaigns, specimens and the first recordings, with addresses."""
        found = [(f"Campaign {short(c)}", self.campaign_path(c)) for c in self.campaigns]
        for table, column, path in (
            ("specimens", "specimen_id", self.specimen_path),
            ("recordings", "recording_id", self.recording_path),
        ):
            names = self.ledger.each(f"SELECT {column} FROM {table} ORDER BY {column} LIMIT {_ENTRIES}")
            found += [(short(name), path(name)) for (name,) in names]
        return found

    def recording(self, recording_id: str | None, root: str = "../", text: Piece | None = None) -> Piece:
        """A recording's name, linked where it has a page."""
        if not recording_id:
            return name(None)
        target = root + self.recording_path(recording_id) if self.has_recording(recording_id) else ""
        return link(text or name(recording_id, 60), target)

    def specimen(self, specimen_id: str | None, root: str = "../") -> Piece:
        """A specimen's name, linked where it has a page."""
        if not specimen_id:
            return name(None)
        return link(name(specimen_id), root + self.specimen_path(specimen_id) if self.has_specimen(specimen_id) else "")

    def campaign(self, campaign: str | None, root: str = "../") -> Piece:
        """A campaign's name, linked."""
        if not campaign:
            return name(None)
        return link(name(campaign), root + self.campaign_path(campaign))

    def bar(self, root: str, current: str = "") -> tuple[Link, ...]:
        """The bar of every page; `current` is the address of a list or the name of the page itself."""
        entries = [("Last night", INDEX)]
        if self.specimens:
            entries.append(("Specimens", SPECIMENS))
        if self.recordings:
            entries.append(("Recordings", RECORDINGS))
        if self.controlled:
            entries.append(("Control charts", CONTROL))
        links = [Link(text, root + address, current=address == current) for text, address in entries]
        if current and current not in {address for _, address in entries}:
            links.append(Link(current))
        return tuple(links)

    def provenance(self, run_id: str | None) -> tuple[Text | Fold, ...]:
        """Version, code, run and settings that made what a page shows."""
        run = self.run(run_id) or self.last_run
        if run is None:
            return (Text("No run is recorded in the database."),)
        parts: list[Piece] = [Markup("dealab {}").format(run["software_version"] or "of unknown version")]
        if run["code_version"]:
            parts.append(Markup("code {}").format(_code_version(run["code_version"])))
        parts.append(Markup("run {} of {}").format(code(run["run_id"]), moment(run["started_at"])))
        settings = pretty(run["settings"])
        blocks: list[Text | Fold] = [Text(separated(parts))]
        if settings:
            blocks.append(Fold("Settings in use", (Pre(Verbatim(settings)),)))
        return tuple(blocks)

    def when(self, run_id: str | None) -> str:
        """Day of the results of a page."""
        run = self.run(run_id)
        return f"Results of {day(run['started_at'])}" if run and run["started_at"] else ""

    @functools.cached_property
    def shape(self) -> str:
        """What links and file names depend on beyond a page's own rows."""
        crowded = [self._recording_file, self._specimen_file, self._campaign_file]
        return json.dumps(
            [sorted(f.crowded) for f in crowded]
            + [bool(self.specimens), bool(self.recordings), self.controlled, self.interactive]
        )


def _code_version(text: str) -> Piece:
    """A hash, or one for each stage, shortened."""
    try:
        stages = json.loads(text)
    except ValueError:
        stages = text
    if not isinstance(stages, dict):
        return code(text[:12])
    return Markup(", ").join(
        Markup("{} {}").format(stage, code(str(value)[:8])) for stage, value in sorted(stages.items())
    )


def pretty(text: str | None) -> str:
    """JSON with one key a line; other text as it is; nothing for an empty object."""
    if not text:
        return ""
    try:
        found = json.loads(text)
    except ValueError:
        return text
    return json.dumps(found, indent=2, ensure_ascii=False) if found else ""


def flat_metadata(text: str | None) -> dict[str, Any]:
    """The metadata of a recording as one dictionary; keys of the rig begin with `rig.` where they were nested."""
    try:
        found = json.loads(text) if text else {}
    except ValueError:
        return {}
    flat: dict[str, Any] = {}
    for key, value in (found if isinstance(found, Mapping) else {}).items():
        if isinstance(value, Mapping):
            prefix = "" if key == "recording" else f"{key}."
            flat.update({prefix + str(k): v for k, v in value.items()})
        else:
            flat[str(key)] = value
    return flat


def stated_rig(recordings: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Constants of the rig that a specimen's recordings state: of the last mechanical one, else of the last."""
    if not recordings:
        return {}
    mechanical = [r for r in recordings if r["loading"] == "mechanical"]
    metadata = flat_metadata((mechanical or list(recordings))[-1]["metadata"])
    return {k.removeprefix("rig."): v for k, v in metadata.items()}
