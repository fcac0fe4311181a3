"""Every pinned verdict as a file, to be compared before and after a change that must change none.

    python -m tests.hidden_effects.verdicts OUT.json [BEFORE.json]

Two sessions with nothing hidden and one of each effect at its typical severity, seed 103. All that a diagnosis says is written, numbers
to the last digit. With a second file the two are compared; exit status 1 where they differ.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.reduce import reduce
from tests.helpers.truth_rig import KINDS, compact_session

SEED = 103
SESSIONS: tuple[tuple[str | None, int], ...] = ((None, SEED), (None, SEED + 1), *((id, SEED) for id in KINDS))


def say(session: tuple[str | None, int]) -> Any:
    """What the diagnosis of a session says, as plain values."""
    id, seed = session
    effects = [] if id is None else [(id, KINDS[id].typical)]
    return _plain(diagnose(tuple(reduce(recording) for recording in compact_session(seed, effects).recordings)))


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return {str(key): _plain(member) for key, member in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(member) for member in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else str(value)
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def differences(before: Any, after: Any, place: str = "") -> Iterator[str]:
    """Where two sets of verdicts differ, one place a line."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in before.keys() | after.keys():
            yield from differences(before.get(key), after.get(key), f"{place}/{key}")
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for number, (one, other) in enumerate(zip(before, after, strict=True)):
            yield from differences(one, other, f"{place}/{number}")
    elif before != after:
        yield f"{place}: {str(before)[:100]} and {str(after)[:100]}"


def main() -> int:
    names = [f"{id or 'nothing'} {seed}" for id, seed in SESSIONS]
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):  # before the workers import numpy
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        found = dict(zip(names, pool.map(say, SESSIONS), strict=True))
    Path(sys.argv[1]).write_text(json.dumps(found, indent=1, sort_keys=True), encoding="utf-8")
    if len(sys.argv) < 3:
        return 0
    differing = list(
        differences(json.loads(Path(sys.argv[2]).read_text(encoding="utf-8")), json.loads(json.dumps(found)))
    )
    print("\n".join(differing[:40]) or f"All {len(found)} verdicts are the same.")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
