"""Survival and breakdown detection: Kaplan–Meier against lifelines in the same run, and what a night costs."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.fit.survival.kaplan_meier import kaplan_meier
from pipeline.fit.survival.tests import permutation_test
from pipeline.transform.breakdown import detect_breakdown
from tests.helpers.breakdown_circuits import simulate

TITLE = "Survival"
ROWS = 100_000
RUNS = 7
PEERS = Path(__file__).resolve().parents[2] / ".venv-peers" / "bin" / "python"
_THEIRS = f"""
import json, time
import numpy as np
from lifelines import KaplanMeierFitter
rng = np.random.default_rng(1)
life, failed = rng.exponential(1.0, {ROWS}), rng.random({ROWS}) < 0.7
seconds = []
for _ in range({RUNS}):
    begin = time.perf_counter()
    curve = KaplanMeierFitter().fit(life, failed)
    seconds.append(time.perf_counter() - begin)
print(json.dumps([float(np.median(seconds)), float(curve.survival_function_.iloc[{ROWS} // 2, 0])]))
"""


def median_seconds(work: Callable[[], object]) -> float:
    seconds = []
    for _ in range(RUNS):
        begin = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds))


def run() -> list[dict[str, Any]]:
    rng = np.random.default_rng(1)
    life, failed = rng.exponential(1.0, ROWS), rng.random(ROWS) < 0.7
    own = median_seconds(lambda: kaplan_meier(life, failed))
    rows: list[dict[str, Any]] = [{"name": f"Kaplan–Meier with bands, {ROWS} rows", "seconds": own}]
    if PEERS.exists():
        answer = subprocess.run([PEERS, "-c", _THEIRS], capture_output=True, text=True, check=True, timeout=300)
        theirs, survival = json.loads(answer.stdout)
        difference = abs(float(kaplan_meier(life, failed).survival[ROWS // 2 - 1]) - survival)
        rows.append(
            {
                "name": "lifelines' Kaplan–Meier, same rows",
                "seconds": theirs,
                "ratio": theirs / own,
                "note": f"ratio: ours is so many times faster (target 5); curves differ by {difference:.1e}",
            }
        )
    else:
        rows.append({"name": "lifelines' Kaplan–Meier", "note": "skipped: no .venv-peers (make peers)"})
    a = (rng.exponential(1.0, 20), np.ones(20, dtype=bool))
    b = (rng.exponential(2.0, 20), np.ones(20, dtype=bool))
    rows.append(
        {"name": "exact permutation of 20 against 20", "seconds": median_seconds(lambda: permutation_test(a, b))}
    )
    cases = [simulate(rng, number).recording for number in range(20)]
    each = median_seconds(lambda: [detect_breakdown(case) for case in cases]) / len(cases)
    samples = int(np.mean([case.channels["voltage"].values.size for case in cases]))
    rows.append({"name": "breakdown detection of one record", "seconds": each, "note": f"{samples} samples on average"})
    return rows
