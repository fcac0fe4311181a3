"""Values that a quantity cannot have: marks of instruments that look like numbers, and units that are beyond belief.

A few such samples are lost (NULL, a problem); where most are, the unit or the column is wrong and the channel is
refused. Shared by all formats: it looks at canonical units, after every reader. Limits of channels:
`schemas.quantities.Quantity`; of columns of tables: here.
"""

from __future__ import annotations

import numpy as np

from schemas.arrays import Bool, Float, Int
from schemas.errors import RefusedError
from schemas.quantities import QUANTITIES, Quantity

_SCPI = 9.8e37
"""IEEE 488.2 instruments send 9.9E37 for overload, −9.9E37 for underload and 9.91E37 for no number."""
_DUMMIES = (
    9.969209968386869e36,
    999.0,
    9999.0,
    99999.0,
    999999.0,
    999.25,
    32767.0,
    32768.0,
    65535.0,
    2147483647.0,
    2147483648.0,
    1e30,
)
"""Sizes of values that loggers write where they have none; the first is what netCDF fills arrays with."""
_BEYOND = 50.0
"""A dummy value stands this many times beyond everything else in its channel; a true reading of that size would not be
the only one."""


def find_marks(raw: Float) -> dict[str, Bool]:
    """Samples as the file has them that are marks: what they are → (n,) true where one stands."""
    size = np.where(np.isfinite(raw), raw, 0.0)
    np.abs(size, out=size)
    overload = size >= _SCPI
    found = {"overload (9.9E37) of an instrument": overload} if overload.any() else {}
    for dummy in _DUMMIES:
        here = size == dummy
        if not here.any():
            continue
        others = size[~here & ~overload]
        if others.size and dummy > _BEYOND * others.max() and here.sum() < others.size:
            found[f"the dummy value {raw[int(np.argmax(here))]:g}"] = here
    return found


_ALONE = 12.0
"""A spike is off the median of the two samples on either side this many times more than any other sample of its channel;
the most of 300 simulated responses to steps, sweeps, sinusoids and noise without one is 6.6."""
_MOST_SPIKES, _FAR = 5, 3
"""Spikes of a channel beyond which they are what it does, and samples that they lie apart: an edge has two beside each other."""
_AN_EDGE = 10.0
"""Times its usual step from which a movement of what drives is an edge, which a response may answer with one sample."""
_OF_AN_EDGE = 1000.0
"""Size of that sample over all others of its channel, at most."""


def find_spikes(values: Float, driven_by: Float) -> Bool:
    """(n,) true where a single sample of a response stands alone, and beyond all others by more than their range.

    Parameters
    ----------
    values, driven_by : (n,) the response, and what drives it at the same times
    """
    spikes = np.zeros(values.size, dtype=bool)
    places = np.flatnonzero(np.isfinite(values))
    if places.size < 4 * _FAR:
        return spikes
    kept = values[places]
    with np.errstate(over="ignore", invalid="ignore"):
        off = _off_neighbours(kept)
        steps = np.abs(np.diff(kept))
    order = np.argsort(-off)[: _MOST_SPIKES + 1]
    least = float(steps[steps > 0].min(initial=np.inf))
    for count in range(_MOST_SPIKES, 0, -1):
        alone = np.sort(order[:count])
        usual, others = max(off[order[count]], least), np.delete(kept, alone)
        with np.errstate(over="ignore"):
            beyond = np.maximum(kept[alone] - others.max(), others.min() - kept[alone]) > np.ptp(others)
        if off[alone].min() > _ALONE * usual and (np.diff(alone) >= _FAR).all() and beyond.all():
            answers = off[alone] < _OF_AN_EDGE * usual
            spikes[
                [
                    i
                    for i, small in zip(places[alone], answers, strict=True)
                    if not (small and _is_at_edge(driven_by, i))
                ]
            ] = True
            break
    return spikes


def _off_neighbours(kept: Float) -> Float:
    """(n,) how far each sample is off the median of the two on either side, at the ends of the four nearest."""
    here, end = np.arange(kept.size), kept.size - 1
    beside = []
    for away in (-2, -1, 1, 2):
        place = here + away
        instead = here - 2 * away - np.sign(away)
        beside.append(kept[np.where((place < 0) | (place > end), np.clip(instead, 0, end), place)])
    _, lower, upper, _ = np.sort(beside, axis=0)
    return np.asarray(np.abs(kept - (lower / 2 + upper / 2)))


