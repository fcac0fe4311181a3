"""Values that a quantity cannot have: marks of instruments that look like numbers, and units that are beyond belief.

A few such samples are lost (NULL, a problem); where most are, the unit or the column is wrong and the channel is
refused. Shared by all formats: it looks at canonical units, after every reader. Limits: `schemas.quantities.Quantity`.
"""

from __future__ import annotations

import numpy as np

from schemas.arrays import Bool, Float
from schemas.quantities import Quantity

_SCPI = 9.8e37
"""IEEE 488.2 instruments send 9.9E37 for overload, −9.9E37 for underload and 9.91E37 for no number."""
_DUMMIES = (999.0, 9999.0, 99999.0, 999999.0, 999.25, 32767.0, 32768.0, 65535.0, 2147483647.0, 2147483648.0, 1e30)
"""Sizes of values that loggers write where they have none."""
_BEYOND = 50.0
"""A dummy value stands this many times beyond everything else in its channel; a true reading of that size would not be
the only one."""


def find_marks(raw: Float) -> dict[str, Bool]:
    """Samples as the file has them that are marks: what they are → (n,) true where one stands."""
    size = np.abs(np.where(np.isfinite(raw), raw, 0.0))
    overload = size >= _SCPI
    found = {"overload (9.9E37) of an instrument": overload} if overload.any() else {}
    for dummy in _DUMMIES:
        here = size == dummy
        others = size[~here & ~overload]
        if here.any() and others.size and dummy > _BEYOND * others.max() and here.sum() < others.size:
            found[f"the dummy value {raw[int(np.argmax(here))]:g}"] = here
    return found


def find_impossible(values: Float, quantity: Quantity) -> Bool:
    """(n,) true where a value in canonical units lies outside what the quantity can be."""
    with np.errstate(invalid="ignore"):
        return (values < quantity.least) | (values > quantity.largest)
