"""Numbers that a binary file stores in another form than it means: scale, offset and marks of missing values by attribute.

netCDF and CF pack with `scale_factor`, `add_offset`, `_FillValue`, `missing_value` and a valid range; Neurodata Without
Borders scales with `conversion` and `offset`. Other attributes that look like a scale (`gain`, `slope`) have no agreed
meaning: whole numbers that have one are refused until the mapping says what their scale is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ingest.columns import Numbers
from schemas.arrays import Bool
from schemas.units import Conversion

_FILLS = ("_FillValue", "missing_value")
_LIKE_A_SCALE = frozenset(
    [
        "scale", "scaling", "scalefactor", "gain", "slope", "intercept", "lsb", "factor", "multiplier", "calibration",
        "calibrationfactor", "conversionfactor", "calfactor", "sensitivity", "unitspercount", "voltspercount", "offset",
        "conversion", "zero",
    ]
)  # fmt: skip
"""Names of attributes, small and without marks, that may be a scale and may be a note about the amplifier."""


@dataclass(frozen=True)
class Packing:
    """value = scale × raw + offset; raw values in `missing`, or outside of `least` to `largest`, stand for none.

    `names` are the attributes that say so. `doubtful` are others that may be a scale as well.
    """

    scale: float = 1.0
    offset: float = 0.0
    missing: tuple[float, ...] = ()
    least: float = -math.inf
    largest: float = math.inf
    names: tuple[str, ...] = ()
    doubtful: tuple[str, ...] = ()

    def unpack(self, raw: Numbers) -> Numbers:
        """The numbers that are meant, with notes about what was done."""
        values = raw.values
        none: Bool = np.isin(values, self.missing) | (values < self.least) | (values > self.largest)
        notes = []
        change = Conversion(self.scale, self.offset)
        if not change.is_identity:
            notes.append(f"packed: {self.scale:g} × raw {self.offset:+g} ({', '.join(self.names)})")
            values = change.apply(values)
        if none.any():
            values = np.where(none, math.nan, values)
            notes.append(f"{int(none.sum())} samples stand for no value ({', '.join(self.names)})")
        return replace(
            raw,
            values=values,
            empty=raw.empty | none,
            notes=(*raw.notes, *notes),
            unpacked=None if change.is_identity else change,
            doubtful=self.doubtful,
        )


def packing_of(attributes: Mapping[str, Any], *, whole_numbers: bool) -> Packing | None:
    """What the attributes of an array say about its numbers; None where they say nothing."""
    known = {name: number for name, value in attributes.items() if (number := _number(value)) is not None}
    scale, offset = known.get("scale_factor"), known.get("add_offset")
    used: list[str] = [name for name in ("scale_factor", "add_offset") if name in known]
    if scale is None and offset is None and "conversion" in known and "unit" in attributes:
        scale, offset = known["conversion"], known.get("offset")
        used = [name for name in ("conversion", "offset") if name in known]
    fills = [(name, fill) for name in _FILLS if name in attributes for fill in _numbers(attributes[name])]
    bounds = _bounds(attributes, known)
    names = (*used, *dict.fromkeys(name for name, _ in fills), *(("valid range",) if bounds != _NO_BOUNDS else ()))
    doubtful = find_scales(attributes) if whole_numbers and not used else ()
    if not names and not doubtful:
        return None
    missing = tuple(dict.fromkeys(fill for _, fill in fills))
    return Packing(
        1.0 if scale is None else scale, 0.0 if offset is None else offset, missing, *bounds, names, doubtful
    )


def find_scales(attributes: Mapping[str, Any]) -> tuple[str, ...]:
    """Attributes of no agreed meaning that may be the scale of whole numbers, with their values."""
    known = {name: _number(value) for name, value in attributes.items() if _plain(name) in _LIKE_A_SCALE}
    return tuple(f"{name} = {value:g}" for name, value in known.items() if value is not None)


_NO_BOUNDS = (-math.inf, math.inf)


def _bounds(attributes: Mapping[str, Any], known: Mapping[str, float]) -> tuple[float, float]:
    """Lowest and highest raw value that counts."""
    both = _numbers(attributes.get("valid_range"))
    if len(both) == 2:
        return both[0], both[1]
    return known.get("valid_min", -math.inf), known.get("valid_max", math.inf)


def _plain(name: str) -> str:
    return "".join(c for c in name.casefold() if c.isalnum())


def _numbers(value: Any) -> tuple[float, ...]:
    array = np.asarray(value).reshape(-1)
    return tuple(float(v) for v in array) if array.dtype.kind in "iuf" and array.size <= 16 else ()


def _number(value: Any) -> float | None:
    found = _numbers(value)
    return found[0] if len(found) == 1 and math.isfinite(found[0]) else None
