"""Records that say something without a session: which of a recording's samples the diagnosis gets.

A large cycle shows no response over frequency, a system of another kind has no film: neither belongs into the simulation
of a specimen's session.
"""

from __future__ import annotations

import numpy as np

from pipeline.analyse.cycle import given_law, stretch_and_stress
from pipeline.analyse.session_features import CYCLE, SYSTEM, Single
from pipeline.transform.sampling import runs
from schemas.errors import NotIdentifiableError
from schemas.protocols import OTHER
from schemas.recording import Recording

_OF_CYCLE, _OF_SYSTEM = 700, 8192
"""Samples that are asked: of a cycle, which is smooth, every so many; of a system so many on end, where its output is
largest."""
_EVEN = 0.01
"""Share of an interval by which the sampling of a system may err."""


def take_single(recording: Recording) -> Single | None:
    """What the diagnosis can ask of a recording without others; None for recordings that belong to a session."""
    if recording.metadata.loading == OTHER:
        return _of_system(recording)
    return _of_cycle(recording) if recording.metadata.protocol == CYCLE else None


def _of_cycle(recording: Recording) -> Single | None:
    try:
        time, stretch, stress = stretch_and_stress(recording)
        given = given_law(recording.metadata)
    except NotIdentifiableError:
        return None  # the cycle's own fits say why
    every = -(-time.size // _OF_CYCLE)
    channels = {"time_s": time[::every], "stretch": stretch[::every], "stress": stress[::every]}
    return Single(CYCLE, channels, given or {})


def _of_system(recording: Recording) -> Single | None:
    """Input and output against their means, of the longest part without a lost sample; None where they are not sampled evenly and together."""
    given, answer = recording.channels["input"], recording.channels["output"]
    steps = np.diff(given.time_ns)
    if not np.array_equal(given.time_ns, answer.time_ns) or steps.size < 1:
        return None
    interval = float(np.median(steps))
    finite = np.isfinite(given.values) & np.isfinite(answer.values)
    if np.abs(steps - interval).max() > _EVEN * interval or not finite.any():
        return None
    whole = slice(*max(runs(finite), key=lambda part: part[1] - part[0]))
    inputs, outputs = given.values[whole], answer.values[whole]
    inputs, outputs = inputs - inputs.mean(), outputs - outputs.mean()
    n = outputs.size
    power = np.concatenate([[0.0], np.cumsum(outputs**2)])
    first = int(np.argmax(power[_OF_SYSTEM:] - power[: n + 1 - _OF_SYSTEM])) if n > _OF_SYSTEM else 0
    part = slice(first, first + _OF_SYSTEM)
    period = recording.metadata.period_s
    one_period = period is not None and abs(period / (interval * 1e-9) - n) < 0.5
    return Single(
        SYSTEM,
        {"input": inputs[part], "output": outputs[part]},
        {"interval_s": interval * 1e-9, "periodic": float(one_period)},
        answer.unit or "",
    )
