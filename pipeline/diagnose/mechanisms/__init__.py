"""The listed mechanisms: registry, composition, and what a session cannot show of them.

Adding one is adding one object to the file of its family, its words, an effect to simulate it and tests: see the package's README.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pipeline.diagnose.mechanisms import actuation, contact, drift, drive, film_amplitude, film_time, rig, sensor
from pipeline.diagnose.mechanisms.mechanism import SEVERITY, SHAPE, STAGES, Context, Mechanism, Parameter
from pipeline.diagnose.simulation.effects import Effect

_FAMILIES = (drive, actuation, film_time, film_amplitude, contact, rig, sensor, drift)
MECHANISMS: dict[str, Mechanism] = {
    m.id: m for m in sorted((m for family in _FAMILIES for m in family.MECHANISMS), key=lambda m: STAGES.index(m.stage))
}
"""Id → mechanism, in the order of the stages."""


def make_effect(id: str, values: Mapping[str, float], variant: str | None = None) -> Effect:
    """Effect of one mechanism; shapes that are not given are at their start. ValueError for names it does not have."""
    mechanism = MECHANISMS[id]
    chosen = mechanism.variants[0] if variant is None else variant
    if chosen not in mechanism.forms:
        raise ValueError(f"{id} has no variant {chosen!r}; it has {mechanism.forms}")
    parameters = mechanism.list_parameters(chosen)
    names = {p.name for p in parameters}
    if unknown := set(values) - names:
        raise ValueError(f"{id} has no {sorted(unknown)}; it has {sorted(names)}")
    severities = {p.name: values.get(p.name, 0.0) for p in mechanism.severities}
    shapes = {p.name: values.get(p.name, p.start) for p in parameters if p.role == SHAPE}
    if all(v == 0 for v in severities.values()):
        return Effect()
    return mechanism.effect(severities | shapes, chosen)


def compose_effects(severities: Mapping[str, Mapping[str, float]], variants: Mapping[str, str] | None = None) -> Effect:
    """Effect of several mechanisms, in the order of their stages whatever the order given."""
    total = Effect()
    for id in MECHANISMS:
        if id in severities:
            total = total | make_effect(id, severities[id], (variants or {}).get(id))
    return total


def list_invisible(kinds: Iterable[str]) -> tuple[str, ...]:
    """Mechanisms that leave no trace in features of these kinds."""
    found = frozenset(kinds)
    return tuple(id for id, m in MECHANISMS.items() if not (m.shows & found))


__all__ = [
    "MECHANISMS",
    "SEVERITY",
    "SHAPE",
    "Context",
    "Mechanism",
    "Parameter",
    "compose_effects",
    "list_invisible",
    "make_effect",
]
