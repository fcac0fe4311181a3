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
from schemas.arrays import Bool, Float
from schemas.units import Conversion

_FILLS = ("_FillValue", "missing_value")
_UNSIGNED = "_Unsigned"
"""Attribute of netCDF files whose classic types all have a sign: `true` says that the numbers have none."""
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
    turn: float = 0.0
    """What a negative raw number lacks, where whole numbers without a sign are kept in a type that has one; else 0."""
    codes: str = ""
    """What the numbers stand for, where they are those of an enumeration."""

    def unpack(self, raw: Numbers) -> Numbers:
        """The numbers that are meant, with notes about what was done."""
        values = _turned(raw.values, self.turn)
        none: Bool = np.isin(values, self.missing) | (values < self.least) | (values > self.largest)
        notes = []
        if self.codes:
            notes.append(f"the numbers are codes: {self.codes}")
        if self.turn:
            notes.append(f"whole numbers without a sign: negative ones stand for {self.turn:g} more ({_UNSIGNED})")
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


def _turned(values: Float, turn: float) -> Float:
    return np.where(values < 0, values + turn, values) if turn else values


def packing_of(attributes: Mapping[str, Any], *, whole_numbers: bool, signed_bits: int = 0) -> Packing | None:
    """What the attributes of an array say about its numbers; None where they say nothing.

    `signed_bits`: how many bits its whole numbers have, where their type has a sign; else 0.
    """
    known = {name: number for name, value in attributes.items() if (number := _number(value)) is not None}
    scale, offset = known.get("scale_factor"), known.get("add_offset")
    used: list[str] = [name for name in ("scale_factor", "add_offset") if name in known]
    if scale is None and offset is None and "conversion" in known and "unit" in attributes:
        scale, offset = known["conversion"], known.get("offset")
        used = [name for name in ("conversion", "offset") if name in known]
    fills = [(name, fill) for name in _FILLS if name in attributes for fill in _numbers(attributes[name])]
    turn = 2.0**signed_bits if signed_bits and _says_true(attributes.get(_UNSIGNED)) else 0.0
    fills = [(name, float(_turned(np.array(fill), turn))) for name, fill in fills]
    bounds = _bounds(attributes, known, turn)
    names = (*used, *dict.fromkeys(name for name, _ in fills), *(("valid range",) if bounds != _NO_BOUNDS else ()))
    doubtful = find_scales(attributes) if whole_numbers and not used else ()
    if not names and not doubtful and not turn:
        return None
    missing = tuple(dict.fromkeys(fill for _, fill in fills))
    return Packing(
        1.0 if scale is None else scale, 0.0 if offset is None else offset, missing, *bounds, names, doubtful, turn
    )


def find_scales(attributes: Mapping[str, Any]) -> tuple[str, ...]:
    """Attributes of no agreed meaning that may be the scale of whole numbers, with their values."""
    known = {name: _number(value) for name, value in attributes.items() if _plain(name) in _LIKE_A_SCALE}
    return tuple(f"{name} = {value:g}" for name, value in known.items() if value is not None)


_NO_BOUNDS = (-math.inf, math.inf)


def _bounds(attributes: Mapping[str, Any], known: Mapping[str, float], turn: float) -> tuple[float, float]:
    """Lowest and highest raw value that counts, of numbers that are turned as `Packing.turn` says."""
    both = _numbers(attributes.get("valid_range"))
    least, largest = both if len(both) == 2 else (known.get("valid_min"), known.get("valid_max"))
    return (
        -math.inf if least is None else float(_turned(np.array(least), turn)),
        math.inf if largest is None else float(_turned(np.array(largest), turn)),
    )


def _says_true(value: Any) -> bool:
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return text.strip().casefold() == "true"


def _plain(name: str) -> str:
    return "".join(c for c in name.casefold() if c.isalnum())


def _numbers(value: Any) -> tuple[float, ...]:
    array = np.asarray(value).reshape(-1)
    return tuple(float(v) for v in array) if array.dtype.kind in "iuf" and array.size <= 16 else ()


def _number(value: Any) -> float | None:
    found = _numbers(value)
    return found[0] if len(found) == 1 and math.isfinite(found[0]) else None
