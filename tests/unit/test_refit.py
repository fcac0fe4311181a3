"""The search for a single cause comes to an end, whatever the simulation does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.diagnose.refit import _to_its_end


class Falling:
    """A fit that never says that it is done; χ² falls from `chi2` by `fall` a round, to `least`."""

    def __init__(self, chi2: float, fall: float, least: float, rounds: list[int]) -> None:
        self.chi2, self.x, self._rounds = chi2, 0.0, rounds
        self.solution = SimpleNamespace(converged=False, jacobian=None)
        self.of = SimpleNamespace(fit=self._again)
        self._fall, self._least = fall, least

    def _again(self, x: float, **_: object) -> Falling:
        self._rounds.append(1)
        return Falling(max(self.chi2 - self._fall, self._least), self._fall, self._least, self._rounds)


@pytest.mark.parametrize(
    ("chi2", "fall", "least", "found", "rounds"),
    [
        (900.0, 0.0, 0.0, 900.0, 1),  # stands still below the base
        (1100.0, 0.0, 0.0, 1100.0, 1),  # stands still above it
        (1000.0, 0.0, 0.0, 1000.0, 1),
        (900.0, 100.0, 500.0, 500.0, 5),  # falls, and stands still then
        (900.0, 1e-9, 0.0, 900.0, 1),
        (900.0, 40.0, -1e9, 100.0, 20),  # never ends
    ],
)
def test_a_search_ends(chi2: float, fall: float, least: float, found: float, rounds: int) -> None:
    taken: list[int] = []
    base: Any = SimpleNamespace(chi2=1000.0)
    fit: Any = Falling(chi2, fall, least, taken)
    assert _to_its_end(base, fit).chi2 == pytest.approx(found)
    assert len(taken) == rounds
