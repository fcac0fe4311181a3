"""A report on many recordings without the work of their pages: `python -m tests.faults.many_pages LAB` makes it twice and tells
its memory; `lab` makes the database.

Pages about one recording or specimen are made up, so that the rest of the report shows.
"""

from __future__ import annotations

import json
import sys
import tracemalloc
from pathlib import Path

import duckdb

import reports.pages.recording.page
import reports.pages.specimen.page
from reports.blocks import Page
from reports.site import Site
from tests.helpers import synthetic_lab
from tests.helpers.machine import peak_mb


def lab(folder: Path, number: int) -> Path:
    """A lab with so many recordings, each of a specimen of its own that has its model."""
    story = synthetic_lab.Story()
    story.recording("R-0", "S-0", "chirp", "mechanical", campaign=None, rig_id=None, operator=None)
    story.fits("S-0", synthetic_lab.SILICONE)
    story.run()
    story.write(folder)
    with duckdb.connect(str(folder / "results.duckdb")) as connection:
        for table, names in (
            ("recordings", {"recording_id": "R", "specimen_id": "S", "source_path": "/raw/R"}),
            ("model_fits", {"specimen_id": "S"}),
        ):
            others = ", ".join(f"concat('{letter}-', i) AS {column}" for column, letter in names.items())
            connection.execute(
                f"INSERT INTO {table} BY NAME SELECT t.* REPLACE ({others}) FROM {table} AS t, range(1, {number}) AS r(i)"
            )
    return folder


def page(site: Site, item: str) -> Page:
    """Stands in for a page about one item; one of two has a data file."""
    files = {site.data_path("recording", item, "samples"): "time_s\n"} if item.startswith("R") else {}
    return Page(title=item, heading=item, bar=(), sections=(), files=files)


def main(folder: Path) -> dict[str, float]:
    """Memory in MB: the most that the first report had, and what Python's objects took in one with nothing new."""
    for module in (reports.pages.recording.page, reports.pages.specimen.page):
        module.page = page
    from reports.build import build_reports

    assert build_reports(folder).pages_unchanged == 0
    told = {"first": peak_mb()}
    tracemalloc.start()
    assert build_reports(folder).pages_written == 0
    return told | {"nothing new": tracemalloc.get_traced_memory()[1] / (1 << 20)}


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]))))
