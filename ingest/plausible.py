"""Values that a quantity cannot have: marks of instruments that look like numbers, and units that are beyond belief.

A few such samples are lost (NULL, a problem); where most are, the unit or the column is wrong and the channel is
refused. Shared by all formats: it looks at canonical units, after every reader. Limits of channels:
`schemas.quantities.Quantity`; of columns of tables: here.
"""

from __future__ import annotations

import numpy as np

from schemas.arrays import Bool, Float
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


def find_losses_by_value(values: Float) -> str:
    """What is common to all lost samples (not finite) of (n,) values, where they are lost by what they were; empty where by chance.

    Each gap is looked at by the samples on both sides of it, which are about as large as what was lost. Where the edges
    of all gaps lie below nearly everything that was kept, the low ones were lost; in the same way the small ones of either
    sign. Lost large ones are what an instrument does beyond its range, and no choice.

    Ranks of gaps that fall by chance are uniform: the mean of k of them is below m with a probability of (e m)^k at most.
    """
    lost = ~np.isfinite(values)
    edges = np.flatnonzero(np.diff(lost.astype(np.int8)))
    starts = edges[~lost[edges]]
    ends = edges[lost[edges]] + 1
    if starts.size < _FEWEST_GAPS or starts[-1] - starts[0] < _SPREAD * values.size:
        return ""
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
