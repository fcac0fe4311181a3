"""One file with several recordings: ranges, tolerances and `each` of [[select]], and the night over them."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from ingest.draft import make_draft
from ingest.faults import find_faults
from ingest.inspect import FITS, REFUSED, inspect
from ingest.mapping import FileMapping, find_mapping
from ingest.parts import list_parts, part_of
from ingest.read import read_raw
from ingest.tables import ResponseTable
from schemas.errors import RefusedError
from tests.strangers.nights import run_night

TEMPERATURES = {0: (0.01, -0.06, 0.1), 25: (24.98, 25.08, 24.95), 40: (40.02, 39.97, 40.0)}
HEAD = """kind = "frequency_response"
[csv]
unit_row = true
[columns.frequency]
column = "Frequency"
unit = "Hz"
[columns.storage]
column = "Storage modulus"
unit = "MPa"
[columns.loss]
column = "Loss modulus"
unit = "MPa"
[recording]
recording_id = "{stem}-{each}"
specimen_id = "film at {each} C"
"""
EACH = '[[select]]\ncolumn = "Temperature"\neach = true\ntolerance = 0.5\n'


def write_sweeps(folder: Path, select: str = EACH, head: str = HEAD) -> Path:
    rows = [
        f"{found},{10.0**i},{1.0 + 0.1 * i + 0.01 * meant},0.1"
        for meant, scatter in TEMPERATURES.items()
        for i, found in enumerate(scatter)
    ]
    path = folder / "dma.csv"
    path.write_text("\n".join(["Temperature,Frequency,Storage modulus,Loss modulus", "C,Hz,MPa,MPa", *rows, ""]))
    path.with_name("dma.csv.toml").write_text(head + select)
    return path


def mapping_of(path: Path) -> FileMapping:
    found = find_mapping(path)
    assert found is not None
    return found


def test_each_temperature_is_a_recording_of_its_own(tmp_path: Path) -> None:
    path = write_sweeps(tmp_path)
    mapping = mapping_of(path)
    assert list_parts(path, mapping) == ("0", "25", "40")
    parts = [part_of(mapping, label) for label in ("0", "25", "40")]
    assert len({part.reads for part in parts}) == len({part.hash for part in parts}) == 3
    for part, meant in zip(parts, TEMPERATURES, strict=True):
        table = read_raw(path, part)
        assert isinstance(table, ResponseTable)
        assert table.metadata.recording_id == f"dma-{meant}"
        assert table.metadata.specimen_id == f"film at {meant} C"
        assert table.value.real == pytest.approx([1 + 0.1 * i + 0.01 * meant for i in range(3)])
    with pytest.raises(RefusedError, match="several recordings"):
        read_raw(path, mapping)
    found = inspect(path)
    assert found.verdict == FITS, found.as_text()
    assert "3 recordings in one file: 0, 25, 40" in found.as_text()


@pytest.mark.long
def test_a_night_takes_every_part_once_and_follows_the_file(tmp_path: Path) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    write_sweeps(folder)
    night = run_night(folder, tmp_path)
    ids = sorted(row[0] for row in night.rows("SELECT recording_id FROM recordings WHERE status = 'ok'"))
    assert ids == ["dma-0", "dma-25", "dma-40"]
    paths = [row[0] for row in night.rows("SELECT DISTINCT source_path FROM recordings")]
    assert {path.rpartition("/")[2] for path in paths} == {f"dma.csv#each={label}" for label in (0, 25, 40)}


@pytest.mark.parametrize(
    ("select", "said"),
    [
        ('[[select]]\ncolumn = "Storage modulus"\neach = true\ntolerance = 0.12\n', "without a gap"),
        ('[[select]]\ncolumn = "Temperature"\neach = true\nequals = 3\n', "equals and each"),
        ('[[select]]\ncolumn = "Temperature"\nat_least = 90\n', "no row has a number from 90"),
        ('[[select]]\ncolumn = "nowhere"\neach = true\n', "nowhere"),
        ('[[select]]\ncolumn = "Temperature"\n', "lacks column or equals"),
    ],
)
def test_selections_that_cannot_be_are_refused(tmp_path: Path, select: str, said: str) -> None:
    path = write_sweeps(tmp_path, select, HEAD.replace("-{each}", "") if "each" not in select else HEAD)
    found = inspect(path)
    assert found.verdict == REFUSED
    assert said in found.as_text()
    content = tomllib.loads(path.with_name("dma.csv.toml").read_text())
    assert any(said in str(fault) for fault in find_faults(path, content, source="dma.csv.toml"))


def test_one_recording_id_for_several_recordings_is_refused(tmp_path: Path) -> None:
    path = write_sweeps(tmp_path, head=HEAD.replace("-{each}", ""))
    assert "recording_id" in inspect(path).as_text()


@pytest.mark.parametrize(
    ("select", "meant"),
    [
        ('[[select]]\ncolumn = "Temperature"\nequals = 25\ntolerance = 0.2\n', 25),
        ('[[select]]\ncolumn = "Temperature"\nat_least = 30\nat_most = 50\n', 40),
        ('[[select]]\ncolumn = "Temperature"\nat_most = 1\n', 0),
    ],
)
def test_tolerance_and_ranges(tmp_path: Path, select: str, meant: int) -> None:
    path = write_sweeps(tmp_path, select, HEAD.replace("-{each}", "").replace("{each}", "some"))
    table = read_raw(path, mapping_of(path))
    assert isinstance(table, ResponseTable)
    assert table.frequency_hz.size == 3
    assert table.value.real[0] == pytest.approx(1 + 0.01 * meant)


def test_several_temperatures_are_drafted_as_several_recordings(tmp_path: Path) -> None:
    path = write_sweeps(tmp_path)
    draft = make_draft(path)
    assert draft.content["recording"]["specimen_id"] == "{stem}"  # one specimen: its temperatures make a master curve
    assert draft.content["select"] == [{"column": "Temperature", "each": True, "tolerance": 0.2}]
    assert list_parts(path, FileMapping.parse(draft.content, stem="dma", suffix=".csv")) == ("0", "25", "40")
