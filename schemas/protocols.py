"""The test protocols: what is loaded, and which channels a recording must have to be one."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from types import MappingProxyType

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

_SWEPT = (("chirp", MECHANICAL), ("chirp", ELECTRICAL), ("chirp", OTHER))
_SPHS = (("sphs", ELECTRICAL), ("sphs", OTHER))
_NOISE = (("noise", MECHANICAL), ("noise", OTHER))
_STEPPED = (("step", ELECTRICAL), ("isotonic", ELECTRICAL), ("force_map", ELECTRICAL), ("cycle", ELECTRICAL))
_LIFE = (("lifetime", ELECTRICAL),)
_LARGE_CYCLE = (("cycle", MECHANICAL),)
_LOADED = (("creep", MECHANICAL), ("isotonic", ELECTRICAL))
_IN_A_SESSION = (
    ("chirp", MECHANICAL),
    ("cyclic", MECHANICAL),
    ("step", MECHANICAL),
    *_LARGE_CYCLE,
    ("sphs", ELECTRICAL),
    ("step", ELECTRICAL),
)
KEYS_OF_TESTS: Mapping[str, tuple[tuple[str, str], ...]] = MappingProxyType(
    {
        "frequency_start_hz": (*_SWEPT, *_SPHS, *_NOISE),
        "frequency_stop_hz": (*_SWEPT, *_SPHS, *_NOISE),
        "sweep": _SWEPT,
        "repeats": _SWEPT,
        "period_s": (*_SWEPT, *_SPHS, ("noise", OTHER)),
        "periods": _SPHS,
        "lines": _SPHS,
        "frequency_hz": (("cyclic", MECHANICAL), *_LIFE),
        "cycles": (("cyclic", MECHANICAL),),
        "drive_kv": (*_SPHS, ("chirp", ELECTRICAL), *_STEPPED),
        "on_s": (*_STEPPED, ("chirp", ELECTRICAL), ("sphs", ELECTRICAL)),
        "off_s": _STEPPED,
        "controller": (("step", ELECTRICAL),),
        "proportional_gain": (("step", ELECTRICAL),),
        "integral_gain": (("step", ELECTRICAL),),
        "masses_kg": (("weight", CALIBRATION),),
        "extra_clamp_mass_kg": (*_IN_A_SESSION, ("chirp", ELECTRICAL), ("noise", MECHANICAL), ("tap", CALIBRATION)),
        "load_n": _LOADED,
        "voltage_setpoint_kv": _LIFE,
        "test_duration_s": _LIFE,
        "failure_site": _LIFE,
        "failure_region": _LIFE,
        "rest_before_s": _IN_A_SESSION,
        "coats": (("coverage", ELECTRICAL),),
        "crosslink_modulus_kpa": _LARGE_CYCLE,
        "entanglement_modulus_kpa": _LARGE_CYCLE,
        "largest_stretch": _LARGE_CYCLE,
    }
)
"""Keys of a recording that say how one kind of test was run: the protocols and loadings of which something is made of them."""


@dataclass(frozen=True)
class Need:
    """Keys without which a test cannot be simulated, so that no diagnosis is made from it; `unless` it has this channel."""

    keys: tuple[str, ...]
    unless: str = ""


NEEDS: Mapping[tuple[str, str], Need] = MappingProxyType(
    {
        ("chirp", MECHANICAL): Need(("frequency_start_hz", "frequency_stop_hz")),
        ("cyclic", MECHANICAL): Need(("frequency_hz",)),
        ("cycle", MECHANICAL): Need(("film_length_mm",), unless="stretch"),
    }
)
"""By protocol and loading what a diagnosis needs and no record shows well enough. Other results may come all the same."""


WITH_RIG = (
    ("chirp", MECHANICAL),
    ("chirp", ELECTRICAL),
    ("sphs", ELECTRICAL),
    ("cyclic", MECHANICAL),
    ("noise", MECHANICAL),
    ("step", MECHANICAL),
)
"""Tests in whose analysis the constants of the rig stand."""


@dataclass(frozen=True)
class Want:
    """Keys without which tests of these kinds give less: `cost` is what does not come; `unless` a test has this channel."""

    keys: tuple[str, ...]
    tests: tuple[tuple[str, str], ...]
    cost: str
    unless: str = ""


_OF_A_MODULUS = tuple((name, MECHANICAL) for name in ("chirp", "cyclic", "step", "cycle", "pull"))
_OF_BLOCKED_FORCE = tuple((name, ELECTRICAL) for name in ("chirp", "sphs", "step", "cycle"))
WANTS = (
    Want(("rig_id",), WITH_RIG, "no correction for the resonance of clamp and load cell"),
    Want(("film_length_mm", "film_width_mm", "film_thickness_mm"), _OF_A_MODULUS, "no modulus"),
    Want(("active_length_mm", "active_width_mm", "film_thickness_mm"), _OF_BLOCKED_FORCE, "no permittivity"),
    Want(("stretch_1",), (*_OF_A_MODULUS, *_OF_BLOCKED_FORCE), "the film counts as not pre-stretched"),
    Want(("stretch_1",), (("force_map", ELECTRICAL),), "no place on a map of forces"),
    Want(("load_n",), (("isotonic", ELECTRICAL),), "no load beside the stroke", unless="force"),
    Want(("coats",), (("coverage", ELECTRICAL),), "no result"),
    Want(("rig_id",), (("tap", CALIBRATION), ("weight", CALIBRATION)), "no use for the recordings of its rig"),
    Want(("masses_kg",), (("weight", CALIBRATION),), "no result"),
)
"""What else a test wants to be told, and no file of samples shows; `NEEDS` beside it."""


@dataclass(frozen=True)
class Lack:
    """Keys that a recording lacks, and in words what they cost."""

    keys: tuple[str, ...]
    told: str


def find_lacking(given: Container[str], channels: Container[str], name: str, loading: str) -> tuple[Lack, ...]:
    """Keys of `WANTS` and `NEEDS` that are not among the given ones, for a test with these channels."""
    asked = [want for want in WANTS if (name, loading) in want.tests and want.unless not in channels]
    lacking = [(want.cost, tuple(key for key in want.keys if key not in given)) for want in asked]
    found = [Lack(keys, f"{cost}: {', '.join(keys)} missing") for cost, keys in lacking if keys]
    needed = find_needed_keys(given, channels, name, loading)
    return (*found, *([Lack(needed, tell_needed(" and ".join(needed)))] if needed else []))


def tell_needed(keys: str) -> str:
    """What it costs that `keys`, as a text of one or several, are missing, and what to do."""
    return (
        f"no diagnosis: {keys} missing, without which the recording cannot be simulated; expected in its metadata."
        f" Add {keys} to [recording] of the mapping TOML, or to the metadata of a native file"
    )


def find_needed_keys(given: Container[str], channels: Container[str], name: str, loading: str) -> tuple[str, ...]:
    """Keys that a diagnosis needs and that are not among the given ones, for a test with these channels."""
    need = NEEDS.get((name, loading))
    if need is None or need.unless in channels:
        return ()
    return tuple(key for key in need.keys if key not in given)


def find_unused_keys(given: Container[str], name: str, loading: str) -> tuple[str, ...]:
    """The given keys of which nothing is made in a test of that protocol and loading."""
    return tuple(key for key, tests in KEYS_OF_TESTS.items() if key in given and (name, loading) not in tests)


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
