"""Do verdict, p-value, blocks, causes, sizes and headline of a diagnosis say the same, over sessions, cycles and systems?

    python -m tests.studies.study_consistency [--seed N] [--systems N] [--cycles N] [--sessions N] [--minutes N]
                                              [--jobs N]

Systems of another kind (resonances side by side, bent, noisy, noise-free, short), lone large cycles, and sessions of two
or three recordings of the truth rig with nothing, one or two effects, or one that no list has. Each is published as its tables, and
these are held against each other (`tests.helpers.contradictions`). `--minutes` ends the study early.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pipeline.analyse.diagnosis_tables import comparison_tables, diagnosis_tables
from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.single.cycle_diagnosis import diagnose_cycle
from pipeline.diagnose.single.cycle_model import make_cycle
from pipeline.diagnose.single.oscillator import SystemRecord
from pipeline.diagnose.single.system_diagnosis import diagnose_system
from schemas.errors import NotIdentifiableError
from tests.helpers.contradictions import find_contradictions
from tests.helpers.truth_rig import KINDS, compact_designs, make_session, random_effect

Float = NDArray[np.float64]
INTERVAL_S, SAMPLES = 1e-3, 500


def draw_system(rng: np.random.Generator) -> SystemRecord:
    """A driven system: one to three resonances, or a low pass, or nothing but noise; perhaps bent; any level of noise."""
    n, omega = SAMPLES, 2 * np.pi * np.arange(1, int(0.2 * SAMPLES), 2) / (SAMPLES * INTERVAL_S)
    waves = np.exp(1j * (np.outer(np.arange(n) * INTERVAL_S, omega) + rng.uniform(0, 2 * np.pi, omega.size)))
    waves *= np.sqrt(2 / omega.size)
    response = np.zeros(omega.size, dtype=complex)
    for _ in range(int(rng.integers(1, 4))):
        own, ratio = 2 * np.pi * rng.uniform(20, 150), np.exp(rng.uniform(np.log(0.1), np.log(1.5)))
        response += rng.normal() * own**2 / (own**2 - omega**2 + 2j * ratio * own * omega)
    y = (waves @ response).real
    size = float(y.std())
    kind = rng.integers(6)
    if kind == 1:
        y = y + rng.uniform(-0.05, 0.3) * y**3 / size**2
    elif kind == 2:
        y = np.clip(y, -np.inf, rng.uniform(0.8, 2.5) * size)
    elif kind == 3:
        y = rng.normal(0, size, n)
    elif kind == 4:
        y = np.roll(y, int(rng.integers(1, 8)))
    noise = float(rng.choice([0.0, 1e-6, 1e-3, 1e-2, 0.1, 1.0]))
    y = (y + noise * size * rng.standard_normal(n)) * 10 ** rng.uniform(-9, 6)
    return SystemRecord("record", waves.sum(axis=1).real, y, INTERVAL_S, periodic=True)


def try_system(rng: np.random.Generator) -> list[str]:
    """Contradictions of a system."""
    found = diagnose_system("S", [draw_system(rng)], ["noise"], str(rng.choice(["V", "1"])))
    return find_contradictions(comparison_tables(*found), alone=True)


def try_cycle(rng: np.random.Generator) -> list[str]:
    """Contradictions of a large cycle: branches that relax on a law that may be another."""
    up = float(np.exp(rng.uniform(np.log(2), np.log(30))))
    time_s = np.linspace(0, rng.uniform(1.5, 1.98) * up, 150)
    rate, top = rng.uniform(1, 4) / up, 0.0
    branches = [
        (rng.uniform(5, 80), np.exp(rng.uniform(np.log(0.1), np.log(20)))) for _ in range(int(rng.integers(1, 4)))
    ]

    def change(t: float, q: Float) -> list[float]:
        return [g * (rate if t < up else -rate) - own / tau for own, (g, tau) in zip(q, branches, strict=True)]

    over = solve_ivp(
        change, (0, time_s[-1]), np.zeros(len(branches)), t_eval=time_s, max_step=up / 100, rtol=1e-7
    ).y.sum(axis=0)
    stretch = 1 + rate * (up - np.abs(up - time_s))
    law = 20 * (stretch - stretch**-2) + rng.choice([0.0, 2.0]) * (stretch - 1) ** 3
    top = float(law.max())
    stress = law + over + top * float(rng.choice([0.0, 1e-5, 1e-3, 1e-2])) * rng.standard_normal(time_s.size)
    found = diagnose_cycle(make_cycle(time_s, stretch, stress, None, "cycle", "film"))
    return find_contradictions(comparison_tables(*found), alone=True)


def try_session(rng: np.random.Generator) -> list[str]:
    """Contradictions of a session of two or three recordings."""
    designs = compact_designs()
    chosen = np.sort(rng.choice(len(designs), int(rng.integers(2, 4)), replace=False))
    seed = int(rng.integers(1_000_000_000))
    effects = []
    for id in rng.choice(sorted(KINDS), int(rng.choice([0, 0, 1, 1, 2])), replace=False):
        drawn = random_effect(str(id), KINDS[id].typical, rng)
        effects.append(replace(drawn, severity=drawn.severity * float(np.exp(rng.uniform(-2, 0.7)))))
    session = make_session(seed, [designs[i] for i in chosen], effects)
    features = [reduce(recording) for recording in session.recordings]
    return find_contradictions(diagnosis_tables(diagnose(features), features), alone=False)


SORTS: dict[str, Callable[[np.random.Generator], list[str]]] = {
    "systems": try_system,
    "cycles": try_cycle,
    "sessions": try_session,
}


@dataclass(frozen=True)
class Tried:
    """One drawn diagnosis: its contradictions, None where it cannot be asked, and seconds of a core."""

    sort: str
    number: int
    found: list[str] | None
    cost_s: float


def try_one(seed: int, sort: str, number: int) -> Tried:
    """Draws, diagnoses and judges one."""
    start = time.process_time()
    try:
        found = SORTS[sort](np.random.default_rng([seed, list(SORTS).index(sort), number]))
    except NotIdentifiableError:
        found = None
    return Tried(sort, number, found, time.process_time() - start)


def run(seed: int, counts: dict[str, int], minutes: float, jobs: int) -> Iterator[str]:
    """Lines of the result; an early end leaves a fair share of each sort."""
    begin = time.monotonic()
    asked = [place[1:] for place in sorted(((k + 0.5) / of, sort, k) for sort, of in counts.items() for k in range(of))]
    tried: list[Tried] = []
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        while asked and not (minutes and time.monotonic() - begin > 60 * minutes):
            # Few at a time, so that an early end does not wait for many.
            some, asked = asked[: 4 * jobs], asked[4 * jobs :]
            for one in pool.map(try_one, [seed] * len(some), *zip(*some, strict=True)):
                tried.append(one)
                print(f"{one.sort} {one.number}: {one.cost_s:.1f} s {one.found}", file=sys.stderr, flush=True)
    for sort in counts:
        own = [one for one in tried if one.sort == sort]
        made = sum(one.found is not None for one in own)
        each = sum(one.cost_s for one in own) / max(len(own), 1)
        yield f"- {sort}: {made} diagnosed, {len(own) - made} cannot be asked, {each:.1f} s of a core each"
    contradictions = [f"{one.sort} {one.number}: {text}" for one in tried for text in one.found or ()]
    yield f"- all: {sum(one.found is not None for one in tried)} diagnosed, {len(contradictions)} contradictions"
    yield from (f"  - {text}" for text in contradictions)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seed", type=int, default=33)
    parser.add_argument("--systems", type=int, default=10)
    parser.add_argument("--cycles", type=int, default=5)
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--minutes", type=float, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    a = parser.parse_args()
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"
    status = 0
    for line in run(a.seed, {"systems": a.systems, "cycles": a.cycles, "sessions": a.sessions}, a.minutes, a.jobs):
        print(line, flush=True)
        status |= line.startswith("  - ")
    return status


if __name__ == "__main__":
    sys.exit(main())
