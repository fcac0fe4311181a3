"""The quantities a recording may hold, with their canonical units."""

from __future__ import annotations

import math
from dataclasses import dataclass

from schemas.alike import ask_meant
from schemas.errors import RefusedError
from schemas.units import ANY


@dataclass(frozen=True)
class Quantity:
    """One physical quantity: its name in files and SQL, its canonical unit and what it means.

    Values below `least` or above `largest` (canonical unit) are no reading of it: limits of what exists, not of a rig.
    """

    name: str
    unit: str
    meaning: str
    least: float = -math.inf
    largest: float = math.inf


_ALL = (
    Quantity("command", "V", "input of the high-voltage amplifier", -1e4, 1e4),
    Quantity("voltage", "kV", "monitored output of the amplifier", -1e4, 1e4),
    Quantity("force", "N", "load cell, tension positive", -1e6, 1e6),
    Quantity("displacement", "mm", "driven end, extension positive", -1e5, 1e5),
    Quantity("capacitance", "pF", "sensing region", -1e12, 1e12),
    Quantity("demand", "pF", "set point of the capacitance in closed loop", -1e12, 1e12),
    Quantity("force_1", "N", "biaxial rig, direction 1, tension positive", -1e6, 1e6),
    Quantity("force_2", "N", "biaxial rig, direction 2, tension positive", -1e6, 1e6),
    Quantity("leakage_current", "µA", "current through the film", -1e9, 1e9),
    Quantity("temperature", "degC", "temperature at the specimen", -273.15, 3000.0),
    Quantity("stress", "kPa", "nominal stress", -1e8, 1e8),
    Quantity("stretch", "1", "length over undeformed length", 1e-3, 1e3),
    Quantity("pressure", "bar", "pressure", -1e5, 1e5),
    Quantity("input", ANY, "input of a system of another kind"),
    Quantity("output", ANY, "output of a system of another kind"),
)
QUANTITIES: dict[str, Quantity] = {q.name: q for q in _ALL}


def quantity(name: str, *, where: str = "") -> Quantity:
    """The quantity of that name; `RefusedError` for a name that is not in the contract."""
    try:
        return QUANTITIES[name]
    except KeyError:
        raise RefusedError(
            f'quantity "{name[:80]}" is unknown{ask_meant(name, QUANTITIES)}',
            where=where,
            expected="one of " + ", ".join(QUANTITIES),
            remedy="Rename the channel or map it in the TOML beside the file",
        ) from None
