"""Recordings first: the session without what is wrong with its recordings, and what that is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pipeline.diagnose.faults.agreement import (
    Agreement,
    agrees,
    count_chi2,
    find_agreement,
    leave_out,
    measure_left,
    miss,
    refit_rest,
    sum_by_recording,
)
from pipeline.diagnose.faults.another_film import Change, Doubt, doubt_change, doubt_film
from pipeline.diagnose.faults.another_rig import find_another_rig
from pipeline.diagnose.faults.change import find_change, merge_foreign
from pipeline.diagnose.faults.clock import find_late
from pipeline.diagnose.faults.correct import list_corrections
from pipeline.diagnose.faults.fault import DEAD_CHANNEL, STRAIN_WRONG, Fault
from pipeline.diagnose.faults.fitted import Fitted, assemble_session, fit_session
from pipeline.diagnose.faults.hypotheses import MECHANISM, SOUND, Judged, Mechanisms, judge_hypotheses
from pipeline.diagnose.faults.levels import Levels, name_clamp, read_levels
from pipeline.diagnose.faults.peers import has_peer, list_peers
from pipeline.diagnose.faults.predict import Suspect
from pipeline.diagnose.faults.session_wide import (
    find_contradicting_lengths,
    find_contradicting_units,
    find_stated_by_all,
    find_swapped_in_all,
    find_wrong_file,
    find_wrong_sizes,
    is_off,
    judge_taps,
    merge_lengths,
)
from pipeline.diagnose.features.kinds import EXTRA_MASS, RING_HZ, RecordingFeatures
from pipeline.diagnose.mechanisms.sensor import GAIN_ERROR
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.plain_fit import PlainFit, compute_residuals, fit_plain
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from schemas.errors import NotIdentifiableError
from schemas.protocols import CALIBRATION

_EXPECTED = Mechanisms(0.5 * RULES.fault.mechanism, as_film=0.5 * RULES.fault.mechanism)
"""Of a recording like which there is no other, or of all that there are."""
_EACH_WAY = RULES.fault.mechanism / 3
"""The probability of a mechanism, shared by the three ways in which it may show in an electrical test."""
_LAGGING = Mechanisms(_EACH_WAY, as_film=_EACH_WAY, as_delay=_EACH_WAY)
"""The same of electrical tests, which alone are late where the drive lags."""
_EVIDENT = Mechanisms(0.25, as_film=0.25, as_scale=0.25, as_delay=0.25)
"""Where other recordings show one: in which of the ways is as likely as in another."""
_AT_WORK = Mechanisms(0.25)
"""The same beside a recording like it that agrees with the others: as another film, a factor or a delay it would show there as well, but
the film may have been strained, driven or warmed since."""


@dataclass(frozen=True)
class Checked:
    """A session whose recordings are sound, or as sound as can be told, with its plain fit, and the faults that were found.

    Parameters
    ----------
    doubts : recordings in the session that may be those of another film, or show what a mechanism does to this one
    change : what is said among the faults of all recordings from one on, and a mechanism may do to them as well
    """

    session: Session
    simulation: Simulation
    plain: PlainFit
    faults: tuple[Fault, ...]
    doubts: tuple[Doubt, ...] = ()
    change: Change | None = None

    @property
    def is_barred(self) -> bool:
        """Whether no mechanism can be asked before a fault is put right."""
        return any(f.bars for f in self.faults)


def check_recordings(recordings: Sequence[RecordingFeatures]) -> Checked:
    """The session of one specimen without the recordings that have a fault of their own, fitted, with what was found.

    Raises `NotIdentifiableError` where the recordings cannot be asked at all.
    """
    taps = [r for r in recordings if RING_HZ in r.values]
    recordings = [r for r in recordings if RING_HZ not in r.values]
    swapped = find_swapped_in_all(recordings)
    if swapped is not None:
        return Checked(*fit_session(recordings), (swapped,))
    levels = _read(recordings)
    recordings, found = find_stated_by_all(recordings, levels)
    units = find_contradicting_units(recordings)
    found += [] if units is None else [units]
    if any(f.bars for f in found):
        return Checked(*fit_session(recordings), tuple(found))
    explained = frozenset(id for f in found for id in f.recordings)
    lengths = find_contradicting_lengths(recordings) if not found else None
    found += [] if lengths is None else [lengths]
    odd = suspects = _list_odd(levels) - explained
    if 2 * len(odd) >= len(recordings):
        suspects = frozenset()  # what most recordings have in common is asked of all of them
    fitted = _fit(recordings, suspects)
    if fitted is None:
        suspects, fitted = frozenset(), fit_session(recordings)
    # With a wrong rig's file recordings seem to miss each other: it is asked before any of them.
    filed = find_wrong_file(recordings, fitted, suspects)
    if filed is not None:
        recordings, fitted, _ = filed
    fault = judge_taps(taps, recordings, fitted) if filed is None else filed[2]
    if fault is not None:
        found.append(fault)
        if fault.bars:
            return Checked(*fitted, tuple(found))
    # What all of them have, or all of one kind, makes each seem to have a fault of its own.
    late = find_late(recordings, fitted, suspects) if is_off(fitted[0], fitted[2]) else None
    if late is not None:
        recordings, fitted, fault = late
        found.append(fault)
    outside, agreement = _find_outside(*fitted)
    change, doubted = _find_another_from_one_on(recordings, fitted, agreement, suspects)
    if 2 * len(outside) > len(fitted[0].recordings):
        outside, agreement = frozenset(), None  # what most of them miss is no film that the others have
    if change is not None:
        found.append(change)
        # What is odd is so beside others of before the change, or of after it.
        recordings = [r for r in recordings if r.recording_id not in change.recordings]
        levels = _read(recordings)
        odd = suspects = _list_odd(levels) - explained
        outside, agreement = frozenset(), None
        fitted = _fit(recordings, suspects, near=fitted[2]) or fitted
    doubts: list[Doubt] = []
    if odd or outside:
        faults, doubts = _judge_each(recordings, levels, fitted, agreement, odd, outside)
        of_all = assemble_session(recordings) if suspects else fitted[0]
        found = merge_foreign([*found, *faults], of_all, [id for d in doubts for id in d.recordings])
        told = {id for f in found for id in f.recordings}
        doubts = [d for d in doubts if not told.issuperset(d.recordings)]
    culprits = frozenset(id for f in found for id in f.recordings if f.sets_aside)
    asked = {r.recording_id for r in recordings}
    if culprits & asked != asked - {r.recording_id for r in fitted[0].recordings}:
        fitted = _fit(recordings, culprits, near=fitted[2]) or fitted
    if not culprits:
        sizes = find_wrong_sizes(fitted)
        found += [] if sizes is None else [sizes]
    return Checked(*fitted, tuple(merge_lengths(found)), tuple(doubts), doubted)


def _read(recordings: Sequence[RecordingFeatures]) -> dict[str, Levels]:
    """Levels of each recording; calibrations have none."""
    tests = [r for r in recordings if r.loading != CALIBRATION]
    known = dict(zip((r.recording_id for r in tests), read_levels(tests), strict=True))
    return {r.recording_id: known.get(r.recording_id, Levels({}, False, 0.0, {})) for r in recordings}


def _list_odd(levels: Mapping[str, Levels]) -> frozenset[str]:
    """Recordings whose levels are not those of the others."""
    return frozenset(id for id, own in levels.items() if own.is_suspect)


def _refit(recordings: Sequence[RecordingFeatures], near: PlainFit | None) -> Fitted:
    if near is None:
        return fit_session(recordings)
    session = assemble_session(recordings)
    simulation = Simulation(session)
    model = session.base_model(near.model.arms)
    if model.names != near.model.names:
        return session, simulation, fit_plain(session, simulation)
    return session, simulation, refit_rest(session, simulation, near)


def _fit(
    recordings: Sequence[RecordingFeatures], without: frozenset[str], near: PlainFit | None = None
) -> Fitted | None:
    """The session without some recordings, None where the others cannot be asked."""
    try:
        return _refit([r for r in recordings if r.recording_id not in without], near)
    except NotIdentifiableError:
        return None


def _find_outside(session: Session, simulation: Simulation, plain: PlainFit) -> tuple[frozenset[str], Agreement | None]:
    """Recordings that miss the film and the rig that the others agree on."""
    chi2, size = sum_by_recording(session, plain.misfit)
    if not miss(chi2, size, 1.0).any():
        return frozenset(), None
    found = find_agreement(session, simulation, plain)
    if not found.outside.any():
        return frozenset(), None
    names = [r.recording_id for r in session.recordings]
    return frozenset(n for n, out in zip(names, found.outside, strict=True) if out), found


def _find_another_from_one_on(
    recordings: Sequence[RecordingFeatures], fitted: Fitted, agreement: Agreement | None, suspects: frozenset[str]
) -> tuple[Fault | None, Change | None]:
    """A rig or a film that was another from one recording on; with a change that the search for causes has to be asked about."""
    other_rig = None if agreement is None else find_another_rig(*fitted[:2], agreement)
    if other_rig is not None or (agreement is None and len(suspects) <= 1):
        return other_rig, None
    change = _ask_change(recordings, fitted, agreement, suspects)
    if change is None or agreement is None or suspects:
        return change, None
    return change, _doubt_change(change, fitted, agreement)


def _ask_change(
    recordings: Sequence[RecordingFeatures], fitted: Fitted, agreement: Agreement | None, suspects: frozenset[str]
) -> Fault | None:
    """A film that was another from one recording on."""
    session, simulation, plain = fitted
    near = plain if agreement is None else agreement.fit
    if suspects:
        session = assemble_session(recordings)
        if session.base_model(near.model.arms).names != near.model.names:
            return None
        simulation = Simulation(session)
    misfit = compute_residuals(session, simulation, near.model, near.theta[None])[0]
    chi2 = min(count_chi2(session, m) for m in ([misfit] if suspects else [misfit, plain.misfit]))
    change = find_change(session, simulation, near, chi2)
    if change is not None and agreement is not None and not suspects and agreement.outside.sum() == 1:
        # A fault of the one recording that misses the others would leave as much of it as the noise does.
        inside = ~agreement.outside
        left = measure_left(session, agreement.chi2[inside].sum() + agreement.size[~inside].sum())
        return change if change.left_per_value < max(left, 1.0) * (1 + RULES.fault.form_error) else None
    return change


def _doubt_change(change: Fault, fitted: Fitted, agreement: Agreement) -> Change:
    """The change as one that the search for causes has to be asked about."""
    session, simulation, _ = fitted
    members = np.isin([r.recording_id for r in session.recordings], change.recordings)
    return doubt_change(change, fitted, leave_out(session, simulation, agreement.fit, members))


def _judge_each(
    recordings: Sequence[RecordingFeatures],
    levels: dict[str, Levels],
    first: Fitted,
    agreement: Agreement | None,
    suspects: frozenset[str],
    outside: frozenset[str],
) -> tuple[list[Fault], list[Doubt]]:
    """Faults of single recordings: of those whose levels are odd, and of those that miss the film the others agree on; and which of them may
    be of another film."""
    session, simulation, plain = first
    before = measure_left(session, count_chi2(session, plain.misfit))
    base, dispersion = plain, before
    if agreement is not None:
        base = leave_out(session, simulation, agreement.fit, agreement.outside)
        chi2, size = sum_by_recording(session, base.misfit)
        inside = ~agreement.outside
        dispersion = float(chi2[inside].sum() / max(size[inside].sum(), 1.0))
    if outside and not agrees(dispersion, before):
        outside = frozenset()  # others do not agree with each other either: no fault of one recording
    whole = assemble_session(recordings) if suspects else session
    asked = suspects | outside
    told: dict[tuple[int, ...], Fault] = {}
    doubts: dict[tuple[str, ...], Doubt] = {}

    def judge(numbers: Sequence[int], judged: Callable[[Suspect], Fault | None]) -> None:
        """Judges recordings and keeps their fault."""
        suspect = Suspect.of(whole, numbers, base, _find_rig(session, whole.recordings[numbers[0]]))
        fault = judged(suspect)
        if fault is not None:
            told[tuple(numbers)] = fault
        elif len(numbers) == 1:
            doubt = doubt_film(suspect)
            if doubt is not None:
                doubts[doubt.recordings] = doubt

    for numbers in _list_alike(whole, asked):
        judge(numbers, partial(judge_together, numbers=numbers, levels=levels))
    together = {id for f in told.values() for id in f.recordings}
    for number, recording in enumerate(whole.recordings):
        if not recording.blocks:
            told[number,] = _state_dead(recording)
        elif recording.recording_id in asked - together:
            judge((number,), partial(_judge_one, levels=levels[recording.recording_id], asked=asked))
    left = outside - {id for f in told.values() for id in f.recordings}
    if left:
        # Of what is left no fault is the reason. A mechanism is, and the others may have it as well: those like which none is without it,
        # and those of the same kind of test.
        at_work = {(r.protocol, r.loading) for r in whole.recordings if r.recording_id in left}
        before_that, told = dict(told), {}
        for numbers, fault in before_that.items():
            own = whole.recordings[numbers[0]]
            is_alone = not has_peer(own, list_peers(own, whole, asked))
            if own.blocks and (is_alone or (own.protocol, own.loading) in at_work):
                mechanisms = _EVIDENT if is_alone else _AT_WORK
                judge(numbers, partial(judge_together, numbers=numbers, levels=levels, mechanisms=mechanisms))
            else:
                told[numbers] = fault
    return list(told.values()), list(doubts.values())


def _list_alike(session: Session, asked: frozenset[str]) -> list[tuple[int, ...]]:
    """Numbers of the recordings of each kind of test on one rig of which all, and more than one, are asked: they may have a fault in common."""
    kinds: dict[tuple[str, str, int], list[int]] = {}
    for number, r in enumerate(session.recordings):
        if r.loading != CALIBRATION:
            kinds.setdefault((r.protocol, r.loading, int(session.rig[number])), []).append(number)
    return [
        tuple(numbers)
        for numbers in kinds.values()
        if len(numbers) > 1
        and all(session.recordings[n].recording_id in asked and session.recordings[n].blocks for n in numbers)
    ]


def judge_together(
    suspect: Suspect, numbers: Sequence[int], levels: dict[str, Levels], mechanisms: Mechanisms | None = None
) -> Fault | None:
    """A fault that all recordings of one kind have in common, None where none puts them right together.

    Parameters
    ----------
    suspect, numbers : the recordings, and their numbers in the session
    levels : by recording
    mechanisms : what is believed of them; None: what may be where no other recordings contradict one
    """
    if mechanisms is None:
        mechanisms = _LAGGING if suspect.is_electrical else _EXPECTED
    names = tuple(suspect.session.recordings[n].recording_id for n in numbers)
    own = [levels[name] for name in names]
    judged = judge_hypotheses(suspect, own[0], mechanisms, own[1:])
    best = judged[0][0]
    is_several = len(numbers) > 1
    if is_several and (
        best.hypothesis.predict is None or not agrees(best.chi2 / suspect.size, suspect.sound_chi2 / suspect.size)
    ):
        return None
    return _state_likely(suspect, names, judged)


def _state_dead(recording: RecordingFeatures) -> Fault:
    """The fault of a recording that no features can be made of because a channel stands still."""
    return Fault(DEAD_CHANNEL, (recording.recording_id,), 1.0, "; ".join(recording.warnings))


def _find_rig(session: Session, recording: RecordingFeatures) -> int:
    """Number in a session of the rig of a recording; of that most recordings have where it is none of them."""
    for other, number in zip(session.recordings, session.rig, strict=True):
        if name_clamp(other.rig) == name_clamp(recording.rig) and (
            other.values.get(EXTRA_MASS) == recording.values.get(EXTRA_MASS)
        ):
            return int(number)
    return int(np.bincount(session.rig).argmax())


def _judge_one(suspect: Suspect, levels: Levels, asked: frozenset[str]) -> Fault | None:
    """The fault of a recording, None where it has none or a mechanism may be at work."""
    session = suspect.session
    own = session.recordings[suspect.number]
    peers = list_peers(own, session, asked)
    is_alike = [(r.protocol, r.loading) == (own.protocol, own.loading) for r in peers]
    mechanisms = _LAGGING if suspect.is_electrical and not any(is_alike) else _EXPECTED
    if has_peer(own, peers):
        # What it does here it does in part beside: that nothing of it shows there is the less likely the more there is here.
        rare = RULES.fault.mechanism_beside_peer / float(np.sqrt(max(suspect.sound_chi2 - suspect.size, 1.0)))
        # What happens to the film shows in all that comes after.
        is_end = suspect.number == 0 or not _agrees_later(suspect.number, session, asked)
        mechanisms = Mechanisms(rare, as_scale=RULES.fault.mechanism if is_end else 0.0)
    return _state_likely(suspect, (own.recording_id,), judge_hypotheses(suspect, levels, mechanisms))


def _state_likely(suspect: Suspect, names: tuple[str, ...], judged: Sequence[tuple[Judged, float]]) -> Fault | None:
    """The fault that hypotheses with their probabilities say that some recordings have; None where they may well have none."""
    by_cause: dict[str, float] = {}
    for j, probability in judged:
        by_cause[j.hypothesis.cause] = by_cause.get(j.hypothesis.cause, 0.0) + probability
    wrong = sum(p for cause, p in by_cause.items() if cause not in (SOUND, MECHANISM, GAIN_ERROR.id))
    if wrong < RULES.fault.named:
        return None
    likely = [(j, p) for j, p in judged if j.hypothesis.cause not in (SOUND, MECHANISM, GAIN_ERROR.id)]
    best: Judged = likely[0][0]
    cause = best.hypothesis.cause
    recordings = [r for r in suspect.session.recordings if r.recording_id in names]
    corrections = [
        c for j, p in likely if p > 0.01 for own in recordings for c in list_corrections(own, j.hypothesis, p)
    ]
    return Fault(
        cause=cause,
        recordings=names,
        probability=by_cause[cause],
        finding=best.hypothesis.detail,
        corrections=tuple(corrections),
        sets_aside=cause != STRAIN_WRONG,
        left_per_value=best.chi2 / suspect.size
        if suspect.size and best.hypothesis.predict is not None
        else float("nan"),
    )


def _agrees_later(number: int, session: Session, asked: frozenset[str]) -> bool:
    """Whether a recording of the same loading that comes after this one agrees with the others."""
    own = session.recordings[number]
    return any(r.loading == own.loading and r.recording_id not in asked for r in session.recordings[number + 1 :])
