"""Every id that the contract allows opens every door: samples in SQL and notebooks, pages, out and back in."""

from __future__ import annotations

from urllib.parse import unquote

import pytest

from pipeline import Lab
from pipeline.lab.annotations import annotate
from pipeline.lab.notebook import Lab as Notebook
from pipeline.lab.query import Query
from pipeline.nightly.night import nightly
from schemas.metadata import RECORDING_ID
from tests.faults.lab_state import healthy, select
from tests.helpers.small_lab import life

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

IDS = (
    "a.b", "a.b.c", "a..b", "a.", "1.5", "0", "007", "2026-03-01T08.00", "-".join("rig7"), "a_b-c.d", "Run-A", "run-a", "RUN-A",
    "select", "main.recordings", "x" * 80, "x" * 79 + ".", "samples", "null", "a-", "index", "CON",
)  # fmt: skip
"""Dots, dashes, digits first, 80 characters, twins in upper and lower case, words that mean something elsewhere."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    folder = tmp_path_factory.mktemp("ids")
    (folder / "raw").mkdir()
    for number, name in enumerate(IDS):
        assert RECORDING_ID.fullmatch(name)
        life(folder / "raw" / f"{number}.mcap", number, name=name, specimen_id=name)
    lab = Lab(folder / "lab")
    assert nightly([folder / "raw"], lab, jobs=0).exit_status == 0
    assert healthy(lab) == []
    return lab


def expected(lab: Lab, name: str) -> int:
    """Samples of the recording by its row."""
    return int(select(lab, f"SELECT sample_count FROM recordings WHERE recording_id = '{name}'")[0][0])


@pytest.mark.long_after(1)
@pytest.mark.parametrize("name", IDS)
def test_samples_in_sql(lab: Lab, name: str) -> None:
    with Query(lab) as query:
        (row,) = query.run(f"SELECT count(*) AS n, max(voltage) AS kv FROM samples('{name}')").to_pylist()
    assert row["n"] == expected(lab, name)
    assert row["kv"] == pytest.approx(7.5, abs=0.1)


def test_samples_of_all_in_one_query(lab: Lab) -> None:
    parts = " UNION ALL ".join(f"SELECT '{name}' AS name, sum(voltage) AS kv FROM samples('{name}')" for name in IDS)
    with Query(lab) as query:
        found = {row["name"]: row["kv"] for row in query.run(parts).to_pylist()}
    assert found == pytest.approx({name: Notebook(lab.folder).samples(name)["voltage"].sum() for name in IDS})
    assert len(set(found.values())) == len(IDS), "each has its own noise, the twins too"


@pytest.mark.long_after(18)
@pytest.mark.parametrize("name", IDS)
def test_samples_in_a_notebook(lab: Lab, name: str) -> None:
    assert len(Notebook(lab.folder).samples(name)) == expected(lab, name)


def test_each_has_pages_of_its_own_that_are_linked(lab: Lab) -> None:
    text = (lab.reports / "recordings.html").read_text(encoding="utf-8")
    files = {path.name for path in (lab.reports / "recordings").glob("*.html")}
    assert len({name.casefold() for name in files}) == len(IDS), (
        "also where file names do not tell upper from lower case"
    )
    assert all(f'href="recordings/{file}"' in unquote(text) for file in files)
    assert len(list((lab.reports / "specimens").glob("*.html"))) == len(IDS)


def test_each_can_be_taken_out(lab: Lab) -> None:
    for name in IDS:
        annotate(lab, name, "exclude", "a test")
    nightly([lab.folder.parent / "raw"], lab, jobs=0)
    assert select(lab, "SELECT count(*) FROM recordings WHERE status = 'excluded'") == [(len(IDS),)]
