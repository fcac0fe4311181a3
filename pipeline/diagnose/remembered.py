"""Predictions of a family of blocks that are made once: a search moves one number after the other, and most families see few of them.

Belongs here: what a family depends on, and the memory of what it predicted. The prediction itself is the family's.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.diagnose.base import Physical
from pipeline.diagnose.describing import Loads
from pipeline.diagnose.effects import Effect

Float = NDArray[np.float64]
Predict = Callable[[Physical, Effect, Loads | None], Float]

_KEPT = 32
"""Predictions kept of a family: those at one point of a search and beside it in each direction."""


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

    def __init__(self, predict: Predict, inputs: Inputs, rig: int) -> None:
        self._predict, self._inputs, self._rig = predict, inputs, rig
        self._known: OrderedDict[tuple[object, ...], Float] = OrderedDict()

    def __call__(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family, not to be changed; `loads` where the effect has elements or readings."""
        seen: dict[str, Any] = {name: own for name in self._inputs.effect if (own := getattr(effect, name))}
        loads = loads if "tension" in seen or "reading" in seen else None
        key = (self._numbers(physical), frozenset(seen.items()), loads)
        values = self._known.get(key)
        if values is None:
            values = self._predict(self._visible(physical), Effect(**seen), loads)
            self._known[key] = values
            if len(self._known) > _KEPT:
                self._known.popitem(last=False)
        else:
            self._known.move_to_end(key)
        return values

    def _numbers(self, physical: Physical) -> tuple[object, ...]:
        found: list[object] = []
        for name in sorted(self._inputs.physical):
            value = getattr(physical, name)
            if name == "rigs":
                rig = value[self._rig]
                found += [float(v[0, 0]) for v in (rig.mass, rig.compliance, rig.damping, rig.gain)]
            else:
                found.append(value[self._rig] if name == "amplifier" else value)
        return tuple(found)

    def _visible(self, physical: Physical) -> Physical:
        actuation, pf_per_n, pf_per_mm = (
            getattr(physical, name) if name in self._inputs.physical else float("nan")
            for name in ("actuation", "pf_per_n", "pf_per_mm")
        )
        return replace(physical, actuation=actuation, pf_per_n=pf_per_n, pf_per_mm=pf_per_mm)
