"""One strange item among the raw files costs itself only: names, depths, numbers, links, and reading without end."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pipeline.nightly.look
import pipeline.nightly.night
from pipeline import Lab
from pipeline.lab.settings import load_settings
from pipeline.nightly.night import nightly
from schemas.errors import LabError
from tests.faults import strange_items
from tests.faults.lab_state import healthy, select
from tests.helpers.small_lab import life

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.skipif(os.name == "nt", reason="Windows has no such names and no such links"),
]


@pytest.mark.long_after(1)
@pytest.mark.parametrize("put", strange_items.ALL)
def test_one_strange_item_ends_no_night(
    put: Callable[[bytes], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    life(raw / "L-1.mcap", 1)
    put(os.fsencode(raw))
    try:
        summary = nightly([raw], lab, jobs=0)
        assert select(lab, "SELECT recording_id FROM recordings WHERE status = 'ok'") == [("L-1",)]
        told = [*summary.notes, *summary.attention]
        assert told
        for line in told:
            line.encode()
        assert healthy(lab) == []
    finally:
        strange_items.remove_deep(raw)


def test_a_file_system_that_does_not_answer_costs_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    for number in range(3):
        life(raw / f"L-{number}.mcap", number)
    lab.create()
    lab.settings.write_text("deadline_s = 1\n")
    answer, hash_file = threading.Event(), pipeline.nightly.look.file_sha256

    def hang(path: Path) -> str:
        if path.stem == "L-1":
            answer.wait(60)
        return hash_file(path)

    def night() -> Any:
        began = time.monotonic()
        summary = nightly([raw], lab, jobs=0)
        assert time.monotonic() - began < 50
        return summary

    with monkeypatch.context() as hanging:
        hanging.setattr(pipeline.nightly.look, "file_sha256", hang)
        first = night()
    answer.set()
    assert first.exit_status == 3
    assert "longer than deadline_s allows" in "\n".join(first.attention)
    rows = dict(select(lab, "SELECT split_part(source_path, '/', -1), status FROM recordings"))
    assert rows == {"L-0.mcap": "ok", "L-1.mcap": "pending", "L-2.mcap": "ok"}
    assert select(lab, "SELECT nights FROM accidents") == [(1,)]
    assert night().exit_status == 0
    assert select(lab, "SELECT count(*) FROM accidents") == [(0,)]


@pytest.mark.parametrize(
    "text",
    [
        "deadline_s = inf",
        "memory_mb = inf",
        "memory_mb = nan",
        "deadline_s = 1e300",
        f"memory_mb = {'9' * 400}",
        ".".join("a" * 3000) + " = 1",
        "orders = " + "[" * 3000 + "]" * 3000,
        "\udcff",
    ],
)
def test_absurd_settings_are_refused_in_a_line(text: str, tmp_path: Path) -> None:
    lab = Lab(tmp_path)
    lab.settings.write_text(text, errors="surrogateescape")
    with pytest.raises(LabError, match="settings"):
        load_settings(lab)
