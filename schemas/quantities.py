"""The quantities a recording may hold, with their canonical units."""

from __future__ import annotations

from dataclasses import dataclass

from schemas.errors import RefusedError
from schemas.units import ANY


@dataclass(frozen=True)
class Quantity:
    """One physical quantity: its name in files and SQL, its canonical unit and what it means."""

    name: str
    unit: str
    meaning: str


_ALL = (
    Quantity("command", "V", "input of the high-voltage amplifier"),
    Quantity("voltage", "kV", "monitored output of the amplifier"),
    Quantity("force", "N", "load cell, tension positive"),
    Quantity("displacement", "mm", "driven end, extension positive"),
    Quantity("capacitance", "pF", "sensing region"),
    Quantity("demand", "pF", "set point of the capacitance in closed loop"),
    Quantity("force_1", "N", "biaxial rig, direction 1, tension positive"),
    Quantity("force_2", "N", "biaxial rig, direction 2, tension positive"),
    Quantity("leakage_current", "µA", "current through the film"),
    Quantity("temperature", "degC", "temperature at the specimen"),
    Quantity("stress", "kPa", "nominal stress"),
    Quantity("stretch", "1", "length over undeformed length"),
    Quantity("pressure", "bar", "pressure"),
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
            f'quantity "{name[:80]}" is unknown',
            where=where,
            expected="one of " + ", ".join(QUANTITIES),
            remedy="Rename the channel or map it in the TOML beside the file",
        ) from None
