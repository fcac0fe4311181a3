"""Which gains of a PI controller to use: the grid that was tried on a specimen, and the pair that keeps both limits."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.transform.loop import LoopResponse

RISE_S, OVERSHOOT_PERCENT = 0.5, 10.0
"""Goal of the thesis for the capacitance (section 5.3)."""
FEWEST_PAIRS = 4
_SAME_STEP = 0.02


@dataclass(frozen=True)
class GainProposal:
    """Gains for one specimen and one step of the demand.

    `best`: of the loops that settle, rise in 0.5 s at most and overshoot by 10 % at most, the one with the least overshoot
    of the force; None where no pair does. `gentle`: the quickest loop whose force overshoots by 10 % at most, too; None
    where there is none. `tried` pairs of gains, `kept` those within the limits.
    """

    specimen_id: str
    demand_step_pf: float
    tried: int
    kept: int
    best: LoopResponse | None
    gentle: LoopResponse | None

    @property
    def statement(self) -> str:
        """The proposal in words."""
        goal = f"rise within {RISE_S:g} s and overshoot within {OVERSHOOT_PERCENT:g} %"
        if self.best is None:
            text = f"none of {self.tried} pairs of gains keeps {goal}"
        else:
            text = (
                f"{_gains(self.best)} keep {goal}: {self.best.rise_time_s:.2g} s, {self.best.overshoot_percent:.2g} %,"
                f" settled after {self.best.settling_time_s:.2g} s"
            )
            if self.best.force_overshoot_percent is not None:
                text += f"; the force overshoots by {self.best.force_overshoot_percent:.2g} %, the least of the {self.kept} pairs that keep both"
        if self.gentle is None:
            return f"{text}; no pair keeps the force within {OVERSHOOT_PERCENT:g} %"
        if self.gentle is not self.best:
            text += f"; a force within {OVERSHOOT_PERCENT:g} % takes {self.gentle.rise_time_s:.2g} s ({_gains(self.gentle)})"
        return text


def propose_gains(loops: Sequence[LoopResponse]) -> tuple[GainProposal, ...]:
    """A proposal for each specimen and step of the demand that was tried with four pairs of gains or more."""
    grouped: dict[str, list[list[LoopResponse]]] = defaultdict(list)
    for loop in sorted(loops, key=lambda one: one.demand_step_pf or 0.0):
        if loop.demand_step_pf is None or loop.proportional_gain is None or loop.integral_gain is None:
            continue
        groups = grouped[loop.specimen_id]
        if groups and abs(loop.demand_step_pf - (groups[-1][0].demand_step_pf or 0.0)) <= _SAME_STEP * abs(
            loop.demand_step_pf
        ):
            groups[-1].append(loop)
        else:
            groups.append([loop])
    found = []
    for specimen_id, groups in sorted(grouped.items()):
        for group in groups:
            pairs = {(loop.proportional_gain, loop.integral_gain) for loop in group}
            if len(pairs) >= FEWEST_PAIRS:
                found.append(_proposal(specimen_id, group, len(pairs)))
    return tuple(found)


def _proposal(specimen_id: str, loops: Sequence[LoopResponse], tried: int) -> GainProposal:
    settled = [
        loop
        for loop in loops
        if loop.settling_time_s is not None and loop.rise_time_s is not None and loop.overshoot_percent is not None
    ]
    kept = [x for x in settled if (x.rise_time_s or 0) <= RISE_S and (x.overshoot_percent or 0) <= OVERSHOOT_PERCENT]
    gentle = [
        x
        for x in settled
        if x.force_overshoot_percent is not None
        and x.force_overshoot_percent <= OVERSHOOT_PERCENT
        and (x.overshoot_percent or 0) <= OVERSHOOT_PERCENT
    ]
    return GainProposal(
        specimen_id,
        float(loops[0].demand_step_pf or 0.0),
        tried,
        len({(x.proportional_gain, x.integral_gain) for x in kept}),
        min(kept, key=lambda x: (_or(x.force_overshoot_percent), x.settling_time_s or 0.0), default=None),
        min(gentle, key=lambda x: x.rise_time_s or 0.0, default=None),
    )


def _or(value: float | None) -> float:
    return float("inf") if value is None else value


def _gains(loop: LoopResponse) -> str:
    return f"{loop.proportional_gain:g} V/pF and {loop.integral_gain:g} V/pF/s"
