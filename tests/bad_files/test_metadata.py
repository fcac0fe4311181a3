"""Metadata that somebody wrote in bad faith or by mistake does no harm and is named when it is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ingest.canonical import canonical
from ingest.draft_text import toml_string
from ingest.mapping import find_mapping
from ingest.quarantine import entries, quarantine
from ingest.read import read_raw
from schemas.errors import RefusedError
from schemas.recording import RawRecording, Recording

HOSTILE = {
    "path": "../../../../etc/passwd",
    "windows path": "..\\..\\x",
    "sql": "x'); DROP TABLE recordings; --",
    "html": "</script><script>alert('x')</script>",
    "template": "{{ 7 * 7 }}{% raw %}",
    "format": "{0.__class__} %s %n",
    "direction": "\u202egnp.exe\u2066",
    "escape": "\x1b[2J\x07",
    "line ends": "a\r\nb\u2028c",
    "long": "x" * 10_000,
}


def take(folder: Path, name: str, **keys: str) -> Recording:
    path = folder / name
    path.write_text("t,x,F\n" + "".join(f"{i / 100:.2f},{np.sin(i):.4f},{np.cos(i):.4f}\n" for i in range(30)))
    metadata = {
        "recording_id": "r1",
        "protocol": "cyclic",
        "loading": "mechanical",
        "specimen_id": "s1",
        "started_at": "2026-03-01T14:00:00Z",
    } | keys
    toml = (
        '[time]\ncolumn = "t"\nunit = "s"\n[columns.displacement]\ncolumn = "x"\nunit = "mm"\n'
        '[columns.force]\ncolumn = "F"\nunit = "N"\n[recording]\n'
        + "".join(f"{toml_string(k)} = {toml_string(v)}\n" for k, v in metadata.items())
    )
    (folder / f"{name}.toml").write_text(toml, encoding="utf-8")
    raw = read_raw(path, find_mapping(path))
    assert isinstance(raw, RawRecording)
    return canonical(raw, where=path.name)


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_free_text_is_kept_letter_by_letter(tmp_path: Path, text: str) -> None:
    found = take(tmp_path, "run.csv", operator=text, notes=text, material=text, rig_id=text, mood=text)
    assert found.metadata.operator == text
    assert found.metadata.extra["mood"] == text
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.csv", "run.csv.toml"]


@pytest.mark.parametrize("key", ["recording_id", "protocol", "loading", "started_at", "stretch_1", "failure_site"])
@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_checked_keys_refuse_it_and_the_reason_stays_short(tmp_path: Path, key: str, text: str) -> None:
    with pytest.raises(RefusedError) as refused:
        take(tmp_path, "run.csv", **{key: text})
    assert len(refused.value.problem) < 200
    folder = quarantine(tmp_path / "run.csv", tmp_path / "lab", refused.value)
    assert folder.parent == tmp_path / "lab" / "quarantine"
    assert len(entries(tmp_path / "lab")) == 1


@pytest.mark.parametrize("text", ["a\x00b", "x" * 10_001], ids=["nul", "too long"])
def test_text_that_cannot_be_stored_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(RefusedError, match="operator"):
        take(tmp_path, "run.csv", operator=text)


@pytest.mark.parametrize(
    "name", ["'; DROP TABLE x;--.csv", "<b>.csv", "\u202evsc.csv", "-rf .csv", "{stem}.csv", "%s.csv"]
)
def test_hostile_file_names_become_no_ids(tmp_path: Path, name: str) -> None:
    with pytest.raises(RefusedError, match="recording_id"):
        take(tmp_path, name, recording_id="{stem}")
    assert take(tmp_path, name, operator="{stem}").metadata.operator == Path(name).stem
