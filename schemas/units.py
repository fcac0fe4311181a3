"""Units of measurement: parsing and conversion to the canonical unit, once, at the door.

The parser is pint's. It takes half a second to import and the rigs mostly send a dozen plain names, so these have a
table of their own and pint is loaded only for a name that is not in it. `tests/unit/test_units.py` holds the table
against pint.
"""

from __future__ import annotations

import functools
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from schemas.alike import ask_meant
from schemas.arrays import Float
from schemas.errors import MissingExtraError, RefusedError

ANY = "any"
"""Canonical unit of quantities that keep whatever unit they come in."""

_UNIT_TEXT = re.compile(r"[\w µμΩ°%·*/^().-]{1,60}")
_ODD_POWER = re.compile(r"(?:\*\*|\^)(?!\s*-?\d(?![\d.*^]))")
"""A power that is not one digit: nothing a unit needs, and a way to make the parser compute for hours."""


_WORD = re.compile(r"[A-Z][A-Za-z]*[a-z]{3,}|[A-Z]{5,}")
"""A unit written out with capitals (`Newtons`, `VOLTS`): names of units are written small, symbols are shorter."""
_BARE_POWER = re.compile(r"(?<=[A-Za-zµ])([23])(?![\w.])")
"""A power as exporters write it (`N/mm2`)."""
_RATIOS = ("dB", "dBm", "dBV", "Np", "decibel", "neper")
_POWERS = str.maketrans({"²": "^2", "³": "^3", "⁻": "^-"})


@dataclass(frozen=True)
class Conversion:
    """value in the canonical unit = scale × (value in the source unit) + offset."""

    scale: float
    offset: float = 0.0

    @property
    def is_identity(self) -> bool:
        return self.scale == 1.0 and self.offset == 0.0

    def apply(self, values: Float) -> Float:
        """Converted values; the input array itself where nothing changes. Shapes as given; what overflows is infinite."""
        if self.is_identity:
            return values
        with np.errstate(over="ignore", invalid="ignore"):
            return values * self.scale + self.offset

    def apply_difference(self, value: float) -> float:
        """Converts a difference of two values (a resolution, a standard deviation): no offset."""
        return value * self.scale


_COMMON: dict[str, dict[str, float]] = {
    "V": {"V": 1.0, "volt": 1.0, "mV": 1e-3, "kV": 1e3},
    "kV": {"kV": 1.0, "V": 1e-3, "volt": 1e-3, "mV": 1e-6},
    "N": {"N": 1.0, "newton": 1.0, "mN": 1e-3, "kN": 1e3, "cN": 1e-2, "µN": 1e-6, "uN": 1e-6},
    "mm": {"mm": 1.0, "m": 1e3, "cm": 10.0, "µm": 1e-3, "um": 1e-3, "nm": 1e-6, "in": 25.4, "inch": 25.4},
    "pF": {"pF": 1.0, "nF": 1e3, "fF": 1e-3, "F": 1e12, "µF": 1e6, "uF": 1e6},
    "µA": {"µA": 1.0, "uA": 1.0, "A": 1e6, "mA": 1e3, "nA": 1e-3},
    "degC": {"degC": 1.0, "°C": 1.0, "℃": 1.0, "C": 1.0},
    "kPa": {"kPa": 1.0, "Pa": 1e-3, "MPa": 1e3},
    "1": {"1": 1.0, "": 1.0, "-": 1.0, "%": 1e-2, "percent": 1e-2},
    "bar": {"bar": 1.0, "mbar": 1e-3, "kPa": 1e-2, "Pa": 1e-5},
    "s": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "µs": 1e-6, "us": 1e-6, "min": 60.0, "h": 3600.0, "ns": 1e-9, "d": 86400.0},
    "Hz": {"Hz": 1.0, "kHz": 1e3, "mHz": 1e-3, "rad/s": 1 / math.tau, "krad/s": 1e3 / math.tau},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "°": math.pi / 180},
    "MPa": {"MPa": 1.0, "Pa": 1e-6, "kPa": 1e-3, "GPa": 1e3},
    "N/mm": {"N/mm": 1.0, "N/m": 1e-3, "kN/m": 1.0},
}
_WORDS = {
    canonical: tuple(f"{prefix}{word}" for prefix in ("", "micro", "milli", "centi", "kilo", "mega"))
    for canonical, word in {
        "V": "volt", "kV": "volt", "N": "newton", "mm": "meter", "pF": "farad", "µA": "ampere", "kPa": "pascal",
        "MPa": "pascal", "bar": "bar", "s": "second", "Hz": "hertz", "rad": "radian",
    }.items()
}  # fmt: skip
"""Units written out, for people who mistype them."""
_SPELLINGS = {
    "μ": "µ",
    "℃": "degC",
    "°C": "degC",
    "°F": "degF",
    "gf": "gram_force",
    "kgf": "kilogram_force",
    "kp": "kilogram_force",
    "deg C": "degC",
    "Deg C": "degC",
    "DEG C": "degC",
    "DegC": "degC",
    "degrees C": "degC",
    "degrees Celsius": "degC",
    "Degrees Celsius": "degC",
    "Grad Celsius": "degC",
    "KV": "kV",
    "KN": "kN",
    "Bar": "bar",
    "BAR": "bar",
    "PSI": "psi",
    "mSec": "ms",
    "Amps": "ampere",
    "amps": "ampere",
    "Deg": "deg",
    "Grad": "deg",
    "Sek": "s",
    "sek": "s",
    "Sekunden": "s",
    "Min": "min",
    "mins": "min",
    "Minuten": "min",
    "Std": "h",
    "Stunden": "h",
    "hrs": "h",
    "hr": "h",
    "毫秒": "ms",
    "秒": "s",
    "毫米": "mm",
    "微米": "µm",
    "毫牛": "mN",
    "牛": "N",
    "千伏": "kV",
    "伏": "V",
    "皮法": "pF",
    "微安": "µA",
    "\u00a0": " ",
}


