"""No cause is named from a system's record whose frequency response is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.analyse import diagnosed_alone as alone
from pipeline.analyse.diagnosis import analyse_diagnosis
from pipeline.analyse.inputs import Measured
from pipeline.analyse.session_features import SYSTEM, SessionFeatures
from pipeline.transform.response import FrequencyResponse
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants


def recorded(usable: bool | None) -> Measured:
    """A chirp of a lag; `usable`: of the lines of its response, None for a response that was refused."""
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
    if usable is not None:
        response = FrequencyResponse.__new__(FrequencyResponse)
        object.__setattr__(response, "usable", np.array([False, usable]))
        results.append(response)
    return Measured(about, RigConstants(), tuple(results))


@pytest.mark.parametrize(
    ("verdict", "usable", "refused"),
    [
        ("named", None, True),
        ("named", False, True),
        ("ambiguous", None, True),
        ("named", True, False),
        ("none", None, False),
    ],
)
def test_a_refused_response_names_nothing(
    monkeypatch: pytest.MonkeyPatch, verdict: str, usable: bool | None, refused: bool
) -> None:
    monkeypatch.setattr(alone, "diagnose_system", lambda *_: (SimpleNamespace(verdict=verdict), None))
    if refused:
        with pytest.raises(NotIdentifiableError, match="the response of r1 is refused"):
            alone.diagnosed_alone("S-1", [recorded(usable)])
    else:
        found = alone.diagnosed_alone("S-1", [recorded(usable)])
        assert found is not None
        assert found[0].verdict == verdict


def test_the_row_says_why_a_system_has_no_diagnosis_and_not_that_it_is_not_simulated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(alone, "diagnose_system", lambda *_: (SimpleNamespace(verdict="named"), None))
    tables = analyse_diagnosis("S-1", [recorded(None)], []).tables
    (row,) = tables["diagnoses"][0].to_pylist()
    assert row["verdict"] is None
    (reason,) = row["could_not_ask"]
    assert "the response of r1 is refused" in reason
