"""The published formats: what another writer makes is valid, what is wrong is said at once, and the schemas agree with the parsers."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest

import schemas
from ingest.compressed import find_stem, find_suffix
from ingest.draft import make_draft
from ingest.mapping import FileMapping
from ingest.mapping_schema import SCHEMAS
from ingest.parts import name_parts, part_of
from ingest.read import read_raw
from ingest.validate import validate
from pipeline.cli import main
from schemas.metadata import RecordingMetadata, list_faults
from schemas.recording import RawRecording
from tests.helpers.json_schema import is_valid
from tests.helpers.small_lab import small_campaign
from tests.readers import independent_writer

PUBLISHED = Path(schemas.__file__).parent / "published"
TESTS = Path(__file__).resolve().parents[1]
MAPPINGS = sorted(
    [
        *TESTS.glob("real_data/*.toml"),
        *TESTS.glob("strangers/files/**/*.toml"),
        *TESTS.glob("strangers/drafted/**/*.toml"),
    ]
)
DATA = sorted(m.with_suffix("") for m in TESTS.glob("strangers/files/**/*.toml") if m.with_suffix("").is_file())
GOOD = independent_writer.METADATA


@pytest.mark.parametrize("name", SCHEMAS)
def test_published_schemas_are_those_of_the_parsers(name: str) -> None:
    """Renew with `dealab validate --schema NAME > schemas/published/NAME.schema.json`."""
    assert json.loads((PUBLISHED / f"{name}.schema.json").read_text(encoding="utf-8")) == SCHEMAS[name]()


@pytest.mark.parametrize("path", MAPPINGS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_mapping_of_the_tests_keeps_to_the_schema(path: Path) -> None:
    content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    name = "rig" if path.parent.name == "rigs" else "mapping"
    assert is_valid(json.loads(json.dumps(content, default=str)), SCHEMAS[name]())


@pytest.mark.parametrize("path", DATA, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_draft_keeps_to_the_schema(path: Path, tmp_path: Path) -> None:
    """As soon as it is answered: local times whose zone stands in `[time]`, and files that have times of their own."""
    draft = tomllib.loads(make_draft(Path(shutil.copy(path, tmp_path))).as_toml().replace('= "?"', "= 1.0"))
    assert is_valid(json.loads(json.dumps(draft, default=str)), SCHEMAS["mapping"]())


@pytest.mark.long
@pytest.mark.slow
def test_every_recording_of_the_tests_keeps_to_the_schema(tmp_path: Path) -> None:
    """What files say of themselves, and what mappings say of them: as the checks of the pipeline get it."""
    found = [read_raw(path, None) for path in sorted(small_campaign(tmp_path / "raw").glob("*.mcap"))]
    for path in sorted(m for m in MAPPINGS if m.parent.parent.name == "drafted" and m.with_suffix("").is_file()):
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        if content.get("kind", "recording") == "recording":
            draft = tomllib.loads(make_draft(path.with_suffix("")).as_toml().replace('= "?"', "= 1.0"))
            stem, suffix = find_stem(path.with_suffix("")), find_suffix(path.with_suffix(""))
            mapping = FileMapping.parse(draft, stem=stem, suffix=suffix)
            parts = [part_of(mapping, name) for name in name_parts(draft)] or [mapping]
            found += [read_raw(path.with_suffix(""), part) for part in parts]
    assert len(found) >= 30
    schema = SCHEMAS["recording"]()
    for raw in found:
        assert isinstance(raw, RawRecording)
        content = {"recording": dict(raw.metadata), "rig": dict(raw.rig)}
        assert is_valid(json.loads(json.dumps(content, default=str)), schema), raw.metadata


def test_the_examples_of_the_document_keep_to_the_schemas() -> None:
    text = (TESTS.parent / "ingest" / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n# (\S+\.toml)\n(.*?)```", text, flags=re.DOTALL)
    assert len(blocks) >= 8
    for name, block in blocks:
        schema = SCHEMAS["rig" if name.startswith("rigs/") else "mapping"]()
        assert is_valid(json.loads(json.dumps(tomllib.loads(block), default=str)), schema), name


def test_files_of_an_independent_writer_are_valid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = independent_writer.write(tmp_path)
    assert len(written) == 5
    assert main(["validate", *map(str, written)]) == 0
    assert capsys.readouterr().out.count(", valid") == 5
    assert is_valid({"recording": GOOD}, SCHEMAS["recording"]())


@pytest.mark.parametrize(
    "change",
    [
        {"recording_id": "-x"},
        {"loading": "mechanic"},
        {"started_at": "2026-03-01T13:05:00"},
        {"film_length_mm": "0"},
        {"film_length_mm": -3},
        {"layers": 0},
        {"drive_kv": "high"},
        {"sweep": "linear "[:3]},
        {"specimen_id": None},
    ],
)
def test_schema_and_parsers_refuse_alike(change: dict[str, Any]) -> None:
    about: dict[str, Any] = {k: v for k, v in (GOOD | change).items() if v is not None}
    assert list_faults(about, RecordingMetadata)
    if change != {"film_length_mm": "0"}:  # what a text says as a number is for the parser
        assert not is_valid({"recording": about}, SCHEMAS["recording"]())


@pytest.mark.parametrize(
    "change",
    [
        {"notes": 3},
        {"masses_kg": [0.1, 0.2]},
        {"masses_kg": "0.1,0.2"},
        {"x_own": "y"},
        {"layers": "2"},
        {"layers": ""},
    ],
)
def test_schema_and_parsers_accept_alike(change: dict[str, Any]) -> None:
    about = GOOD | change
    assert not list_faults(about, RecordingMetadata)
    assert is_valid({"recording": about}, SCHEMAS["recording"]())


def test_all_faults_are_said_at_once_with_what_was_meant(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    about = {k: v for k, v in GOOD.items() if k not in ("specimen_id", "film_length_mm")} | {
        "film_lenght_mm": "5",
        "stretch_1": "none",
    }
    (tmp_path / "run.json").write_text(json.dumps({"recording": about, "rig": {"clamp_mas_kg": 1}}), encoding="utf-8")
    assert main(["validate", str(tmp_path / "run.json")]) == 1
    out = capsys.readouterr().out
    assert "4 faults" in out
    assert "did you mean film_length_mm?" in out
    assert "did you mean clamp_mass_kg?" in out
    assert 'stretch_1 is "none"; expected a number' in out
    assert "required key specimen_id is missing" in out


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("run.csv.toml", "kin = 'recording'\n", "did you mean kind?"),
        ("run.csv.toml", "[csv]\ndelimeter = ';'\n", "did you mean csv.delimiter?"),
        ("run.csv.toml", "a = [", "not valid TOML"),
        ("recordings.toml", "[[files]]\nkind = 'ignore'\n", "has no match"),
        ("rigs/rig-a.toml", "clamp_mass_kg = 'much'\nforce_noise_sd = -1\n", "2 faults"),
        ("run.json", "[]", "there is no table"),
        ("run.mcap", "no recording", "1 fault"),
    ],
)
def test_each_kind_of_file_is_told_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, text: str, said: str
) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    assert validate(path).faults
    assert main(["validate", str(path)]) == 1
    assert said in capsys.readouterr().out


def test_a_mapping_is_checked_with_its_file_where_that_is_there(tmp_path: Path) -> None:
    independent_writer.write(tmp_path)
    (tmp_path / "ours-2.csv").write_text("t,x,Kraft\n0,1,2\n", encoding="utf-8")
    (fault, *_) = validate(tmp_path / "ours-2.csv.toml").faults
    assert '"F"' in str(fault)


def test_without_a_file_the_usage_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate"]) == 2
    assert main(["validate", str(tmp_path / "nowhere")]) == 1
    assert "not a file" in capsys.readouterr().err
