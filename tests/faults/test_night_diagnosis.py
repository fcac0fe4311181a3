"""A night over a session with an effect hidden in it: found, told, stored, and taken back when its recordings go."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import duckdb
import pytest

from pipeline import Lab
from pipeline.cli import main
from pipeline.lab.annotations import annotate
from pipeline.nightly.night import nightly
from tests.helpers.session_files import write_recordings
from tests.helpers.truth_rig import Session, make_session

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

DESIGNS = (
    {"protocol": "chirp", "strain_pp": 0.006},
    {"protocol": "sphs", "drive_kv": 4.0},
    {"protocol": "sphs", "drive_kv": 7.0},
    {"protocol": "step", "loading": "electrical", "drive_kv": 7.0},
    {"protocol": "tap"},
    {"protocol": "chirp", "strain_pp": 0.006},
)
EFFECT, SEVERITY = "field_dependent_permittivity", 0.2
FORM = 0.4
"""Relative difference of a severity for the form of the truth, which is not that of the extension (see `tests.helpers.truth_rig`)."""


def write(folder: Path, session: Session, name: str, count: int | None = None) -> None:
    """The session's recordings as those of a specimen of that name; the tap belongs to its rig alone."""
    chosen = []
    for i, recording in enumerate(session.recordings[:count]):
        metadata = replace(recording.metadata, recording_id=f"{name}-{i}", specimen_id=name)
        if metadata.protocol == "tap":
            metadata = replace(metadata, specimen_id=f"{name}-clamp")
        chosen.append(replace(recording, metadata=metadata))
    write_recordings(folder / name, chosen)


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Lab]:
    folder = tmp_path_factory.mktemp("session")
    raw, lab = folder / "raw", Lab(folder / "lab")
    write(raw, make_session(5, DESIGNS, [(EFFECT, SEVERITY)], material="silicone"), "H-1")
    voltage_only = make_session(
        6, ({"protocol": "step", "loading": "electrical", "drive_kv": 7.0},), material="silicone"
    )
    write(raw, voltage_only, "H-2")
    summary = nightly([raw], lab, jobs=0)
    assert summary.exit_status == 0, summary.attention
    return raw, lab


def select(lab: Lab, query: str) -> list[Any]:
    with duckdb.connect(str(lab.database), read_only=True) as connection:
        return connection.sql(query).fetchall()


def test_the_hidden_effect_is_named_with_its_size_and_the_tap_joins_the_session(night: tuple[Path, Lab]) -> None:
    _, lab = night
    ((verdict, mechanisms, severity, recordings, gain, before, after),) = select(
        lab,
        "SELECT verdict, mechanisms, severity, recordings, gain, held_out_error_before, held_out_error_after"
        " FROM diagnoses WHERE specimen_id = 'H-1'",
    )
    assert (verdict, mechanisms) == ("named", [EFFECT])
    found = json.loads(severity)[EFFECT]["fraction"]
    assert abs(found["value"] / SEVERITY - 1) < FORM
    assert recordings == len(DESIGNS)
    assert gain > 0.8
    assert after < before


def test_all_tables_of_the_diagnosis_are_filled(night: tuple[Path, Lab]) -> None:
    _, lab = night
    ((extension, loading, selected),) = select(
        lab, "SELECT extension, loading, selected FROM model_fits WHERE extension <> '' AND specimen_id = 'H-1'"
    )
    assert (extension, loading, selected) == (EFFECT, "joint", False)
    ((extended,),) = select(lab, "SELECT count(*) FROM best_models WHERE extension <> ''")
    assert extended == 0, "the fit to use stays the plain one"
    for table in (
        "discrepancies",
        "diagnosis_candidates",
        "diagnosis_parameters",
        "diagnosis_blocks",
        "diagnosis_curves",
    ):
        ((rows,),) = select(lab, f"SELECT count(*) FROM {table} WHERE specimen_id = 'H-1'")
        assert rows, table
    ((first,),) = select(
        lab, "SELECT arg_max(mechanism, probability) FROM diagnosis_candidates WHERE specimen_id = 'H-1'"
    )
    assert first == EFFECT
    worst = select(lab, "SELECT recording_id FROM diagnosis_blocks ORDER BY plain_rms DESC LIMIT 1")
    assert worst[0][0] in {"H-1-1", "H-1-2", "H-1-3"}


def test_recordings_that_cannot_be_asked_leave_a_row_with_the_reason(night: tuple[Path, Lab]) -> None:
    _, lab = night
    rows = dict(select(lab, "SELECT specimen_id, (verdict, could_not_ask) FROM diagnoses"))
    assert rows.keys() == {"H-1", "H-2"}, "a rig's calibrations alone are no specimen to diagnose"
    verdict, reasons = rows["H-2"]
    assert reasons
    assert verdict in (None, "none", "unknown", "ambiguous", "named")


def test_the_command_and_the_pages_tell_it(night: tuple[Path, Lab], capsys: pytest.CaptureFixture[str]) -> None:
    _, lab = night
    assert main(["diagnose", "H-1", "--lab", str(lab.folder)]) == 0
    text = capsys.readouterr().out
    assert text.startswith("● H-1: the permittivity falls with the field, by ")
    assert "What the simulation gets wrong" in text
    assert main(["diagnose", "--format", "json", "--lab", str(lab.folder)]) == 0
    assert [d["specimen_id"] for d in json.loads(capsys.readouterr().out)] == ["H-1", "H-2"]
    page = (lab.reports / "specimens" / "H-1.html").read_text(encoding="utf-8")
    for part in ("What the simulation gets wrong", "Measured against simulated", "Why: the causes, ranked", "What the extension gains"):  # fmt: skip
        assert part in page
    assert "diagnosed" in (lab.reports / "index.html").read_text(encoding="utf-8")


def test_it_is_made_again_only_when_its_recordings_change_and_goes_with_them(night: tuple[Path, Lab]) -> None:
    raw, lab = night
    before = select(lab, "SELECT item_id, run_id FROM items ORDER BY ALL")
    nightly([raw], lab, jobs=0)
    assert select(lab, "SELECT item_id, run_id FROM items ORDER BY ALL") == before
    annotate(lab, "H-2-0", "exclude", "not of this film")
    nightly([raw], lab, jobs=0)
    assert select(lab, "SELECT specimen_id FROM diagnoses") == [("H-1",)]
    assert dict(select(lab, "SELECT item_id, run_id FROM items"))["diagnosis:H-1"] == dict(before)["diagnosis:H-1"]
