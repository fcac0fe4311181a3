"""Self-sensing: do 95 % intervals hold, is wrinkling found and only where it is, is the onset of migration right?

    python -m tests.studies.study_sensing [--runs N] [--seed N]

Actuators, wrinkling films and migrating electrodes are simulated in time by `tests.helpers.sensing_truth`, which shares no
code and no functional form with what is fitted. The study fails when the pooled share of intervals that contain the truth
leaves 93 to 97 %, when less than 95 % of the wrinkling is found or more than 1 % of the other films are said to wrinkle,
and when less than 95 % of the onsets of migration lie within 10 % of the true cycle.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from pipeline.fit.sensing.coverage import fit_coverage
from pipeline.fit.sensing.migration import migration
from pipeline.fit.sensing.self_sensing import fit_sensing
from pipeline.fit.sensing.wrinkling import wrinkling
from pipeline.fit.weighted import Estimate
from pipeline.transform.capacitance_cycles import capacitance_cycles
from pipeline.transform.coats import Coat
from pipeline.transform.step import measure_steps
from tests.helpers import sensing_truth


@dataclass
class Tally:
    """Hits and tries by name."""

    hits: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    tries: dict[str, int] = field(default_factory=lambda: defaultdict(int))

    def add(self, name: str, hit: bool) -> None:
        self.hits[name] += bool(hit)
        self.tries[name] += 1

    def covers(self, name: str, estimate: Estimate | None, truth: float) -> None:
        if estimate is not None and np.isfinite(truth):
            self.add(name, estimate.lower <= truth <= estimate.upper)

    def share(self, *names: str) -> float:
        return sum(self.hits[n] for n in names) / max(sum(self.tries[n] for n in names), 1)

    def lines(self) -> str:
        return "\n".join(f"| {name} | {self.tries[name]} | {100 * self.share(name):.1f} % |" for name in self.tries)


def actuator(seed: int, tally: Tally) -> None:
    """One self-sensing actuator: the intervals of everything that is estimated from its steps."""
    rng = np.random.default_rng([1, seed])
    exponent = 2.0 if rng.random() < 0.6 else float(rng.uniform(1.8, 2.4))
    truth = sensing_truth.sensing(rng, exponent=exponent)
    analysis = measure_steps(truth.recording)
    fit = fit_sensing([analysis.steps], truth.recording.metadata, common_sd=analysis.common_sd)
    tally.covers("force over capacitive strain", fit.force_per_capacitive_strain, truth.slope_n)
    tally.covers("exponent of the force", fit.force_exponent, truth.exponent)
    if exponent == 2.0:
        tally.covers("sensitivity", fit.sensitivity, truth.sensitivity)
    tally.covers("drift at given force", fit.drift_pf_per_hour, truth.drift_pf_per_hour)
    one = int(rng.integers(len(analysis.steps)))
    step = analysis.steps[one]
    tally.covers("force step", Estimate(step.force_step_n, step.force_step_sd_n), truth.force_steps_n[one])
    if step.capacitance_step_pf is not None and step.capacitance_step_sd_pf is not None:
        found = Estimate(step.capacitance_step_pf, step.capacitance_step_sd_pf)
        tally.covers("capacitance step", found, truth.capacitance_steps_pf[one])
    if analysis.force_change is not None and analysis.capacitance_change is not None:
        slow = analysis.force_change
        tally.covers("slow change of the force", Estimate(slow.change, slow.change_sd), truth.force_change_n)


def coats(seed: int, tally: Tally) -> None:
    """One electrode painted coat by coat: an offset exponential, or spots that fall at random."""
    rng = np.random.default_rng([2, seed])
    full, first, scale, scatter = (
        rng.uniform(20, 40),
        rng.uniform(0.6, 0.9),
        rng.uniform(3, 6),
        rng.uniform(0.001, 0.004),
    )
    n = np.arange(1, 26)
    if rng.random() < 0.5:
        share = 1 - (1 - first) * np.exp(-(n - 1) / scale)
    else:
        share = 1 - (1 - first) ** (n ** rng.uniform(0.5, 0.9))
    noise = 0.0005
    measured = full * share * (1 + scatter * rng.standard_normal(n.size)) + noise * rng.standard_normal(n.size)
    fit = fit_coverage([Coat(f"coat-{i}", "T-1", int(i), float(c), noise) for i, c in zip(n, measured, strict=True)])
    tally.covers("full capacitance", fit.full_pf, full)
    tally.covers("share of the first coat", fit.first_share, float(share[0]))


def film(seed: int, *, wrinkled: bool, tally: Tally, intervals: Tally) -> None:
    """One film at rising voltages: is it said to wrinkle, and which of its steps?"""
    truth = sensing_truth.wrinkles(np.random.default_rng([3, seed, wrinkled]), wrinkled=wrinkled)
    marked, onset = wrinkling(measure_steps(truth.recording).steps)
    if truth.onset_kv is None:
        tally.add("false: films said to wrinkle that do not", onset is not None)
        return
    tally.add("found: films that wrinkle", onset is not None)
    for step in marked:
        if step.voltage_kv >= truth.onset_kv - 0.02:
            tally.add("found: steps at and above the onset", bool(step.wrinkled))
        elif step.voltage_kv < 0.9 * truth.onset_kv:
            tally.add("found: steps more than 10 % below the onset are not said to wrinkle", not step.wrinkled)
    intervals.covers("wrinkling onset", onset, truth.onset_kv)


def electrode(seed: int, *, migrating: bool, tally: Tally, intervals: Tally) -> None:
    """One electrode under cyclic strain: the onset of its migration."""
    truth = sensing_truth.waves(np.random.default_rng([4, seed, migrating]), migrating=migrating)
    cycles = capacitance_cycles(truth.recording, truth.frequency_hz)
    assert cycles is not None
    found = migration(cycles)
    if truth.onset_cycle is None:
        tally.add("false: onsets in electrodes that do not migrate", found.onset_cycle is not None)
        return
    near = found.onset_cycle is not None and abs(found.onset_cycle / truth.onset_cycle - 1) <= 0.1
    tally.add("found: onsets within 10 % of the true cycle", near)
    if found.onset_cycle is not None and found.onset_cycle_lower is not None and found.onset_cycle_upper is not None:
        intervals.add("onset of migration", found.onset_cycle_lower <= truth.onset_cycle <= found.onset_cycle_upper)


def study(runs: int, seed: int) -> tuple[Tally, Tally]:
    """Intervals and detections over `runs` draws of everything."""
    intervals, found = Tally(), Tally()
    for i in range(runs):
        actuator(seed + i, intervals)
        coats(seed + i, intervals)
        for truth in (True, False):
            film(seed + i, wrinkled=truth, tally=found, intervals=intervals)
        if i % 4 == 0:
            for truth in (True, False):
                electrode(seed + i, migrating=truth, tally=found, intervals=intervals)
    return intervals, found


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=1000, help="draws of each kind; a quarter as many electrodes")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    intervals, found = study(arguments.runs, arguments.seed)
    pooled = intervals.share(*intervals.tries)
    print("| 95 % interval of | draws | contains the truth |\n|---|---|---|")
    print(intervals.lines())
    print(f"| **all, pooled** | {sum(intervals.tries.values())} | **{100 * pooled:.1f} %** |\n")
    print("| | of | share |\n|---|---|---|")
    print(found.lines())
    good = 0.93 <= pooled <= 0.97
    good &= all(found.share(name) >= 0.95 for name in found.tries if name.startswith("found"))
    good &= all(found.share(name) <= 0.01 for name in found.tries if name.startswith("false"))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
