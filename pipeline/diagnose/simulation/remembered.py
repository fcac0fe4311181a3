"""Predictions of a family of blocks that are made once: a search moves one number after the other, and most families see few of them.

Belongs here: what a family depends on, and the memory of what it predicted. The prediction itself is the family's.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from pipeline.diagnose.simulation.describing import Loads
from pipeline.diagnose.simulation.effects import Effect
from pipeline.diagnose.simulation.parameters import Physical, Several
from schemas.arrays import Float

Predict = Callable[[Physical, Effect, Loads | None], Float]
PredictSeveral = Callable[[Several, Effect], Float]

_KEPT = 48
"""Predictions kept of a family: those at one point of a search and beside it in each direction."""
_HIDDEN: dict[str, Any] = {"actuation": np.nan, "pf_per_n": np.nan, "pf_per_mm": np.nan, "sensing": ""}
"""What a family sees in place of what it does not depend on."""


@dataclass(frozen=True)
class Inputs:
    """Fields of `Physical`, those of the rig in use as `rigs` and `amplifier`, and of `Effect` on which a family's features depend."""

    physical: frozenset[str]
    effect: frozenset[str]

    @classmethod
    def named(cls, physical: str, effect: str) -> Inputs:
        """From names with spaces between them."""
        return cls(frozenset(physical.split()), frozenset(effect.split()))


class Remembered:
    """Predictions of a family from its inputs alone: all else is hidden from it, so that none can be missing unnoticed."""

    def __init__(self, predict: Predict, several: PredictSeveral, inputs: Inputs, rig: int) -> None:
        """`several`: the same for several films and rigs at once, (B, rows), under effects of spectra."""
        self._predict, self._predict_several, self._rig = predict, several, rig
        self._numbers, self._functions = tuple(inputs.physical), tuple(inputs.effect)
        self._seen = attrgetter(*self._functions)
        self._bends = bool(inputs.effect & {"tension", "reading"})
        self._hidden = {name: value for name, value in _HIDDEN.items() if name not in inputs.physical}
        self._known: OrderedDict[tuple[object, ...], Float] = OrderedDict()
        self._last: tuple[object, Effect] = None, Effect()

    def __call__(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family, not to be changed; `loads` where the effect has elements or readings."""
        seen = self._seen(effect)
        loads = loads if self._bends else None
        key = self._key(physical, seen, loads)
        values = self._known.get(key)
        if values is None:
            values = self._predict(self._visible(physical), self._felt(seen), loads)
            self._keep(key, values)
        else:
            self._known.move_to_end(key)
        return values

    def several(self, physicals: Several, effect: Effect) -> list[Float]:
        """Features (rows,) of the family for each, as above; `effect` is one of spectra."""
        seen = self._seen(effect)
        keys = [self._key(p, seen, None) for p in physicals.members]
        new = {key: place for place, key in enumerate(keys) if key not in self._known}
        found = {key: self._known[key] for key in keys if key not in new}
        for key in found:
            self._known.move_to_end(key)
        if new:
            made = self._predict_several(physicals.some(list(new.values()), self._hidden), self._felt(seen))
            for key, values in zip(new, made, strict=True):
                found[key] = values
                self._keep(key, values)
        return [found[key] for key in keys]

    def _key(self, physical: Physical, seen: object, loads: Loads | None) -> tuple[object, ...]:
        return (*[self._number(physical, name) for name in self._numbers], seen, loads)

    def _visible(self, physical: Physical) -> Physical:
        return Physical(**{**vars(physical), **self._hidden})

    def _felt(self, seen: Any) -> Effect:
        if self._last[0] != seen:  # a search asks for many films under one effect
            self._last = seen, Effect(**dict(zip(self._functions, seen, strict=True)))
        return self._last[1]

    def _keep(self, key: tuple[object, ...], values: Float) -> None:
        self._known[key] = values
        if len(self._known) > _KEPT:
            self._known.popitem(last=False)

    def _number(self, physical: Physical, name: str) -> object:
        """What is told of one of the inputs: the same where it is the same."""
        value = getattr(physical, name)
        if name == "rigs":
            rig = value[self._rig]
            return *rig.numbers, rig.extra
        return value[self._rig] if name == "amplifier" else value
