"""One specimen's session: its recordings' features, and those of the calibrations of its rigs, to a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import timedelta

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.diagnosis_tables import comparison_tables, diagnosis_tables, undiagnosed_tables
from pipeline.analyse.inputs import Measured
from pipeline.analyse.session_features import SessionFeatures
from pipeline.analyse.single_diagnosis import diagnose_single
from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.encode import unpack
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.results import NONE, Diagnosis
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.protocols import CALIBRATION


def analyse_diagnosis(specimen_id: str, recordings: Sequence[Measured], calibrations: Sequence[Measured]) -> Analysis:
    """What the simulation of a specimen gets wrong, and why; the reasons where it cannot be asked."""
    analysis = Analysis()
    session, refused = session_of(specimen_id, recordings, calibrations)
    analysis.note([f"diagnosis: {reason}" for reason in refused])
    if all(isinstance(r.metadata, RecordingMetadata) and r.metadata.loading == CALIBRATION for r in recordings):
        return analysis  # a clamp under its own name is no specimen
    told = len(analysis.missing)
    single = analysis.attempt("diagnosis", diagnose_single, specimen_id, recordings)
    lacking = [reason.removeprefix("diagnosis: ") for reason in analysis.missing[told:]]
    if single is not None:
        analysis.add(comparison_tables(*single))
        return analysis
    found = analysis.attempt("diagnosis", _asked, session, refused)
    unheard = _find_unheard(recordings)
    if isinstance(found, Diagnosis) and found.verdict == NONE and unheard:
        analysis.add(undiagnosed_tables(specimen_id, [*unheard, *found.could_not_ask, *refused]))
    elif isinstance(found, Diagnosis):
        whole = replace(found, could_not_ask=(*found.could_not_ask, *refused))
        analysis.add(diagnosis_tables(whole, session))
    elif found is not None:
        analysis.add(undiagnosed_tables(specimen_id, lacking or found))
    return analysis


def _find_unheard(recordings: Sequence[Measured]) -> list[str]:
    """Why no response of the film stands above the noise, where that is so of all its recordings: then nothing else does either.

    A simulation is right within any noise that is large enough, which says nothing of the film.
    """
    kept = [(one.recording_id, features) for one in recordings for features in one.of(SessionFeatures)]
    if not kept or not all(features.unanswered for _, features in kept):
        return []
    return [f"{name}: its response is refused, so that nothing can be said of it: {f.unanswered}" for name, f in kept]


_STILL_COUNTS = timedelta(days=7)
"""Time after a specimen's last recording in which a calibration is still one of its rig: a diagnosis may have asked for it."""


def session_of(
    specimen_id: str, recordings: Sequence[Measured], calibrations: Sequence[Measured]
) -> tuple[list[RecordingFeatures], list[str]]:
    """Features of the specimen's recordings and of the calibrations of its rigs, and why others have none.

    Calibrations are measurements of the session like any other, so rigs stay as their files have them: sharpened
    constants would count them twice. They are taken as made while the specimen was measured, since their age says nothing
    about the film; those made long after its last recording are left out.
    """
    features: list[RecordingFeatures] = []
    without: dict[str, list[str]] = {}
    for one in recordings:
        found = _features(one)
        if isinstance(found, RecordingFeatures):
            features.append(found)
        else:
            without.setdefault(found, []).append(one.recording_id)
    refused = [f"{_some(names)}: {reason}" for reason, names in without.items()]
    if not features:
        return [], refused
    first, last = min(f.started_at for f in features), max(f.started_at for f in features)
    own = {f.recording_id for f in features}
    clamps = {_clamp(f.rig) for f in features}
    for one in calibrations:
        found = _features(one)
        if one.recording_id in own or isinstance(found, str):
            continue
        if found.started_at <= last + _STILL_COUNTS and _clamp(found.rig) in clamps:
            started = min(max(found.started_at, first), last)
            features.append(replace(found, specimen_id=specimen_id, started_at=started))
    return features, refused


def _clamp(rig: RigConstants) -> tuple[float | None, ...]:
    """What a calibration is about: a clamp of another mass on the same rig is another clamp."""
    return rig.clamp_mass_kg, rig.load_cell_stiffness_n_per_mm, rig.load_cell_damping_n_s_per_mm


def _features(one: Measured) -> RecordingFeatures | str:
    """The features of a recording, or why there are none."""
    kept = one.of(SessionFeatures)
    if not kept:
        about = one.metadata
        what = f"{about.loading} {about.protocol}" if isinstance(about, RecordingMetadata) else "table"
        return f"{'an' if what[0] in 'aeiou' else 'a'} {what} is not simulated"
    return kept[0].refused or unpack(kept[0].content)


_NAMED = 3
"""Recordings that are named before the others are counted."""


def _some(names: Sequence[str]) -> str:
    """Names of recordings, the first few of many."""
    more = len(names) - _NAMED
    return ", ".join(names) if more <= 1 else f"{', '.join(names[:_NAMED])} and {more} more"


def _asked(session: Sequence[RecordingFeatures], refused: Sequence[str]) -> Diagnosis | list[str]:
    """The diagnosis, or the reasons why there is none."""
    if not session:
        return [*refused, "no recording of this specimen can be simulated"]
    try:
        return diagnose(session)
    except NotIdentifiableError as error:
        return [error.shortcoming, *refused]
