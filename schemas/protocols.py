"""The test protocols: what is loaded, and which channels a recording must have to be one."""

from __future__ import annotations

from dataclasses import dataclass

from schemas.alike import ask_meant
from schemas.errors import RefusedError


@dataclass(frozen=True)
class Protocol:
    """One way of testing.

    `required` lists alternatives: a recording needs every channel of at least one of them.
    """

    name: str
    loading: str
    required: tuple[tuple[str, ...], ...]
    optional: tuple[str, ...]
    meaning: str


MECHANICAL, ELECTRICAL, CALIBRATION, OTHER = "mechanical", "electrical", "calibration", "other"
LOADINGS = (MECHANICAL, ELECTRICAL, CALIBRATION, OTHER)
_DRIVEN = (("displacement", "force"), ("stretch", "stress"))
_IN_OUT = (("input", "output"),)

_ALL = (
    Protocol("chirp", MECHANICAL, _DRIVEN, ("temperature",), "sweep, one or several repeats"),
    Protocol("chirp", ELECTRICAL, (("voltage", "force"),), ("command", "capacitance"), "sweep of the voltage"),
    Protocol("chirp", OTHER, _IN_OUT, (), "sweep of a system of another kind"),
    Protocol(
        "sphs",
        ELECTRICAL,
        (("voltage", "force"),),
        ("command", "capacitance"),
        "Schroeder-phased harmonic sequence, periodic",
    ),
    Protocol("sphs", OTHER, _IN_OUT, (), "periodic multisine of a system of another kind"),
    Protocol("noise", MECHANICAL, _DRIVEN, ("temperature",), "random movement"),
    Protocol("noise", OTHER, _IN_OUT, (), "random input of a system of another kind"),
    Protocol("cyclic", MECHANICAL, _DRIVEN, ("capacitance",), "sinusoid at one frequency and one strain"),
    Protocol(
        "step",
        ELECTRICAL,
        (("voltage", "force"),),
        ("capacitance", "demand", "command"),
        "steps on and off, open or closed loop",
    ),
    Protocol("step", MECHANICAL, _DRIVEN, (), "step and hold: stress relaxation"),
    Protocol("step", OTHER, _IN_OUT, (), "step of a system of another kind"),
    Protocol(
        "isotonic",
        ELECTRICAL,
        (("voltage", "displacement"),),
        ("force", "command", "capacitance", "leakage_current", "temperature"),
        "strokes at constant load under levels of voltage",
    ),
    Protocol(
        "lifetime",
        ELECTRICAL,
        (("voltage",),),
        ("force", "leakage_current", "command"),
        "constant voltage until breakdown or end of test",
    ),
    Protocol(
        "force_map",
        ELECTRICAL,
        (("voltage", "force_1", "force_2"),),
        (),
        "static force on and off at one pair of pre-stretches",
    ),
    Protocol(
        "coverage", ELECTRICAL, (("capacitance",),), (), "capacitance at rest after a number of coats of electrode"
    ),
    Protocol("cycle", MECHANICAL, _DRIVEN, (), "one large load-unload cycle (triangle)"),
    Protocol(
        "cycle",
        ELECTRICAL,
        (("voltage", "force"),),
        ("command", "capacitance", "leakage_current"),
        "a voltage that goes up and down slowly, once or several times",
    ),
    Protocol(
        "creep", MECHANICAL, _DRIVEN, ("temperature",), "a load that is put on, held and taken off: creep and recovery"
    ),
    Protocol("pull", MECHANICAL, _DRIVEN, (), "pulled at one rate until it breaks"),
    Protocol("tap", CALIBRATION, (("force",),), (), "the clamp without film rings: its frequency and damping"),
    Protocol("weight", CALIBRATION, (("force",),), (), "known masses on the load cell: gain and offset"),
)
PROTOCOLS: dict[tuple[str, str], Protocol] = {(p.name, p.loading): p for p in _ALL}
PROTOCOL_NAMES: tuple[str, ...] = tuple(dict.fromkeys(p.name for p in _ALL))


def protocol(name: str, loading: str, *, where: str = "") -> Protocol:
    """The protocol of that name and loading; `RefusedError` names what would have been right."""
    if name not in PROTOCOL_NAMES:
        raise RefusedError(
            f'protocol "{name[:80]}" is unknown{ask_meant(name, PROTOCOL_NAMES)}',
            where=where,
            expected="one of " + ", ".join(PROTOCOL_NAMES),
        )
    try:
        return PROTOCOLS[name, loading]
    except KeyError:
        fitting = ", ".join(p.loading for p in _ALL if p.name == name)
        raise RefusedError(
            f'loading "{loading[:80]}" does not go with protocol {name}', where=where, expected=fitting
        ) from None


def missing_channels(found: Protocol, channels: set[str]) -> tuple[str, ...]:
    """The required channels that are missing, for the alternative that lacks least; empty when complete."""
    return min((tuple(c for c in alternative if c not in channels) for alternative in found.required), key=len)
