"""How evenly a recording was sampled, in words: median interval, jitter, gaps. Facts for the reader, nothing is mended."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from schemas.arrays import Int
from schemas.recording import Channel

GAP = 3.0
"""An interval longer than this many median intervals is a gap."""
_EVEN = 0.01
"""Intervals within this share of the median count as even."""


def sampling_notes(channels: Mapping[str, Channel]) -> list[str]:
    """One note per time base that is not even; channels that share their times share the note."""
    groups: list[tuple[Int, list[str]]] = []
    for name, channel in channels.items():
        for times, names in groups:
            if times is channel.time_ns or np.array_equal(times, channel.time_ns):
                names.append(name)
                break
        else:
            groups.append((channel.time_ns, [name]))
    return [f"{', '.join(names)}: {note}" for times, names in groups if (note := uneven(times))]


def uneven(time_ns: Int) -> str:
    """What is uneven about (n,) ascending instants in ns; empty when nothing is."""
    if time_ns.size < 3:
        return ""
    steps = np.diff(time_ns)
    median = float(np.median(steps))
    away = steps - median
    np.abs(away, out=away)
    off = away > max(_EVEN * median, 1.0)
    del away
    if not off.any():
        return ""
    gaps = steps > GAP * median
    text = (
        f"sampling is uneven: median interval {median * 1e-9:.6g} s, {int(off.sum())} of {steps.size} intervals differ"
    )
    text += f" (shortest {steps.min() * 1e-9:.6g} s)" if steps.min() < (1 - _EVEN) * median else ""
    if gaps.any():
        where = int(np.argmax(steps))
        at = (int(time_ns[where]) - int(time_ns[0])) * 1e-9
        text += f", {int(gaps.sum())} gaps longer than {GAP:g} intervals, the largest {steps.max() * 1e-9:.6g} s at {at:.6g} s"
    else:
        text += f", the largest {steps.max() * 1e-9:.6g} s"
    return text
