"""A new table needs its definition and what computes its rows, and nothing else anywhere."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

import pipeline.nightly.night
from pipeline import Lab
from pipeline.analyse import recording as analyses
from pipeline.analyse.analysis import Analysis
from pipeline.lab import snapshot
from pipeline.lab.retention import Rule, prune
from pipeline.lab.snapshot import Changes, publish
from pipeline.nightly.night import nightly
from reports.digests import digests
from reports.results import Results
from schemas.errors import LabError
from schemas.recording import Recording
from schemas.tables import TABLES, reference
from schemas.tables.table import RECORDING_ID, MadeBy, Table, real
from schemas.views import fingerprint
from tests.faults.lab_state import healthy, select
from tests.helpers.small_lab import RIG, life

PEAKS = Table(
    "voltage_peaks",
    "largest voltage of each recording",
    (RECORDING_ID, real("peak_kv", "kV", "largest voltage")),
    key=("recording_id",),
    made_by=(MadeBy("recording"),),
    pages=("recording",),
)


@pytest.fixture(autouse=True)
def with_peaks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table is defined, and the analysis of a recording fills it."""
    usual = analyses.analyse_recording

    def analyse(recording: Recording) -> Analysis:
        analysis = usual(recording)
        peak = float(recording.channels["voltage"].values.max())
        row = {"recording_id": recording.metadata.recording_id, "peak_kv": peak}
        analysis.add({"voltage_peaks": PEAKS.rows([row])})
        return analysis

    monkeypatch.setitem(TABLES, PEAKS.name, PEAKS)
    monkeypatch.setitem(snapshot._TODAY, "schema", fingerprint())  # which stands fixed from the import on
    monkeypatch.setattr(analyses, "analyse_recording", analyse)
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)


def digest_of_a_page(lab: Lab, recording: str) -> str:
    with Results(lab.folder) as results:
        return digests(results).of("recording", recording)


@pytest.mark.long
def test_a_new_table_needs_one_definition(tmp_path: Path) -> None:
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    for number in range(2):
        life(raw / f"L-{number}.mcap", number)
    nightly([raw], lab, jobs=0)
    assert "### `voltage_peaks`\nLargest voltage of each recording." in reference()
    found = dict(select(lab, "SELECT recording_id, peak_kv FROM voltage_peaks"))
    assert set(found) == {"L-0", "L-1"}
    assert healthy(lab) == []

    # Its rows belong to the page of their recording.
    before = digest_of_a_page(lab, "L-0"), digest_of_a_page(lab, "L-1")
    publish(lab, Changes(insertions=[{"voltage_peaks": [{"recording_id": "L-0", "peak_kv": 1e3}]}]))
    assert digest_of_a_page(lab, "L-0") != before[0]
    assert digest_of_a_page(lab, "L-1") == before[1]

    # No row speaks of a recording that is not there.
    with pytest.raises(LabError, match="voltage_peaks: every recording_id is an analysed recording's"):
        publish(lab, Changes(insertions=[{"voltage_peaks": [{"recording_id": "nobody", "peak_kv": 1.0}]}]))

    # A recording that is read again has its new rows, and not its old ones too.
    (raw / "rigs").mkdir()
    (raw / "rigs" / "rig-a.toml").write_text(RIG)
    nightly([raw], lab, jobs=0)
    assert dict(select(lab, "SELECT recording_id, peak_kv FROM voltage_peaks")) == found
    assert select(lab, "SELECT count(*) FROM voltage_peaks") == [(2,)]

    # A recording that is forgotten takes them with it.
    (raw / "L-0.mcap").unlink()
    nightly([raw], lab, jobs=0)
    prune(lab, Rule(gone=True), datetime.now(UTC))
    assert [name for name, _ in select(lab, "SELECT * FROM voltage_peaks")] == ["L-1"]
    assert healthy(lab) == []
