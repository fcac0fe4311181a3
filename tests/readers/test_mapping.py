"""Mapping TOMLs: strictness, which one is taken, hashes; rig files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ingest.mapping import FileMapping, find_mapping
from ingest.rigs import find_rig
from ingest.toml_files import load_toml
from schemas.errors import RefusedError

CONTRACT = """
[[files]]
match = "*.csv"
kind = "recording"
[files.csv]
delimiter = ";"
decimal = ","
encoding = "cp1252"
skip_rows = 3
header = true
unit_row = true
[files.time]
column = "t"
unit = "s"
[files.columns.force]
column = "Load cell"
unit = "N"
scale = 1.0
offset = 0.0
[files.recording]
recording_id = "{stem}"
protocol = "chirp"
[files.rig]
clamp_mass_kg = 0.05
"""


def content(**changes: Any) -> dict[str, Any]:
    base: dict[str, Any] = {
        "time": {"column": "t", "unit": "s"},
        "columns": {"force": {"column": "F", "unit": "N"}},
        "recording": {"recording_id": "{stem}"},
    }
    return base | changes


def parse(**changes: Any) -> FileMapping:
    return FileMapping.parse(content(**changes), stem="run7", suffix=".csv", source="run7.csv.toml")


def test_example_of_the_contract(tmp_path: Path) -> None:
    (tmp_path / "recordings.toml").write_text(CONTRACT)
    mapping = find_mapping(tmp_path / "run7.csv")
    assert mapping is not None
    assert mapping.kind == "recording"
    assert mapping.format == "csv"
    assert mapping.options["skip_rows"] == 3
    assert mapping.time is not None
    assert mapping.time.column == "t"
    assert mapping.columns["force"].column == "Load cell"
    assert mapping.recording == {"recording_id": "run7", "protocol": "chirp"}
    assert mapping.rig == {"clamp_mass_kg": 0.05}


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"colums": {}}, '"colums" is unknown'),
        ({"csv": {"delimeter": ";"}}, "csv.delimeter"),
        ({"csv": {"skip_rows": "3"}}, "csv.skip_rows is '3'"),
        ({"csv": {"skip_rows": True}}, "csv.skip_rows is 'True'"),
        ({"csv": {"header": 1}}, "csv.header is '1'"),
        ({"csv": {}, "excel": {}}, "tables of 2 formats"),
        ({"format": "docx"}, 'format is "docx"'),
        ({"kind": "recordings"}, 'kind is "recordings"'),
        (
            {"columns": {"farce": {"column": "F", "unit": "N"}}},
            '"columns.farce" is unknown: did you mean columns.force?',
        ),
        ({"columns": {"force": {"unit": "N"}}}, "columns.force has no column"),
        ({"columns": {"force": {"column": "F", "units": "N"}}}, "columns.force.units"),
        ({"columns": {"force": {"column": -1, "unit": "N"}}}, "columns.force.column is -1"),
        ({"columns": {"force": "F"}}, "columns.force is 'F'"),
        ({"columns": {}}, "no columns are mapped"),
        ({"time": {"unit": "s"}}, "neither column nor sample_rate_hz"),
        ({"time": {"column": "t", "sample_rate_hz": 10.0}}, "column and sample_rate_hz"),
        ({"time": {"sample_rate_hz": 0}}, "sample_rate_hz is 0"),
        ({"time": {"sample_rate_hz": float("nan")}}, "sample_rate_hz is nan"),
        ({"time": {"column": "t", "origin": "boot"}}, 'time.origin is "boot"'),
        ({"time": {"column": "t", "unit": "s", "format": "iso"}}, "format and unit"),
        ({"recording": []}, "recording is list"),
        ({"select": [{"column": "Set"}]}, "lacks column or equals"),
    ],
)
def test_mistakes_are_named(changes: dict[str, Any], problem: str) -> None:
    with pytest.raises(RefusedError) as refused:
        parse(**changes)
    assert problem in refused.value.problem
    assert refused.value.where == "run7.csv.toml"


def test_unknown_keys_of_metadata_and_rig_are_kept() -> None:
    mapping = parse(recording={"weather": "rain"}, rig={"paint": "red"})
    assert mapping.recording["weather"] == "rain"
    assert mapping.rig["paint"] == "red"


def test_own_file_comes_before_the_folder(tmp_path: Path) -> None:
    (tmp_path / "recordings.toml").write_text(CONTRACT)
    own = CONTRACT.replace("[[files]]", "").replace('match = "*.csv"', "").replace("files.", "")
    (tmp_path / "run7.csv.toml").write_text(own.replace('"chirp"', '"cyclic"'))
    found = [find_mapping(tmp_path / name) for name in ("run7.csv", "run8.csv", "run8.dat")]
    assert found[0] is not None
    assert found[1] is not None
    assert found[0].recording["protocol"] == "cyclic"
    assert found[1].recording["protocol"] == "chirp"
    assert found[2] is None


def test_first_match_is_taken(tmp_path: Path) -> None:
    special = CONTRACT.replace('"*.csv"', '"run7*"').replace('"chirp"', '"step"')
    (tmp_path / "recordings.toml").write_text(special + CONTRACT)
    found = find_mapping(tmp_path / "run7.csv")
    assert found is not None
    assert found.recording["protocol"] == "step"
    (tmp_path / "recordings.toml").write_text(CONTRACT + special)
    found = find_mapping(tmp_path / "run7.csv")
    assert found is not None
    assert found.recording["protocol"] == "chirp"


def test_hash_follows_content_not_comments(tmp_path: Path) -> None:
    path = tmp_path / "recordings.toml"
    hashes = []
    for text in (CONTRACT, "# a remark\n" + CONTRACT, CONTRACT.replace("0.05", "0.06")):
        path.write_text(text)
        found = find_mapping(tmp_path / "a.csv")
        assert found is not None
        hashes.append(found.hash)
    assert hashes[0] == hashes[1] != hashes[2]


def test_broken_toml_and_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "recordings.toml"
    path.write_bytes(b"\xef\xbb\xbf" + CONTRACT.encode())
    assert find_mapping(tmp_path / "run.csv") is not None
    for wrong in (b"[[files]\n", b"\xff\xfe", b"files = 3\n", b"[[files]]\nkind = 'recording'\n", b"speed = 1\n"):
        path.write_bytes(wrong)
        with pytest.raises(RefusedError) as refused:
            find_mapping(tmp_path / "run.csv")
        assert "recordings.toml" in refused.value.where


def test_huge_toml_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_bytes(b"#" * (1 << 21))
    with pytest.raises(RefusedError, match="bytes"):
        load_toml(path)


def test_deeply_nested_toml_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_text("a = " + "[" * 100_000)
    with pytest.raises(RefusedError, match="not valid TOML"):
        load_toml(path)


# --- rigs ---------------------------------------------------------------------------------------------------------


def test_rig_file_beside_above_and_given(tmp_path: Path) -> None:
    raw = tmp_path / "raw"
    day = raw / "2026" / "03"
    day.mkdir(parents=True)
    recording = day / "a.mcap"
    for folder, mass in ((tmp_path, 0.9), (raw, 0.1), (day, 0.2), (tmp_path / "elsewhere", 0.3)):
        (folder / "rigs").mkdir(parents=True)
        (folder / "rigs" / "rig-1.toml").write_text(f"clamp_mass_kg = {mass}\n")
    nearest = find_rig("rig-1", recording, root=raw)
    assert nearest is not None
    assert nearest.values["clamp_mass_kg"] == 0.2
    (day / "rigs" / "rig-1.toml").unlink()
    above = find_rig("rig-1", recording, root=raw)
    assert above is not None
    assert above.values["clamp_mass_kg"] == 0.1
    given = find_rig("rig-1", recording, root=raw, rigs=tmp_path / "elsewhere" / "rigs")
    assert given is not None
    assert given.values["clamp_mass_kg"] == 0.3
    (raw / "rigs" / "rig-1.toml").unlink()
    assert find_rig("rig-1", recording, root=raw) is None
    assert find_rig(None, recording, root=raw) is None


def test_rig_name_cannot_leave_the_folder(tmp_path: Path) -> None:
    (tmp_path / "secret.toml").write_text("clamp_mass_kg = 1\n")
    for name in ("../secret", "/etc/passwd", "a/b", "..", "x\x00y"):
        assert find_rig(name, tmp_path / "raw" / "a.mcap", rigs=tmp_path / "rigs") is None


def test_rig_file_must_name_its_rig(tmp_path: Path) -> None:
    (tmp_path / "r1.toml").write_text('rig_id = "r2"\n')
    with pytest.raises(RefusedError, match='rig_id is "r2"'):
        find_rig("r1", tmp_path / "a.mcap", rigs=tmp_path)
    (tmp_path / "r1.toml").write_text("[clamp]\nmass = 1\n")
    with pytest.raises(RefusedError, match="clamp is a dict"):
        find_rig("r1", tmp_path / "a.mcap", rigs=tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "[columns.force]\ncolumn = 1\nscale = 1" + "0" * 400,
        "[recording]\nx = 1" + "1" * 5000,
        ".".join(["a"] * 3000) + " = 1",
    ],
)
def test_toml_that_no_computer_needs_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "run.csv.toml"
    path.write_text(text)
    with pytest.raises(RefusedError) as refused:
        load_toml(path)
    assert refused.value.where == "run.csv.toml"


def test_keys_of_another_kind_or_format_are_errors() -> None:
    for changes, problem in (
        ({"columns": {"force": {"column": "F", "unit": "N", "field": "a"}}}, "columns.force.field is not used for csv"),
        ({"format": "mcap", "select": [{"column": "run", "equals": 1}]}, "select is not used for mcap"),
    ):
        with pytest.raises(RefusedError) as refused:
            FileMapping.parse({"columns": {"force": {"column": "F"}}, **changes}, stem="run", suffix=".csv")
        assert problem in refused.value.problem


FORCE = {"columns": {"force": {"column": "F", "unit": "N"}}}
LIVES: dict[str, object] = {"kind": "lifetimes", "columns": {"lifetime": {"column": "L", "unit": "h"}}}


@pytest.mark.parametrize(
    ("content", "unused"),
    [
        (FORCE | {"time": {"column": "t", "format": "iso", "origin": "unix"}}, "time.origin is not used"),
        (FORCE | {"time": {"column": "t", "format": "iso", "overrule_unit": True}}, "time.overrule_unit is not used"),
        (FORCE | {"time": {"column": "t", "date_column": "d", "origin": "excel"}}, "time.origin is not used"),
        (FORCE | {"time": {"column": "t", "date_column": "d", "unit": "s"}}, "time has date_column and unit"),
        (FORCE | {"time": {"column": "t", "overrule_unit": True}}, "time has overrule_unit without unit"),
        (LIVES | {"covariates": {"a": {"value": 1, "scale": 2}}}, "covariates.a.scale is not used"),
        (LIVES | {"covariates": {"a": {"value": 1, "index": 2}}}, "covariates.a.index is not used"),
        (
            LIVES | {"covariates": {"a": {"column": "x", "law": "category", "offset": 2}}},
            "covariates.a.offset is not used",
        ),
    ],
)
def test_keys_that_other_keys_leave_without_effect_are_errors(content: dict[str, object], unused: str) -> None:
    with pytest.raises(RefusedError, match=unused):
        FileMapping.parse(content, stem="run", suffix=".csv")


@pytest.mark.parametrize(
    "content",
    [
        FORCE | {"time": {"column": "t", "format": "elapsed", "origin": "started_at"}},
        FORCE | {"time": {"column": "t", "date_column": "d", "format": "%H:%M"}},
        FORCE | {"time": {"column": "t", "unit": "s", "overrule_unit": True, "origin": "unix"}},
        LIVES | {"covariates": {"a": {"value": 1, "unit": "mm"}, "b": {"column": "x", "scale": 2}}},
    ],
)
def test_keys_that_have_an_effect_are_read(content: dict[str, object]) -> None:
    assert FileMapping.parse(content, stem="run", suffix=".csv").columns


@pytest.mark.parametrize(
    ("changes", "meant"),
    [
        ({"recordng": {}}, r"did you mean select\.recording"),
        ({"recording": {"protokol": "noise"}}, r"did you mean protocol"),
    ],
)
def test_misspelt_keys_of_a_part_are_asked_about(changes: dict[str, object], meant: str) -> None:
    """A part that should have another protocol kept the one that all have: `protokol` was a note, since `protocol` was given."""
    part = {"part": "up", "column": "c", "equals": 1, "recording": {"protocol": "step"}} | changes
    about = {"recording": {"recording_id": "r-{each}", "protocol": "step"}}
    with pytest.raises(RefusedError, match=meant):
        FileMapping.parse(FORCE | about | {"select": [part]}, stem="run", suffix=".csv")
