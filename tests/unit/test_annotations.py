"""What people say is written whole or not at all, and a line that is none costs nothing but itself."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from pipeline import Lab
from pipeline.lab.annotations import annotate, find_broken_lines, list_excluded, read_annotations
from pipeline.lab.health import check_lab
from schemas.errors import LabError

GOOD = {
    "recording_id": "A",
    "action": "exclude",
    "why": "slipped",
    "author": "me",
    "at": "2026-03-01T08:00:00.000+00:00",
}
BROKEN = (
    b'{"recording_id": "A", "act',
    b"\xff\xfe",
    b'{"recording_id": "caf\xe9", "action": "exclude", "why": "x", "author": "x", "at": "2026-03-01T08:00:00+00:00"}',
    b"[1, 2]",
    b"null",
    b"7",
    b"{}",
    b"[" * 5000,
    json.dumps(GOOD | {"recording_id": ["A"]}).encode(),
    json.dumps(GOOD | {"recording_id": "../x"}).encode(),
    json.dumps(GOOD | {"why": None}).encode(),
    json.dumps(GOOD | {"why": "\ud800"}).encode(),
    json.dumps(GOOD | {"author": 7}).encode(),
    json.dumps(GOOD | {"action": "drop"}).encode(),
    json.dumps(GOOD | {"at": "yesterday"}).encode(),
    json.dumps(GOOD | {"at": "2026-03-01"}).encode(),
    json.dumps(GOOD | {"at": "9999-12-31T23:59:59-14:00"}).encode(),
    json.dumps(GOOD | {"more": "x"}).encode(),
)


@pytest.mark.parametrize("line", BROKEN, ids=range(len(BROKEN)))
def test_a_broken_line_is_named_and_set_aside(line: bytes, tmp_path: Path) -> None:
    """`doctor` names it, the next word of anybody sets it aside, and nothing of it is lost."""
    lab = Lab(tmp_path)
    lab.annotations.write_bytes(json.dumps(GOOD).encode() + b"\n" + line)
    assert [one.recording_id for one in read_annotations(lab)] == ["A"]
    (told,) = find_broken_lines(lab)
    assert "line 2" in told
    assert any("line 2" in (finding.problem or "") for finding in check_lab(lab))
    annotate(lab, "B", "include", "after all")
    assert find_broken_lines(lab) == ()
    assert [one.recording_id for one in read_annotations(lab)] == ["A", "B"]
    kept = json.loads(lab.annotations.read_text().splitlines()[1])
    assert kept["unreadable"].encode().startswith(line[:8].decode("utf-8", "backslashreplace").encode())


def test_a_line_without_its_end_is_a_line(tmp_path: Path) -> None:
    lab = Lab(tmp_path)
    lab.annotations.write_text(json.dumps(GOOD))
    annotate(lab, "A", "include", "it was the wrong one")
    assert [one.action for one in read_annotations(lab)] == ["exclude", "include"]
    assert list_excluded(read_annotations(lab)) == frozenset()


@pytest.mark.parametrize("fault", ["short", "full"])
def test_a_full_disk_leaves_no_half_line(fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system may write less than it was given, and then nothing."""
    lab = Lab(tmp_path)
    annotate(lab, "A", "exclude", "slipped")
    before = lab.annotations.read_bytes()
    write = os.write

    def write_some(handle: int, data: bytes) -> int:
        if fault == "full" and len(data) < 60:
            raise OSError(28, "No space left on device")
        return write(handle, data[:10])

    with monkeypatch.context() as broken:
        broken.setattr(os, "write", write_some)
        if fault == "full":
            with pytest.raises(LabError, match="No space left"):
                annotate(lab, "B", "exclude", "slipped as well")
            assert lab.annotations.read_bytes() == before
            return
        annotate(lab, "B", "exclude", "slipped as well")
    assert list_excluded(read_annotations(lab)) == {"A", "B"}


def test_annotations_are_not_written_through_a_link(tmp_path: Path) -> None:
    lab, elsewhere = Lab(tmp_path / "lab"), tmp_path / "elsewhere"
    lab.create()
    elsewhere.write_text("precious\n")
    lab.annotations.symlink_to(elsewhere)
    with pytest.raises(LabError, match="a link in the lab"):
        annotate(lab, "A", "exclude", "slipped")
    assert elsewhere.read_text() == "precious\n"
