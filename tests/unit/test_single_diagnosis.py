"""Why a system has no diagnosis is said in the words of what its records lack."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.analyse import single_diagnosis
from pipeline.analyse.diagnosis import analyse_diagnosis
from pipeline.analyse.inputs import Measured
from pipeline.analyse.recording import analyse_recording
from pipeline.analyse.session_features import SYSTEM, SessionFeatures
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording


def recorded(unanswered: str = "") -> Measured:
    """A chirp of a lag; `unanswered`: why its response is refused."""
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
        kept,
        "single",
        SimpleNamespace(kind=SYSTEM, given=given, channels={"input": values, "output": values}, unit="1"),
    )
    results: list[Any] = [kept]
    object.__setattr__(kept, "refused", "other chirp recordings are not simulated")
    object.__setattr__(kept, "unanswered", unanswered)
    return Measured(about, RigConstants(), tuple(results))


def test_the_row_says_why_a_system_has_no_diagnosis_and_not_that_it_is_not_simulated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise NotIdentifiableError("the record is too short", where="S-1", expected="a longer one")

    monkeypatch.setattr(single_diagnosis, "diagnose_system", refuse)
    tables = analyse_diagnosis("S-1", [recorded()], []).tables
    (row,) = tables["diagnoses"][0].to_pylist()
    assert row["verdict"] is None
    (reason,) = row["could_not_ask"]
    assert "the record is too short" in reason


@pytest.mark.parametrize(
    ("verdict", "unanswered", "refused"),
    [
        ("named", "the sweep stops early", True),
        ("ambiguous", "the sweep stops early", True),
        ("named", "", False),
        ("unknown", "the sweep stops early", False),
        ("none", "the sweep stops early", False),
    ],
)
def test_no_cause_rests_on_a_refused_response(
    monkeypatch: pytest.MonkeyPatch, verdict: str, unanswered: str, refused: bool
) -> None:
    monkeypatch.setattr(single_diagnosis, "diagnose_system", lambda *_: (SimpleNamespace(verdict=verdict), None))
    if refused:
        with pytest.raises(NotIdentifiableError, match=r"the response of r1 is refused.*stops early"):
            single_diagnosis.diagnose_single("S-1", [recorded(unanswered)])
    else:
        found = single_diagnosis.diagnose_single("S-1", [recorded(unanswered)])
        assert found is not None
        assert found[0].verdict == verdict


def _sweep(seconds: float) -> Recording:
    """A chirp of a lag that should last 20 s, recorded for `seconds`."""
    time = np.arange(0, seconds, 0.005)
    given = np.sin(2 * np.pi * 0.5 * 20 / np.log(20) * (20 ** (time / 20) - 1))
    answer = np.zeros_like(given)
    for i in range(1, given.size):
        answer[i] = answer[i - 1] + 0.1 * (given[i - 1] - answer[i - 1])
    ns = np.round(time * 1e9).astype(np.int64)
    about = RecordingMetadata.parse(
        {
            "recording_id": "r1", "protocol": "chirp", "loading": "other", "specimen_id": "S-1",
            "started_at": "2026-03-01T12:00:00+00:00",
            "frequency_start_hz": 0.5, "frequency_stop_hz": 10.0, "sweep": "log",
        },
        where="r1",
    )  # fmt: skip
    channels = {"input": Channel("input", ns, given, unit="V"), "output": Channel("output", ns, answer, unit="mm")}
    return Recording(about, RigConstants(), channels)


@pytest.mark.parametrize("seconds", [20.0, 0.5])
def test_the_stage_of_a_recording_says_that_its_response_is_refused(seconds: float) -> None:
    (kept,) = [one for one in analyse_recording(_sweep(seconds)).carried if isinstance(one, SessionFeatures)]
    assert bool(kept.unanswered) == (seconds < 1)