def _is_at_edge(driven_by: Float, place: int) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.abs(np.diff(driven_by))
    here = steps[max(0, place - 2) : place + 2]
    return bool(np.nanmax(here, initial=0.0) > _AN_EDGE * np.nanmedian(steps))


def find_impossible(values: Float, quantity: Quantity) -> Bool:
    """(n,) true where a value in canonical units lies outside what the quantity can be."""
    with np.errstate(invalid="ignore"):
        return (values < quantity.least) | (values > quantity.largest)


_FLATTENED, _AT_FIRST = 0.3, 5
"""A stretch that no film bears, neither in the first samples of a record, where it is hardly deformed, nor in most of it."""


def is_strain(stretch: Float) -> bool:
    """Whether samples (n,) of a stretch are those of a strain: they begin at 0, or stay below a third."""
    seen = stretch[np.isfinite(stretch)]
    if seen.size < _AT_FIRST:
        return False
    return bool(min(abs(np.median(seen[:_AT_FIRST])), abs(np.median(seen))) < _FLATTENED)


_FEWEST_GAPS = 3
_BY_CHANCE = 5e-7
"""Probability of edges of gaps at so low ranks among all other kept samples where gaps fall by chance: once in two million channels."""
_EXTREME = 0.06
"""Mean rank of the edges among all others that were kept above which they are not low, however many gaps there are."""
_SPREAD = 0.5
"""Share of the record over which the gaps must lie: a plug that was loose for a while is no choice by value."""
_AT_ZERO = 2.5
"""A sample lies at zero within this many median steps from sample to sample: a sinusoid's step there is 1.4 times its median."""
_BY_CHANCE_AT_ZERO = 1e-3
"""Probability of gaps that all begin and end at zero, or at a whole number, where they fall by chance. Of 6000
simulated channels of six shapes with one to four gaps anywhere, rectified ones among them, 3 were taken for a choice."""

_DECIMALS = (0.1, 0.01)
"""Steps of values of so few decimals that whole numbers are to be expected among them."""

_MOST_OF_GAPS = 0.8
"""Share of the gaps that stand at a whole number; beside a turn of a noisy course one may not."""


def find_losses_by_value(values: Float) -> str:
    """What is common to all lost samples (not finite) of (n,) values, where they are lost by what they were; empty where by chance.

    Each gap is looked at by the samples beside it, which are about as large as what was lost: where they all stand at
    zero and nothing was kept beyond it, one sign was lost, also before the first sample kept and after the last; where
    gaps stand at whole numbers and none was kept, the whole numbers; where they lie below nearly everything else that was kept, the low ones; in the same way the small ones of either sign.
    Lost large ones are what an instrument does beyond its range, and no choice.
    """
    lost = ~np.isfinite(values)
    edges = np.flatnonzero(np.diff(lost.astype(np.int8)))
    if not edges.size:
        return ""
    starts = edges[~lost[edges]]
    ends = edges[lost[edges]] + 1
    if starts.size >= _FEWEST_GAPS and starts[-1] - starts[0] >= _SPREAD * values.size:
        what = _find_low_edges(values, lost, starts, ends)
        if what:
            return what
    with np.errstate(over="ignore", invalid="ignore"):
        for sign, what in ((1, "the negative ones"), (-1, "the positive ones")):
            if _is_a_sign_lost(sign * values, lost, np.concatenate([starts, ends])):
                return what
        return "the whole numbers" if _are_whole_numbers_lost(values[~lost], lost) else ""


def _is_a_sign_lost(values: Float, lost: Bool, edges: Int) -> bool:
    """Whether all samples beside gaps, at `edges`, stand at zero by more than chance, where no sample of (n,) is negative.

    A sample stands at zero when it does so within the usual step, or when the step that leads to it would lead below.
    """
    kept = ~lost
    least = values[kept].min()
    if least < 0 or not values[kept].any():
        return False
    steps = np.diff(values)
    usual = _AT_ZERO * float(np.median(np.abs(steps[np.isfinite(steps)]))) if np.isfinite(steps).any() else 0.0
    if least > usual:
        return False
    into, out_of = np.append(np.nan, steps), np.append(steps, np.nan)
    at_zero = kept & ((values < usual) | (values + into < 0) | (values - out_of < 0))
    places = np.unique(edges)
    return bool(at_zero[places].all() and (at_zero.sum() / kept.sum()) ** places.size <= _BY_CHANCE_AT_ZERO)


