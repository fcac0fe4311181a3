"""Which recordings make the session of a diagnosis, and what is said where there is none."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest

from pipeline.analyse.diagnosis import analyse_diagnosis, session_of
from pipeline.analyse.inputs import Measured
from pipeline.analyse.recording import session_features
from pipeline.analyse.session_features import SessionFeatures
from schemas.metadata import TableMetadata
from schemas.recording import Recording
from tests.helpers.truth_rig import make_session

DESIGNS = (
    {"protocol": "chirp", "sweep_s": 3.0, "repeats": 1},
    {"protocol": "tap"},
    {"protocol": "cyclic", "cycles": 4},
)


@pytest.fixture(scope="module")
def recorded() -> dict[str, Measured]:
    """A sweep, a tap after it, and cycles."""
    recordings = make_session(9, DESIGNS, material="silicone").recordings
    return {r.metadata.protocol: measured(r) for r in recordings}


def measured(recording: Recording) -> Measured:
    return Measured(recording.metadata, recording.rig, (session_features(recording),))


def at(one: Measured, days: float, **more: Any) -> Measured:
    """The same recording, reduced again as if it had been made so many days later."""
    (features,) = one.of(SessionFeatures)
    from pipeline.diagnose.features.encode import pack, unpack

    found = unpack(features.content)
    moved = replace(found, started_at=found.started_at + timedelta(days=days), **more)
    return replace(one, results=(SessionFeatures(pack(moved)),))


@pytest.mark.slow
def test_a_tap_of_the_rig_joins_as_a_recording_of_the_specimen_and_its_age_does_not_count(recorded: Any) -> None:
    own = [recorded["chirp"], recorded["cyclic"]]
    features, refused = session_of("S-9", own, [at(recorded["tap"], -400, specimen_id="clamp")])
    assert refused == []
    assert [f.protocol for f in features] == ["chirp", "cyclic", "tap"]
    tap = features[-1]
    assert tap.specimen_id == "S-9"
    assert tap.started_at == features[0].started_at


def test_a_tap_that_a_diagnosis_asked_for_counts_after_the_last_recording(recorded: Any) -> None:
    features, _ = session_of("S-9", [recorded["chirp"], recorded["cyclic"]], [at(recorded["tap"], 2)])
    assert [f.protocol for f in features] == ["chirp", "cyclic", "tap"]
    assert features[-1].started_at == features[-2].started_at


def test_a_tap_is_not_taken_twice_nor_from_long_after_nor_from_another_clamp(recorded: Any) -> None:
    own = [recorded["chirp"], recorded["tap"], recorded["cyclic"]]
    features, _ = session_of("S-9", own, [recorded["tap"]])
    assert len(features) == 3
    later = at(recorded["tap"], 8, recording_id="tap-2")
    heavier = at(
        recorded["tap"], -1, recording_id="tap-3", rig=replace(recorded["tap"].rig, clamp_mass_kg=9.0)
    )  # fmt: skip
    features, _ = session_of("S-9", [recorded["chirp"], recorded["cyclic"]], [later, heavier])
    assert [f.protocol for f in features] == ["chirp", "cyclic"]


def test_reasons_of_recordings_without_features_are_kept(recorded: Any) -> None:
    silent = replace(recorded["chirp"], results=(SessionFeatures("", "the record is too short"),))
    table = Measured(TableMetadata(recording_id="dma"), recorded["chirp"].rig, ())
    stepped = replace(recorded["cyclic"], results=())
    analysis = analyse_diagnosis("S-9", [silent, table, stepped], [])
    (row,) = analysis.joined()["diagnoses"].to_pylist()
    assert row["verdict"] is None
    reasons = " ".join(row["could_not_ask"])
    assert "the record is too short" in reasons
    assert "dma: a table is not simulated" in reasons
    assert "a mechanical cyclic is not simulated" in reasons
    assert analysis.failures == []


def test_recordings_without_features_for_one_reason_are_told_together(recorded: Any) -> None:
    one = replace(recorded["cyclic"], results=())
    electrical = [
        replace(
            one, metadata=replace(one.metadata, recording_id=f"coat-{i}", loading="electrical", protocol="coverage")
        )
        for i in range(12)
    ]
    features, refused = session_of("S-9", electrical, [])
    assert features == []
    assert refused == ["coat-0, coat-1, coat-2 and 9 more: an electrical coverage is not simulated"]
    assert session_of("S-9", electrical[:4], [])[1][0].startswith("coat-0, coat-1, coat-2, coat-3: ")


def test_a_clamp_under_a_name_of_its_own_is_no_specimen(recorded: Any) -> None:
    assert analyse_diagnosis("clamp", [recorded["tap"]], []).joined() == {}


def test_what_a_recording_lacks_is_said_with_what_is_needed(recorded: Any) -> None:
    cycles = make_session(9, DESIGNS, material="silicone").recordings[2]
    (frequency,) = {cycles.metadata.frequency_hz}
    assert frequency is not None
    stamps = next(iter(cycles.channels.values())).time_ns
    every = int(1e9 / (6 * frequency * (stamps[1] - stamps[0])))  # about six samples in a cycle
    few = {q: replace(c, time_ns=c.time_ns[::every], values=c.values[::every]) for q, c in cycles.channels.items()}
    (features,) = measured(replace(cycles, channels=few)).of(SessionFeatures)
    assert "samples in a cycle" in features.refused
    assert features.refused.endswith("needed: at least 10")
