"""Why a system has no diagnosis is said in the words of what its records lack."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.analyse import diagnosed_alone as alone
from pipeline.analyse.diagnosis import analyse_diagnosis
from pipeline.analyse.inputs import Measured
from pipeline.analyse.session_features import SYSTEM, SessionFeatures
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants


def recorded() -> Measured:
    """A chirp of a lag."""
    about = RecordingMetadata.parse(
        {
            "recording_id": "r1", "protocol": "chirp", "loading": "other", "specimen_id": "S-1",
            "started_at": "2026-03-01T12:00:00+00:00",
        },
        where="r1",
    )  # fmt: skip
    kept = SessionFeatures.__new__(SessionFeatures)
    given = {"interval_s": 0.01, "periodic": 0.0}
    values = np.zeros(4)
    object.__setattr__(
        kept, "alone", SimpleNamespace(kind=SYSTEM, given=given, channels={"input": values, "output": values}, unit="1")
    )
    results: list[Any] = [kept]
    object.__setattr__(kept, "refused", "other chirp recordings are not simulated")
    return Measured(about, RigConstants(), tuple(results))


def test_the_row_says_why_a_system_has_no_diagnosis_and_not_that_it_is_not_simulated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise NotIdentifiableError("the record is too short", where="S-1", expected="a longer one")

    monkeypatch.setattr(alone, "diagnose_system", refuse)
    tables = analyse_diagnosis("S-1", [recorded()], []).tables
    (row,) = tables["diagnoses"][0].to_pylist()
    assert row["verdict"] is None
    (reason,) = row["could_not_ask"]
    assert "the record is too short" in reason
