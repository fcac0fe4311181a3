"""Breakdown in the voltage monitor of a lifetime test: how long the specimen lived, or how long it was seen to live.

Every fall of the voltage that lasts is put to all channels and to what people wrote down; a small model of log odds says
how probable a breakdown, a switch-off, the supply and the monitor are as its cause. What the record cannot decide is
said, not hidden.

Belongs here: the course of one judgement. Does not belong here: the trace (`breakdown_signal`), falls
(`breakdown_falls`), what the channels show (`breakdown_evidence`), what it weighs (`breakdown_model`), statistics of
lifetimes (`pipeline.fit.survival.kaplan_meier`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from pipeline.transform.breakdown_evidence import RULES, Life, Witnesses
from pipeline.transform.breakdown_falls import (
    SHORTEST_LASTING_S,
    Fall,
    dips_between,
    fall_from,
    falls,
    level_before,
)
from pipeline.transform.breakdown_life import Counts, Lifetime, Verdict, lifetime
from pipeline.transform.breakdown_model import CERTAIN, FAILED, MONITOR, SUPPLY, describe, posterior, strongest
from pipeline.transform.breakdown_signal import (
    HALF,
    application,
    block_medians,
    check_constant,
    current_jumps,
    first_gap,
    plateaus,
    raised_voltage,
    start_of_life,
    voltage_trace,
)
from schemas.errors import NotIdentifiableError, RefusedError
from schemas.lifetimes import (
    END_OF_RECORD,
    END_OF_TEST,
    GAP,
    MONITOR_LOST,
    RAISED,
    SAGGED,
    SWITCHED_OFF,
    TRUNCATED,
)
from schemas.recording import Recording

_LONG_TEST = 0.9
_SLOW_RISE_S = 1.0
"""A voltage that is there sooner has been switched on."""


def detect_breakdown(recording: Recording) -> Lifetime:
    """Life of the specimen in a `lifetime` recording.

    Life begins when the voltage first reaches 95 % of its set point. A fall of the voltage that lasts for half a second,
    or to the end of the record, ends it; `failed` when a breakdown is the most probable cause (`breakdown_model`), the
    instant is the last sample above 90 %. Back above 90 % within half a second it is a glitch. `decided` is false where
    the probability of a breakdown lies between 10 and 90 %.

    Raises
    ------
    RefusedError : without a voltage channel
    NotIdentifiableError : when there is no voltage to judge, or it is not constant
    """
    where = recording.metadata.recording_id
    if "voltage" not in recording.channels:
        raise RefusedError("no channel voltage", where=where, expected="the monitored voltage of a lifetime test")
    try:
        return _Judgement(recording).lifetime()
    except NotIdentifiableError as error:
        remedy = error.remedy or "Look at the voltage of this recording"
        raise NotIdentifiableError(error.problem, where=where, expected=error.expected, remedy=remedy) from None


def observe_falls(recording: Recording) -> Iterator[tuple[float, Mapping[str, str]]]:
    """Each fall that lasts: its instant in s since the first sample of the voltage, and what the record shows around it.

    What `breakdown_model` is calibrated on. Raises `NotIdentifiableError` when there is no voltage to judge.
    """
    judgement = _Judgement(recording)
    found = start_of_life(judgement.trace)
    if found is not None:
        raised_s = judgement.cut_at_gap(found[0])
        for fall, outcomes in judgement.observe(found[0], raised_s):
            if outcomes is not None:
                yield float(judgement.trace.time[fall.last]), outcomes


class _Judgement:
    """The judgement on one recording; holds its channels so that the rules below read like the rules."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.metadata = recording.metadata
        channel = recording.channels["voltage"]
        origin = int(channel.time_ns[0]) if channel.time_ns.size else 0
        jumps = current_jumps(recording.channels.get("leakage_current"), origin)
        self.trace = voltage_trace(channel, self.metadata.voltage_setpoint_kv, leakage_times=jumps)
        self.witnesses = Witnesses(recording, self.trace, origin)
        self.counts = Counts(notes=list(self.trace.notes))
        self.ended_by_gap = False

    def lifetime(self) -> Lifetime:
        found = start_of_life(self.trace)
        if found is None:
            return self._never_reached()
        start, start_s = found
        check_constant(self.trace, start)
        self._note_start(start)
        raised_s = self.cut_at_gap(start)
        verdict = self._judge(start, raised_s)
        dips, note = dips_between(self.trace, start, verdict.last)
        self.counts.dips += dips
        self.counts.notes += [note] if note else []
        self._note_rise(start_s, float(self.trace.time[verdict.last]))
        if raised_s < self.trace.time[verdict.last]:
            return self._raised(start_s, raised_s, verdict)
        return lifetime(self.metadata, self.trace, self.counts, verdict, start_s, float(self.trace.time[verdict.last]))

    def cut_at_gap(self, start: int) -> float:
        """Leaves of the trace what comes before its first gap; gives when the voltage was raised, infinite for never."""
        gap = first_gap(self.trace, start)
        if gap is not None:
            if self.trace.value[gap + 1] < HALF * self.trace.level[gap]:
                self.counts.notes.append("after the gap the voltage is down: what happened in it is not known")
            self.trace = self.witnesses.trace = self.trace.until(gap + 1)
            self.ended_by_gap = True
        rise = raised_voltage(self.trace, start)
        return np.inf if rise is None else rise.time

    def _note_start(self, start: int) -> None:
        if start == 0:
            self.counts.notes.append("the record begins with the voltage on: life counts from its first sample")
            return
        hole = float(self.trace.time[start] - self.trace.time[start - 1])
        if hole > self.trace.longest_gap:
            self.counts.notes.append(
                f"the voltage came on in a gap of {hole:.3g} s: the life may be longer by that much"
            )

    def _note_rise(self, start_s: float, end_s: float) -> None:
        rise, held = start_s - application(self.trace), end_s - start_s
        if rise > max(held, _SLOW_RISE_S):
            self.counts.notes.append(
                f"the voltage took {rise:.3g} s to rise, longer than it was held: what the rise did is not in the life"
            )

    # ---- falls ------------------------------------------------------------------------------------------------------

    def observe(self, start: int, raised_s: float) -> Iterator[tuple[Fall, Mapping[str, str] | None]]:
        """Falls in order, each that lasts with its evidence; those that do not are counted."""
        applied_s = application(self.trace)
        for fall in falls(self.trace, start):
            if fall.lasts(self.trace):
                raised = raised_s < self.trace.time[fall.last]
                yield fall, self.witnesses.ask(fall, Life(start, applied_s, raised))
            else:
                yield fall, None
            if self.witnesses.command_at(fall)[0] in ("off first", "off at once"):
                self.counts.interruptions += 1
            elif fall.fast and not fall.lasts(self.trace):
                self.counts.glitches += fall.deep(self.trace)
            else:
                self.counts.dips += fall.deep(self.trace)

    def _judge(self, start: int, raised_s: float) -> Verdict:
        """Goes through the falls in order; the first that ends the test decides, else the end of the record does."""
        for fall, found in self.observe(start, raised_s):
            if found is None:
                continue
            verdict = self._verdict(fall, found)
            if fall.back is None or verdict.failed:
                return replace(verdict, decided=verdict.decided and not self.counts.doubtful)
            self._go_on(fall, verdict)
        return self._survived(start)

    def _go_on(self, fall: Fall, verdict: Verdict) -> None:
        """A fall that came back and was no breakdown, as far as one can tell."""
        if not verdict.decided:
            at, share = float(self.trace.time[fall.last]), verdict.probabilities[FAILED]
            self.counts.doubtful = True
            self.counts.notes.append(
                f"whether the fall at {at:.4g} s that came back was a breakdown cannot be decided (probability {share:.2f})"
            )

    def _verdict(self, fall: Fall, found: Mapping[str, str]) -> Verdict:
        probabilities = posterior(found)
        failed = probabilities[FAILED] >= 0.5
        decided = max(probabilities[FAILED], 1 - probabilities[FAILED]) >= CERTAIN
        notes: tuple[str, ...] = ()
        if found["after"] == "not seen" and found.get("leakage_current") != "jumps":
            failed, decided = False, False
            seen = fall.watched(self.trace)
            notes += (f"the record ends {seen * 1e3:.0f} ms after a fall of the voltage: cannot be decided",)
        elif not decided:
            notes += (f"breakdown or not cannot be decided: {describe(found)}",)
        if fall.back is not None and failed:
            away = float(self.trace.time[fall.back] - self.trace.time[fall.last])
            notes += (f"the voltage came back after {away:.2g} s: a dip of the supply is not excluded",)
        if failed and found.get("command") == "off after":
            delay = self.witnesses.command_at(fall)[1] - float(self.trace.time[fall.last])
            notes += (f"the command went off {delay * 1e3:.0f} ms after the collapse",)
        because = None if failed else self._because(fall, found, probabilities)
        return Verdict(fall.last, failed, because, decided, notes, probabilities, found, describe(found))

    def _because(self, fall: Fall, found: Mapping[str, str], probabilities: Mapping[str, float]) -> str:
        """Why a life that did not end by breakdown is known no longer."""
        if found["after"] == "not seen":
            return f"{END_OF_RECORD}: during a fall of the voltage"
        cause = max((c for c in probabilities if c != FAILED), key=lambda c: probabilities[c])
        if cause == MONITOR:
            return f"{MONITOR_LOST}: {strongest(found, MONITOR)}"
        if cause == SUPPLY:
            lowest = float(self.trace.value[fall.entry :].min())
            return f"{SAGGED}: to {lowest:.3g} kV, {strongest(found, SUPPLY)}"
        if found.get("planned end") in ("reached", "timer"):
            return END_OF_TEST
        return f"{SWITCHED_OFF}: {strongest(found, cause)}"

    def _survived(self, start: int) -> Verdict:
        trace = self.trace
        last = int(np.flatnonzero(trace.value >= HALF * trace.level)[-1])
        planned = self.metadata.test_duration_s
        if planned is not None and trace.time[last] - trace.time[start] >= planned - RULES.planned_slack_s:
            because = END_OF_TEST
        elif self.ended_by_gap:
            because = f"{GAP} longer than {trace.longest_gap:g} s"
        elif self.recording.problems:
            because = f"{TRUNCATED}: {self.recording.problems[0]}"
        else:
            because = END_OF_RECORD
        return Verdict(last, False, because, decided=not self.counts.doubtful)

    # ---- other tests than at one voltage ----------------------------------------------------------------------------

    def _raised(self, start_s: float, raised_s: float, verdict: Verdict) -> Lifetime:
        """The voltage was raised before the observation ended: after a fixed test (censored there), or a staircase."""
        planned = self.metadata.test_duration_s
        end_s = float(self.trace.time[verdict.last])
        held = raised_s - start_s
        top = level_before(self.trace, verdict.last) if verdict.failed else None
        fixed = (
            held >= _LONG_TEST * planned - RULES.planned_slack_s
            if planned is not None
            else held >= (end_s - start_s) / 2
        )
        if not fixed:
            note = f"the voltage was raised {held:.3g} s after it was reached: a staircase, no life at one voltage"
            verdict = replace(verdict, notes=(*verdict.notes, note))
            return lifetime(
                self.metadata, self.trace, self.counts, verdict, start_s, end_s, breakdown_voltage=top, staircase=True
            )
        held = held if planned is None else min(held, planned)
        broke = verdict.failed
        if not verdict.decided:
            # The life ends before the fall that is in doubt, so it is known all the same; the breakdown voltage is not.
            at = level_before(self.trace, verdict.last)
            note = f"breakdown or switch-off at {at:.3g} kV after the fixed test: left open, no breakdown voltage"
            verdict, top = replace(verdict, decided=not self.counts.doubtful, notes=(note,)), None
        because = f"{RAISED}, broke down at {top:.3g} kV" if top is not None else RAISED
        censored = replace(verdict, failed=False, because=because)
        return lifetime(
            self.metadata,
            self.trace,
            self.counts,
            censored,
            start_s,
            start_s + held,
            breakdown_voltage=top,
            broke=broke,
        )

    def _never_reached(self) -> Lifetime:
        """The set point was not reached: broke down while the voltage was raised, or no test at all."""
        trace = self.trace
        value = trace.value
        highest = np.maximum.accumulate(np.minimum(value, np.append(value[1:], value[-1])))
        low = (value < HALF * highest) & (highest >= 0.1 * trace.set_point)
        for entry in (np.flatnonzero(low[1:] & ~low[:-1]) + 1).tolist():
            fall = fall_from(trace, entry, 0, float(highest[entry]))
            if not fall.fast or fall.back is not None or fall.watched(trace) < SHORTEST_LASTING_S:
                continue
            found = self.witnesses.ask(fall, Life(fall.last, application(trace), raised=True))
            verdict = self._verdict(fall, found)
            if not verdict.failed and verdict.decided:
                continue
            level = level_before(trace, fall.last)
            medians, size = block_medians(value[: fall.last + 1], trace.interval)
            note = f"broke down at {level:.3g} kV, before the set point of {trace.set_point:g} kV was reached: life 0"
            verdict = replace(verdict, failed=True, because=None, notes=(note, *verdict.notes))
            end_s = float(trace.time[fall.last])
            return lifetime(
                self.metadata,
                trace,
                self.counts,
                verdict,
                end_s,
                end_s,
                breakdown_voltage=level,
                staircase=plateaus(medians, size * trace.interval).size >= 2,
            )
        raise NotIdentifiableError(
            f"the voltage reaches {float(value.max()):.3g} kV, never 95 % of its set point {trace.set_point:g} kV",
            expected="a test at the set point, or a breakdown on the way there",
            remedy="Correct voltage_setpoint_kv if it is wrong",
        )
