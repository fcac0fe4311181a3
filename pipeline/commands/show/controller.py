"""A controller study in words: closed loops of a simulated campaign, measured as a laboratory would, and their gains.

Not part of the virtual rig, which knows nothing of the analysis: the recordings come to it one by one as they are
written.
"""

from __future__ import annotations

from pipeline.fit.sensing.gains import GainProposal, propose_gains
from pipeline.transform.loop import LoopResponse, measure_loop
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording


class ControllerStudy:
    """Collects what closed loops did; `text` is the table of the gains tried and the proposal for each specimen.

    A campaign of which closed loops are only a part is no study: its text is empty, and what it says of gains stands on
    its pages.
    """

    def __init__(self) -> None:
        self.loops: list[LoopResponse] = []
        self._alone = True

    def add(self, recording: Recording) -> None:
        """Takes a recording; a closed loop that cannot be measured is passed over."""
        if recording.metadata.controller != "closed":
            self._alone = False
            return
        try:
            self.loops.append(measure_loop(recording))
        except NotIdentifiableError:
            return

    @property
    def text(self) -> str:
        """Tables and proposals; empty where no grid of gains was tried, or something else as well."""
        if not self._alone:
            return ""
        return "\n\n".join(self._tabulate(proposal) for proposal in propose_gains(self.loops))

    def _tabulate(self, proposal: GainProposal) -> str:
        own = [
            loop
            for loop in self.loops
            if loop.specimen_id == proposal.specimen_id
            and loop.demand_step_pf is not None
            and abs(loop.demand_step_pf - proposal.demand_step_pf) <= 0.02 * abs(proposal.demand_step_pf)
        ]
        own.sort(key=lambda loop: (loop.proportional_gain or 0.0, loop.integral_gain or 0.0))
        lines = [
            f"Controller of {proposal.specimen_id}, a step of {proposal.demand_step_pf:.3g} pF",
            f"{'Kp V/pF':>9} {'Ki V/pF/s':>10} {'rise s':>8} {'overshoot %':>12}"
            f" {'force %':>8} {'settled s':>10} {'peak kV':>8}",
        ]
        for loop in own:
            numbers = (
                f"{loop.proportional_gain:>9g} {loop.integral_gain:>10g} {_write_number(loop.rise_time_s):>8}"
                f" {_write_number(loop.overshoot_percent):>12} {_write_number(loop.force_overshoot_percent):>8}"
                f" {_write_number(loop.settling_time_s):>10} {_write_number(loop.peak_kv):>8}"
            )
            chosen = proposal.best is not None and loop.recording_id == proposal.best.recording_id
            lines.append(numbers + ("  <- proposed" if chosen else ""))
        statement = proposal.statement
        return "\n".join([*lines, f"{statement[:1].upper()}{statement[1:]}."])


def _write_number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
