"""Diagnosis of a specimen whose records are asked without a session: one large cycle, or the records of a system.

Apart from `single`, which the stage of a recording uses: a change of how causes are found must not repeat that stage.
"""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.analyse.cycle import section_over_length_mm
from pipeline.analyse.inputs import Measured
from pipeline.analyse.session_features import CYCLE, SYSTEM, SessionFeatures
from pipeline.diagnose.results import AMBIGUOUS, NAMED, Diagnosis
from pipeline.diagnose.single.comparison import Comparison
from pipeline.diagnose.single.cycle_diagnosis import diagnose_cycle
from pipeline.diagnose.single.cycle_model import make_cycle
from pipeline.diagnose.single.oscillator import SystemRecord
from pipeline.diagnose.single.system_diagnosis import diagnose_system
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata


def diagnose_single(specimen_id: str, recordings: Sequence[Measured]) -> tuple[Diagnosis, Comparison] | None:
    """The diagnosis of a specimen whose records can be asked alone: one large cycle, or those of a system.

    None for others.

    Raises `NotIdentifiableError` where the records do not carry it, and where a cause would rest on a test whose response is refused.
    """
    tests = [r for r in recordings if isinstance(r.metadata, RecordingMetadata)]
    asked = [(r, kept.single) for r in tests for kept in r.of(SessionFeatures) if kept.single is not None]
    kinds = {single.kind for _, single in asked}
    if len(asked) == len(tests) == 1 and kinds == {CYCLE}:
        ((recording, single),) = asked
        c, law = single.channels, single.given or None
        about = recording.metadata
        cycle = make_cycle(
            c["time_s"],
            c["stretch"],
            c["stress"],
            law,
            recording.recording_id,
            specimen_id,
            section_over_length_mm=section_over_length_mm(about) if isinstance(about, RecordingMetadata) else None,
        )
        return diagnose_cycle(cycle)
    if kinds != {SYSTEM} or len({round(single.given["interval_s"], 12) for _, single in asked}) != 1:
        return None
    records = [
        SystemRecord(
            r.recording_id,
            single.channels["input"],
            single.channels["output"],
            single.given["interval_s"],
            periodic=bool(single.given["periodic"]),
        )
        for r, single in asked
    ]
    protocols = [r.metadata.protocol for r, _ in asked if isinstance(r.metadata, RecordingMetadata)]
    found, comparison = diagnose_system(specimen_id, records, protocols, asked[0][1].unit)
    if found.verdict in (NAMED, AMBIGUOUS):
        _demand_responses(specimen_id, tests)
    return found, comparison


def _demand_responses(specimen_id: str, tests: Sequence[Measured]) -> None:
    refused = [(r.recording_id, kept.unanswered) for r in tests for kept in r.of(SessionFeatures) if kept.unanswered]
    if refused:
        first, reason = refused[0]
        others = f" (and of {len(refused) - 1} more)" if len(refused) > 1 else ""
        raise NotIdentifiableError(
            f"the response of {first}{others} is refused, so no cause is named from it: {reason}",
            where=specimen_id,
            expected="records from which a frequency response can be computed",
        )