@functools.cache
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry(autoconvert_offset_to_baseunit=True, cache_folder=None)
    registry.define("percent = 0.01 = %")
    return registry


def _spelled(unit: str) -> str:
    text = unit.strip()
    for written, meant in _SPELLINGS.items():
        if text == written or (len(written) == 1 and not written.isascii()):
            text = text.replace(written, meant)
    text = text.translate(_POWERS)
    return _BARE_POWER.sub(r"^\1", _WORD.sub(lambda word: word.group().lower(), text))


@functools.lru_cache(maxsize=1024)
def conversion(unit: str, canonical: str, *, where: str = "") -> Conversion:
    """Conversion from `unit` to `canonical`.

    Raises `RefusedError` when the unit is unknown or its dimension differs from the canonical unit's, and its kind
    `MissingExtraError` for an uncommon unit where pint is not installed, as on a rig that only writes.
    """
    if canonical == ANY or unit == canonical:
        return Conversion(1.0)
    text = _spelled(unit)
    common = _COMMON.get(canonical, {})
    if text in common:
        return Conversion(common[text])
    if text in _RATIOS:
        raise RefusedError(
            f'unit "{text}" is the logarithm of a ratio', where=where, expected=f"a unit that converts to {canonical}"
        )
    if canonical == "Hz" and not text.endswith(("Hz", "hertz")):
        raise RefusedError(
            f'unit "{text[:60]}" may mean cycles or radians per second', where=where, expected="Hz, kHz, mHz or rad/s"
        )
    return _parsed_conversion(text, canonical, where)


def _parsed_conversion(text: str, canonical: str, where: str) -> Conversion:
    try:
        import pint
    except ModuleNotFoundError:
        raise MissingExtraError(
            f'reading the unit "{text[:60]}" needs pint, which is not installed',
            where=where,
            expected=f"one of {', '.join(filter(None, _COMMON.get(canonical, {canonical: 1.0})))}",
            remedy="Install pint, or give the values in one of these units",
        ) from None
    registry = _registry()
    refused = functools.partial(
        RefusedError, where=where, remedy="Correct the channel's unit at the source and send the file again"
    )
    if not _UNIT_TEXT.fullmatch(text) or _ODD_POWER.search(text):
        raise refused(f'unit "{text[:60]}" is not a unit', expected=f"a unit that converts to {canonical}")
    try:
        source = registry.Unit(text)
        target = registry.Unit({"1": "dimensionless", "degC": "degC"}.get(canonical, canonical))
    except Exception as error:  # pint raises a dozen kinds, tokenizer errors included, for text that is no unit
        meant = ask_meant(text, (*_COMMON.get(canonical, {}), *_WORDS.get(canonical, ())))
        raise refused(f'unit "{text}" is unknown{meant}', expected=f"a unit that converts to {canonical}") from error
    try:
        zero, one = (float(registry.Quantity(v, source).to(target).magnitude) for v in (0.0, 1.0))
    except (pint.DimensionalityError, pint.OffsetUnitCalculusError, ArithmeticError) as error:
        dimension = str(source.dimensionality)
        raise refused(
            f'unit "{text}" has the dimension {dimension}', expected=f"a unit that converts to {canonical}"
        ) from error
    if not (np.isfinite(zero) and np.isfinite(one)) or one == zero:
        raise refused(f'unit "{text}" has no finite conversion', expected=f"a unit that converts to {canonical}")
    return Conversion(one - zero, zero)
