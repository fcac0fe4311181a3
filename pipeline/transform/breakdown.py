"""Breakdown in the voltage monitor of a lifetime test: how long the specimen lived, or how long it was seen to live.

A lasting collapse of the voltage while the command stays on is a breakdown. Everything else that makes the voltage fall
is told apart from it: the switch-on ramp, dips that recover, self-healing discharges, drop-outs of the monitor, the end
of the test, a switch-off, a gap, the end of the record. What the record cannot decide is said, not hidden.

Belongs here: the verdict. Does not belong here: the trace (`breakdown_signal`), the other channels
(`breakdown_evidence`), statistics of lifetimes (`pipeline.fit.survival.kaplan_meier`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.transform.breakdown_evidence import (
    ABRUPT,
    EXPONENTIAL,
    LIKE_BREAKDOWN_S,
    OFF_AFTER,
    OFF_FIRST,
    ON,
    OTHER,
    Command,
    Decay,
    command_of,
    decay,
    force_confirms,
    leakage_confirms,
    leakage_jumps,
)
from pipeline.transform.breakdown_falls import (
    LASTING_S,
    SHORTEST_LASTING_S,
    Fall,
    back_above,
    fall_at,
    is_fast,
    level_before,
    shallow_dips,
    stays_down,
    window_end,
)
from pipeline.transform.breakdown_life import Counts, Lifetime, Verdict, lifetime, site_contradiction
from pipeline.transform.breakdown_signal import (
    FULL,
    HALF,
    Trace,
    application,
    block_medians,
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
    RAISED,
    SAGGED,
    SWITCHED_OFF,
    TRUNCATED,
)
from schemas.recording import Recording

END_SLACK_S = 0.5
_LONG_TEST = 0.9


def detect_breakdown(recording: Recording) -> Lifetime:
    """Life of the specimen in a `lifetime` recording.

    Life begins when the voltage first reaches 95 % of its set point. Breakdown: the voltage falls below half of its level
    (median of the last second) within 20 ms and stays there for 0.5 s, or to the end of a record that goes on for 0.1 s,
    while the command stays on; the instant is the last sample above 90 %. Back above 90 % within 0.5 s it is a glitch.
    Without a command, a fall at or after the planned end less 0.5 s is the end of the test, an earlier one a breakdown
    unless it decays exponentially like a discharge; where the two look alike, leakage current, residual voltage,
    `failure_site` decide, in this order, and if none does `decided` is false.

    Raises `RefusedError` without a voltage channel, `NotIdentifiableError` when there is no voltage to judge.
    """
    metadata = recording.metadata
    where = metadata.recording_id
    channel = recording.channels.get("voltage")
    if channel is None:
        raise RefusedError("no channel voltage", where=where, expected="the monitored voltage of a lifetime test")
    origin = int(channel.time_ns[0]) if channel.time_ns.size else 0
    try:
        trace = voltage_trace(
            channel,
            metadata.voltage_setpoint_kv,
            leakage_times=leakage_jumps(recording.channels.get("leakage_current"), origin),
        )
    except NotIdentifiableError as error:
        raise NotIdentifiableError(error.problem, where=where, remedy="Look at the voltage of this recording") from None
    return _Detector(recording, trace, origin).lifetime()


class _Detector:
    """The verdict on one recording; holds its channels so that the rules below read like the rules."""

    def __init__(self, recording: Recording, trace: Trace, origin: int) -> None:
        self.recording = recording
        self.metadata = recording.metadata
        self.trace = trace
        self.origin = origin
        self.command: Command | None = command_of(recording.channels.get("command"), origin)
        self.counts = Counts(notes=list(trace.notes))

    def lifetime(self) -> Lifetime:
        found = start_of_life(self.trace)
        if found is None:
            return self._never_reached()
        start, start_s = found
        if start == 0:
            self.counts.notes.append("the record begins with the voltage on: life counts from its first sample")
        elif self.trace.time[start] - self.trace.time[start - 1] > self.trace.longest_gap:
            hole = float(self.trace.time[start] - self.trace.time[start - 1])
            self.counts.notes.append(
                f"the voltage came on in a gap of {hole:.3g} s: the life may be longer by that much"
            )
        whole = self.trace
        gap = first_gap(whole, start)
        if gap is not None:
            self.trace = whole.until(gap + 1)
        rise = raised_voltage(self.trace, start)
        verdict = self._judge(start, start_s, ended_by_gap=gap is not None)
        self._note_dips(start, verdict.last)
        if rise is not None and rise.time < self.trace.time[verdict.last]:
            return self._raised(start_s, rise.time, verdict)
        end_s = float(self.trace.time[verdict.last])
        return lifetime(self.metadata, self.trace, self.counts, verdict, start_s, end_s)

    # ---- events -----------------------------------------------------------------------------------------------------

    def _judge(self, start: int, start_s: float, *, ended_by_gap: bool) -> Verdict:
        """Goes through the falls in order; the first that lasts decides, else the end of the record does."""
        trace = self.trace
        low = trace.value < HALF * trace.level
        entries = np.flatnonzero(low[1:] & ~low[:-1]) + 1
        resume = start
        for entry in entries[entries > start].tolist():
            if entry < resume:
                continue
            fall = fall_at(trace, entry, start)
            verdict = self._lasting(fall, start_s) if fall.lasts(self.trace) else None
            if verdict is not None:
                return verdict
            self._count(fall)
            resume = fall.back if fall.back is not None else trace.value.size
        return self._survived(start_s, ended_by_gap=ended_by_gap)

    def _count(self, fall: Fall) -> None:
        """Books a fall that recovered."""
        if self._command(fall)[0] == OFF_FIRST:
            self.counts.interruptions += 1
        elif fall.fast and not fall.lasts(self.trace):
            self.counts.glitches += 1
        else:
            self.counts.dips += 1

    def _command(self, fall: Fall) -> tuple[str, float]:
        if self.command is None:
            return "", float("nan")
        time = self.trace.time
        until = float(time[fall.entry]) + LASTING_S
        return self.command.around(float(time[fall.last]), float(time[min(fall.last + 1, time.size - 1)]), until)

    def _lasting(self, fall: Fall, start_s: float) -> Verdict | None:
        """Verdict on a fall that did not recover within 0.5 s; None when the test went on after it."""
        state, gone = self._command(fall)
        if state == OFF_FIRST:
            return self._switched_off(fall, start_s, "the command fell first")
        if state in (ON, OFF_AFTER):
            return self._with_command(fall, gone if state == OFF_AFTER else None)
        return self._without_command(fall, start_s)

    # ---- verdicts ---------------------------------------------------------------------------------------------------

    def _with_command(self, fall: Fall, gone: float | None) -> Verdict | None:
        if not fall.fast:
            return self._sagged(fall)
        stays, seen = stays_down(self.trace, fall)
        if seen < SHORTEST_LASTING_S:
            return self._too_short(fall, seen)
        if not stays:
            return self._partial(fall)
        confirmed, against = self._witnesses(fall)
        if fall.back is not None and "leakage_current" in against:
            return None
        notes = self._recovered_note(fall)
        if gone is not None:
            delay = gone - float(self.trace.time[fall.last])
            notes += (f"the command went off {delay * 1e3:.0f} ms after the collapse",)
        notes += site_contradiction(self.metadata, failed=True)
        return Verdict(fall.last, True, None, True, notes, confirmed, against)

    def _without_command(self, fall: Fall, start_s: float) -> Verdict | None:
        last_s = float(self.trace.time[fall.last])
        if self._at_planned_end(last_s, start_s):
            notes = site_contradiction(self.metadata, failed=False)
            return Verdict(fall.last, False, END_OF_TEST, notes=notes)
        stays, seen = stays_down(self.trace, fall)
        if fall.fast and seen < SHORTEST_LASTING_S:
            return self._too_short(fall, seen)
        shape = decay(self.trace, fall.last, window_end(self.trace, fall, LASTING_S), fall.level)
        if not fall.fast:
            if shape.kind == EXPONENTIAL and fall.back is None:
                return self._switched_off(fall, start_s, f"discharge with {shape.time_constant_s * 1e3:.0f} ms")
            return self._sagged(fall)
        if not stays:
            return self._partial(fall)
        confirmed, against = self._witnesses(fall)
        if fall.back is not None and "leakage_current" in against:
            return None
        failed, decided, reason = self._alike(shape, last_s, confirmed, against)
        notes = self._recovered_note(fall)
        if not decided:
            notes += (f"breakdown or switch-off cannot be decided without the command: {reason}",)
        notes += site_contradiction(self.metadata, failed=failed)
        because = None if failed else f"{SWITCHED_OFF}: {reason}"
        return Verdict(fall.last, failed, because, decided, notes, confirmed, against)

    def _alike(
        self, shape: Decay, last_s: float, confirmed: tuple[str, ...], against: tuple[str, ...]
    ) -> tuple[bool, bool, str]:
        """(failed, decided, reason) of a fast lasting fall without a command."""
        site = self.metadata.failure_site
        if "leakage_current" in confirmed:
            return True, True, "the leakage current jumps"
        if shape.holds:
            return True, True, "the supply goes on at a lower voltage"
        if shape.kind in (ABRUPT, OTHER):
            return True, True, "faster than a discharge" if shape.kind == ABRUPT else "no discharge curve"
        if shape.kind == EXPONENTIAL and shape.time_constant_s >= LIKE_BREAKDOWN_S:
            return False, True, f"discharge with {shape.time_constant_s * 1e3:.0f} ms"
        if "leakage_current" in against:
            return False, True, "no jump of the leakage current"
        if site not in (None, "unknown"):
            return site != "none", True, f"failure_site is {site}"
        if shape.kind == EXPONENTIAL:
            return False, False, f"discharge with {shape.time_constant_s * 1e3:.1f} ms, as fast as a breakdown can look"
        if self._timer_ran_out(last_s):
            return False, False, "the planned time had passed since the voltage was applied"
        return True, False, f"too few samples on the way down ({self.trace.interval * 1e3:.3g} ms apart)"

    def _switched_off(self, fall: Fall, start_s: float, how: str) -> Verdict:
        at_end = self._at_planned_end(float(self.trace.time[fall.last]), start_s)
        because = END_OF_TEST if at_end else f"{SWITCHED_OFF}: {how}"
        return Verdict(fall.last, False, because, notes=site_contradiction(self.metadata, failed=False))

    def _sagged(self, fall: Fall) -> Verdict | None:
        """A slow fall: the supply's, not the film's. The life goes on if it recovers."""
        if fall.back is not None:
            return None
        lowest = float(self.trace.value[fall.entry :].min())
        because = f"{SAGGED}: slowly to {lowest:.3g} kV"
        return Verdict(fall.last, False, because, notes=site_contradiction(self.metadata, failed=False))

    def _partial(self, fall: Fall) -> Verdict:
        after = self.trace.value[fall.entry : window_end(self.trace, fall, LASTING_S)]
        note = f"the voltage fell and came back to {float(np.quantile(after, 0.9)):.3g} kV only: cannot be decided"
        because = f"{SAGGED}: fell within 20 ms and came back in part"
        return Verdict(fall.last, False, because, False, (note,))

    def _too_short(self, fall: Fall, seen: float) -> Verdict:
        note = f"the record ends {seen * 1e3:.0f} ms after a fall of the voltage: cannot be decided"
        return Verdict(fall.last, False, f"{END_OF_RECORD}: during a fall of the voltage", False, (note,))

    def _survived(self, start_s: float, *, ended_by_gap: bool) -> Verdict:
        trace = self.trace
        up = np.flatnonzero(trace.value >= HALF * trace.level)
        last = int(up[-1])
        if self._at_planned_end(float(trace.time[last]), start_s):
            because = END_OF_TEST
        elif ended_by_gap:
            because = f"{GAP} longer than {trace.longest_gap:g} s"
        elif self.recording.problems:
            because = f"{TRUNCATED}: {self.recording.problems[0]}"
        else:
            because = END_OF_RECORD
        return Verdict(last, False, because, notes=site_contradiction(self.metadata, failed=False))

    # ---- helpers ----------------------------------------------------------------------------------------------------

    def _at_planned_end(self, last_s: float, start_s: float) -> bool:
        planned = self.metadata.test_duration_s
        return planned is not None and last_s - start_s >= planned - END_SLACK_S

    def _timer_ran_out(self, last_s: float) -> bool:
        """The planned time is over if its timer started with the voltage's application instead of the life."""
        planned = self.metadata.test_duration_s
        return planned is not None and abs(last_s - application(self.trace) - planned) <= END_SLACK_S

    def _witnesses(self, fall: Fall) -> tuple[tuple[str, ...], tuple[str, ...]]:
        instant = float(self.trace.time[fall.last])
        channels = self.recording.channels
        answers = {
            "force": force_confirms(channels.get("force"), self.origin, instant),
            "leakage_current": leakage_confirms(channels.get("leakage_current"), self.origin, instant),
        }
        confirmed = tuple(name for name, answer in answers.items() if answer)
        return confirmed, tuple(name for name, answer in answers.items() if answer is False)

    def _recovered_note(self, fall: Fall) -> tuple[str, ...]:
        if fall.back is None:
            return ()
        away = float(self.trace.time[fall.back] - self.trace.time[fall.last])
        return (f"the voltage came back after {away:.2g} s: a dip of the supply is not excluded",)

    def _note_dips(self, start: int, last: int) -> None:
        dips = shallow_dips(self.trace, start, last)
        if dips is not None:
            self.counts.dips += dips.number
            self.counts.notes.append(
                f"{dips.number} dip{'s' if dips.number > 1 else ''} of the voltage, down to {100 * dips.lowest:.0f} % of "
                f"its level; {dips.seconds:.2g} s below 90 %"
            )

    def _raised(self, start_s: float, raised_s: float, verdict: Verdict) -> Lifetime:
        """The voltage was raised before the observation ended: after a fixed test (censored there), or a staircase."""
        planned = self.metadata.test_duration_s
        held = raised_s - start_s
        watched = float(self.trace.time[verdict.last]) - start_s
        broke = level_before(self.trace, verdict.last) if verdict.failed else None
        fixed = held >= _LONG_TEST * planned - END_SLACK_S if planned is not None else held >= watched / 2
        if fixed:
            held = held if planned is None else min(held, planned)
            if not verdict.decided:
                # The life ends before the fall that is in doubt, so it is known all the same; the breakdown voltage is not.
                top = level_before(self.trace, verdict.last)
                note = f"breakdown or switch-off at {top:.3g} kV after the fixed test: left open, no breakdown voltage"
                verdict, broke = replace(verdict, decided=True, notes=(note,)), None
            outcome = f", broke down at {broke:.3g} kV" if broke is not None else ""
            kept = tuple(note for note in verdict.notes if "failure_site" not in note)
            censored = replace(verdict, failed=False, because=f"{RAISED}{outcome}", notes=kept)
            return lifetime(
                self.metadata, self.trace, self.counts, censored, start_s, start_s + held, breakdown_voltage=broke
            )
        note = f"the voltage was raised {held:.3g} s after it was reached: a staircase, no life at one voltage"
        staircase = replace(verdict, notes=(*verdict.notes, note))
        return lifetime(
            self.metadata,
            self.trace,
            self.counts,
            staircase,
            start_s,
            float(self.trace.time[verdict.last]),
            breakdown_voltage=broke,
            staircase=True,
        )

    def _never_reached(self) -> Lifetime:
        """The set point was not reached: broke down while the voltage was raised, or no test at all."""
        trace = self.trace
        value = trace.value
        highest = np.maximum.accumulate(np.minimum(value, np.append(value[1:], value[-1])))
        low = (value < HALF * highest) & (highest >= 0.1 * trace.set_point)
        entries = np.flatnonzero(low[1:] & ~low[:-1]) + 1
        for entry in entries.tolist():
            top = float(highest[entry])
            last = int(np.flatnonzero(value[:entry] >= FULL * top)[-1])
            fast = is_fast(trace, last, entry, top)
            fall = Fall(last, entry, back_above(trace, entry, FULL * top), top, fast)
            watched = float(trace.time[-1] - trace.time[entry]) + trace.interval
            if not fast or fall.back is not None or watched < SHORTEST_LASTING_S or self._command(fall)[0] == OFF_FIRST:
                continue
            confirmed, against = self._witnesses(fall)
            level = level_before(self.trace, last)
            medians, size = block_medians(value[: last + 1], trace.interval)
            steps = plateaus(medians, size * trace.interval).size
            notes = (
                f"broke down at {level:.3g} kV, before the set point of {trace.set_point:g} kV was reached: life 0",
                *site_contradiction(self.metadata, failed=True),
            )
            decided = self.command is not None or bool(confirmed)
            if not decided:
                notes += ("breakdown or switch-off cannot be decided without the command",)
            verdict = Verdict(last, True, None, decided, notes, confirmed, against)
            end_s = float(trace.time[last])
            return lifetime(
                self.metadata,
                self.trace,
                self.counts,
                verdict,
                end_s,
                end_s,
                breakdown_voltage=level,
                staircase=steps >= 2,
            )
        raise NotIdentifiableError(
            f"the voltage reaches {float(value.max()):.3g} kV, never 95 % of its set point {trace.set_point:g} kV",
            where=self.metadata.recording_id,
            expected="a test at the set point, or a breakdown on the way there",
            remedy="Correct voltage_setpoint_kv if it is wrong",
        )
