"""One record of a testing machine as the tests it holds: a step and hold, and what is moved before or after it.

A guess for drafts alone, from the displacement (or stretch) over time. The record is cut at its long holds. A hold at a new level
is a relaxation, and has the ramp that leads to it; movements with turning points between holds are cycles of one kind or another,
which `ingest.shapes` tells. Does not belong here: one record of one test (`ingest.shapes`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from schemas.arrays import Float, Int

_WITHIN = 0.015
"""Range of a displacement that stands still, as a share of its whole range."""
_LONG = 0.04
"""Shortest hold that parts a record, as a share of it: two triangles stand within 1.5 % of the range at a turn for 0.8 % of it."""
_ELSEWHERE = 0.03
"""Share of the range by which a hold that is no rest lies from where the film was before."""
_TURNS = 0.1
"""Share of its own range by which a movement comes back at a turning point."""
_FEWEST_ROWS = 20
_MOST_ROWS = 50_000
"""Rows that are looked at: of a longer record every second, third, …"""


@dataclass(frozen=True)
class Segment:
    """The rows `first` to `last` of a record; whether they are a step and its hold, and one that begins where the film had come back to rest."""

    first: int
    last: int
    is_hold: bool
    comes_back: bool = False


def find_segments(time_s: Float, moved: Float) -> tuple[Segment, ...]:
    """The tests in a record, in their order; empty where it is one test alone.

    A step is a test of its own where the film rests at its first length before it: there it may have gone slack, and what was before is
    forgotten.

    Parameters
    ----------
    time_s, moved : (n,) finite; a clock may begin anew where a machine starts another block
    """
    if moved.size > _MOST_ROWS:
        stride = -(-moved.size // _MOST_ROWS)
        coarse = find_segments(time_s[::stride], moved[::stride])
        end = (moved.size - 1) // stride
        return tuple(
            replace(s, first=s.first * stride, last=moved.size - 1 if s.last == end else s.last * stride)
            for s in coarse
        )
    span = float(np.ptp(moved)) if moved.size >= 2 * _FEWEST_ROWS else 0.0
    if span <= 0:
        return ()
    holds = list(_find_holds(time_s, moved, span))
    found: list[Segment] = []
    level, begin, rested, back = float(moved[0]), 0, 0, False
    for first, last in holds:
        middle = float(np.median(moved[first : last + 1]))
        turns = _find_turns(moved[begin : first + 1], span)
        at_first = abs(middle - float(moved[0])) < _ELSEWHERE * span
        is_rest = at_first or abs(middle - level) < _ELSEWHERE * span
        if turns.size:
            until = first if is_rest else begin + int(turns[-1])
            found.append(Segment(begin + _skip_return(moved[begin : first + 1], turns), until, False))
            rested = until
        if not is_rest:
            found.append(Segment(rested, last, True, comes_back=back))
        begin, rested, back = last, first if is_rest else last, at_first
        if begin + 1 < moved.size and abs(float(moved[begin + 1] - moved[begin])) > 2 * _WITHIN * span:
            begin += 1  # the film was brought elsewhere between two blocks
            rested = rested if at_first else begin
        level = middle
    turns = _find_turns(moved[begin:], span)
    if turns.size:
        found.append(Segment(begin + _skip_return(moved[begin:], turns), moved.size - 1, False))
    found = [s for s in _join_holds(found) if s.last - s.first >= _FEWEST_ROWS]
    parted = len({s.is_hold for s in found}) == 2 or sum(s.is_hold for s in found) > 1
    return tuple(found) if parted else ()


def _find_holds(time_s: Float, moved: Float, span: float) -> Iterator[tuple[int, int]]:
    """First and last rows of the long holds: the film stands still there but for the noise of its sensor."""
    steps = np.diff(time_s)
    elapsed = np.concatenate([[0.0], np.cumsum(np.where(steps > 0, steps, 0.0))])
    shortest = _LONG * elapsed[-1]
    first = 0
    while first < moved.size - 1:
        last = _still_until(moved, first, _WITHIN * span)
        if elapsed[last] - elapsed[first] < shortest:
            first += max(1, (last - first) // 4)
            continue
        level = float(np.median(moved[first : last + 1]))
        noise = 1.4826 * float(np.median(np.abs(moved[first : last + 1] - level)))
        near = np.flatnonzero(np.abs(moved[first : last + 1] - level) <= max(5 * noise, 1e-3 * span))
        yield first + int(near[0]), first + int(near[-1])
        first = last + 1


def _still_until(moved: Float, first: int, within: float) -> int:
    """The last row from `first` on before the displacement leaves a range."""
    size = 64
    while True:
        part = moved[first : first + size]
        wide = np.maximum.accumulate(part) - np.minimum.accumulate(part) > within
        if wide.any():
            return first + int(np.argmax(wide)) - 1
        if first + size >= moved.size:
            return moved.size - 1
        size *= 4


def _find_turns(moved: Float, span: float) -> Int:
    """Rows at which a movement turns back, none where it goes one way or is small."""
    reach = float(np.ptp(moved)) if moved.size > 1 else 0.0
    if reach < 2 * _ELSEWHERE * span:
        return np.empty(0, dtype=np.int64)
    turns: list[int] = []
    low = high = direction = 0
    for row in range(1, moved.size):
        low = row if moved[row] < moved[low] else low
        high = row if moved[row] > moved[high] else high
        if direction >= 0 and moved[high] - moved[row] > _TURNS * reach:
            turns += [high] if direction else []
            direction, low, high = -1, row, row
        elif direction <= 0 and moved[row] - moved[low] > _TURNS * reach:
            turns += [low] if direction else []
            direction, low, high = 1, row, row
    return np.array(turns, dtype=np.int64)


def _skip_return(moved: Float, turns: Int) -> int:
    """Where cycles begin: at once, or where the film has come back first from a hold beside the levels between which they go."""
    reach = float(np.ptp(moved))
    near = np.abs(moved[turns] - moved[0]) < _TURNS * reach
    ends_there = turns.size == 1 and abs(float(moved[-1] - moved[0])) < _TURNS * reach
    return 0 if near.any() or ends_there else int(turns[0]) if turns.size > 1 else 0


def _join_holds(found: list[Segment]) -> list[Segment]:
    """Steps that follow each other without a rest between them are one test with several steps."""
    joined: list[Segment] = []
    for segment in found:
        if joined and segment.is_hold and joined[-1].is_hold and not segment.comes_back:
            joined[-1] = replace(joined[-1], last=segment.last)
        else:
            joined.append(segment)
    return joined