def _are_whole_numbers_lost(kept: Float, lost: Bool) -> bool:
    """Whether gaps between kept samples (k,) of few decimals stand at whole numbers by more than chance, and none was kept."""
    least = next(
        (step for step in _DECIMALS if np.allclose(kept / step, np.round(kept / step), rtol=0, atol=1e-6)), None
    )
    if least is None or kept.size < 2 or (kept == np.round(kept)).any():
        return False
    low, high = np.minimum(kept[1:], kept[:-1]), np.maximum(kept[1:], kept[:-1])
    at_whole = np.floor(high + 1.5 * least) >= np.ceil(low - 1.5 * least)
    gaps = np.diff(np.flatnonzero(~lost)) > 1
    count, found = int(gaps.sum()), int(at_whole[gaps].sum())
    if not count or found < _MOST_OF_GAPS * count:
        return False
    past = high[np.floor(high) > low] - low[np.floor(high) > low]
    never_hit = np.prod(1 - np.minimum(least / past, 0.5))
    by_chance = min(1.0, 2.0**count * at_whole.mean() ** found)
    return bool(never_hit * by_chance <= _BY_CHANCE_AT_ZERO)


def _find_low_edges(values: Float, lost: Bool, starts: Int, ends: Int) -> str:
    """Whether the samples beside gaps are the lowest or the smallest of all.

    Ranks of gaps that fall by chance are uniform: the mean of k of them is below m with a probability of (e m)^k at most.
    """
    limit = min(_EXTREME, _BY_CHANCE ** (1 / starts.size) / np.e)
    away = ~lost
    away[[*starts, *ends]] = False
    others, beside = values[away], values[[*starts, *ends]]
    if not others.size:
        return ""
    for what, size, of_edges in (("the lowest", others, beside), ("the smallest", np.abs(others), np.abs(beside))):
        ordered = np.sort(size)
        ranks = np.searchsorted(ordered, of_edges, "left") + np.searchsorted(ordered, of_edges, "right")
        if np.mean(ranks) / (2 * size.size) <= limit:
            return what
    return ""


_LARGEST = {"MPa": 1e7, "N/mm": 1e9, "Hz": 1e30, "s": 1e30, "rad": 1e5, "mm": 1e5}
"""Largest size of what stands in tables, by canonical unit: no stiffer solid. Reduced times and frequencies of master
curves run over fifty decades."""
_OVER_DECADES = ("s", "Hz")
"""Lives, times and frequencies of a table may range so far that 999 is a value among others below 20."""


def find_unbelievable(raw: Float, values: Float, canonical: str) -> dict[str, Bool]:
    """Values of a table's column that are none: why → (n,) true where. `raw` as the file has them, `values` in `canonical`."""
    found = find_marks(raw)
    if canonical in _OVER_DECADES:
        found = {why: here for why, here in found.items() if "dummy" not in why}
    largest = _LARGEST.get(canonical, _of_channels(canonical))
    with np.errstate(invalid="ignore"):
        beyond = np.abs(values) > largest
    for here in found.values():
        beyond = beyond & ~here
    return found | ({f"beyond {largest:g} {canonical}": beyond} if beyond.any() else {})


def without_unbelievable(
    raw: Float, values: Float, name: str, canonical: str, problems: list[str], *, where: str
) -> Float:
    """The values of a table's column without those that are none, each kind a problem. `RefusedError` where most are."""
    for why, here in find_unbelievable(raw, values, canonical).items():
        count, given = int(here.sum()), int((~np.isnan(values)).sum())
        example = raw[int(np.argmax(here))]
        if 2 * count > given:
            raise RefusedError(
                f"{name}: {count} of {given} values are {why}, such as {example:g}",
                where=where,
                expected=f"values that there can be in {canonical}",
                remedy=f"Check column, unit and scale of [columns.{name}] in the mapping TOML",
            )
        problems.append(f"{name}: {count} of {given} values are {why}, such as {example:g}: left out")
        values = np.where(here, np.nan, values)
    return values


def _of_channels(canonical: str) -> float:
    """The largest size of channels in a canonical unit."""
    sizes = [max(-q.least, q.largest) for q in QUANTITIES.values() if q.unit == canonical]
    return max(sizes, default=np.inf)
