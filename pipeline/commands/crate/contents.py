"""What of a lab is handed on: tables, models and figures, each as bytes that depend on the results alone.

No time of a night, no path of a machine and no name of a run is in them, so that the same recordings give the same
bytes wherever the night was run.
"""

from __future__ import annotations

import io
import json
import math
import posixpath
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

from pipeline.lab.lab import Lab
from reports.csvfile import write_cell
from reports.gallery import LAB as OF_LAB
from reports.gallery import Exhibit, find_exhibits
from reports.names import FileNames
from reports.results import Results
from reports.site import Site
from schemas.errors import DealabError
from schemas.tables import TABLES

TABLES_FOLDER, MODELS_FOLDER, FIGURES_FOLDER, REPORT_FOLDER = "tables", "models", "figures", "report"
_OF_THE_NIGHT = ("accidents", "carried", "files", "history", "items", "lab", "previews", "runs")
"""Tables about a night or for the pages only: what they hold is not a result."""
_OF_THE_MACHINE = ("run_id", "software_version", "samples_path", "source_present", "seconds")
_PATHS = ("source_path",)
"""Columns with paths: the name of the file is kept."""
_NAMING_FILES = ("problem", "notes", "reason")
"""Columns of words that may name another file of the lab, of which the name is kept, too."""


def write_results(lab: Lab, *, figures: bool = True) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of every table, model and figure of a lab, in a fixed order."""
    with Results(lab.folder) as results:
        yield from write_tables(results)
        yield from _write_models(lab, results)
        if figures:
            yield from write_figures(Site(results))


def write_tables(results: Results) -> Iterator[tuple[str, bytes]]:
    """Each table with rows as CSV in full precision; rows and columns in a fixed order."""
    places = (r["source_path"] for r in results.rows("SELECT DISTINCT source_path FROM recordings"))
    folders = sorted({f"{posixpath.dirname(place)}/" for place in places if place}, key=len, reverse=True)
    for name, table in sorted(TABLES.items()):
        columns = [c.name for c in table.columns if c.name not in _OF_THE_MACHINE]
        if name in _OF_THE_NIGHT or not columns:
            continue
        rows = [[_plain(row[c], c, folders) for c in columns] for row in results.rows(f"SELECT * FROM {name}")]
        if not rows:
            continue
        lines = sorted(",".join(write_cell(value) for value in row) for row in rows)
        yield f"{TABLES_FOLDER}/{name}.csv", ("\n".join((",".join(columns), *lines)) + "\n").encode()


def _plain(value: Any, column: str, folders: Sequence[str]) -> Any:
    """A value as a cell: numbers in full, times in ISO 8601, lists as JSON, a file's name for a path."""
    if column in _NAMING_FILES and isinstance(value, str):
        for folder in folders:
            value = value.replace(folder, "")
    if column in _PATHS and isinstance(value, str):
        return posixpath.basename(value.replace("\\", "/"))
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else None
    if isinstance(value, datetime):
        return value.isoformat()
    return json.dumps(value, ensure_ascii=False) if isinstance(value, (list, dict)) else value


def _write_models(lab: Lab, results: Results) -> Iterator[tuple[str, bytes]]:
    """Each film whose moduli are known as JSON: the Prony series that `dealab export --as json` gives."""
    from pipeline.commands.series import read_series
    from pipeline.transform.prony import write_deck

    specimens = [
        r["specimen_id"] for r in results.rows("SELECT DISTINCT specimen_id FROM best_models ORDER BY specimen_id")
    ]
    names = FileNames(specimens)
    for specimen in specimens:
        try:
            deck = write_deck(read_series(lab, specimen, None), "json")
        except DealabError:
            continue  # no modulus without geometry; its springs in N/mm are in the table of fits
        yield f"{MODELS_FOLDER}/{names(specimen)}.json", deck.encode()


def write_figures(site: Site) -> Iterator[tuple[str, bytes]]:
    """The first figure of each kind of every specimen and campaign, and the lab's control charts, as SVG."""
    from reports.figures.paper import write_figure

    specimens = [s for (s,) in site.ledger.each("SELECT specimen_id FROM specimens ORDER BY specimen_id")]
    things = [*specimens, *sorted(site.campaigns), *([OF_LAB] if site.controlled else [])]
    names = FileNames(things)
    for thing in things:
        for exhibit in _first_of_each(find_exhibits(site, thing), every=thing == OF_LAB):
            file = io.BytesIO()
            figure = exhibit.picture.draw()
            write_figure(figure, file, "svg", title=f"{thing}: {exhibit.about}", finding=exhibit.finding)
            yield f"{FIGURES_FOLDER}/{names(thing)}/{exhibit.name}.svg", file.getvalue()


def _first_of_each(exhibits: list[Exhibit], *, every: bool) -> list[Exhibit]:
    return [e for e in exhibits if every or e.name == e.picture.kind]


def write_report(lab: Lab) -> Iterator[tuple[str, bytes]]:
    """The pages as they are in the lab; they bear the time of their night."""
    for path in sorted(lab.reports.rglob("*")):
        if path.is_file() and not path.name.startswith("."):
            yield f"{REPORT_FOLDER}/{path.relative_to(lab.reports).as_posix()}", path.read_bytes()


def list_recordings(results: Results) -> Sequence[Mapping[str, Any]]:
    """The recordings that the results rest on: id, file, SHA-256, start, status."""
    return results.rows(
        "SELECT recording_id, source_path, source_sha256, started_at, status, protocol, specimen_id"
        " FROM recordings WHERE recording_id IS NOT NULL AND status IN ('ok', 'damaged')"
        " ORDER BY recording_id, source_sha256"
    )
