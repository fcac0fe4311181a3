"""The search for a single cause comes to an end, whatever the simulation does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from pipeline.diagnose.search import fit_mechanisms
from pipeline.diagnose.search.extended_model import Chosen
from pipeline.diagnose.search.fit_mechanisms import drop_astray, fit_each_mechanism, follow_to_end
from pipeline.diagnose.search.screen import Score


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
    ("chi2", "fall", "least", "reach", "found", "rounds"),
    [
        (900.0, 0.0, 0.0, np.inf, 900.0, 1),  # stands still below the base
        (1100.0, 0.0, 0.0, np.inf, 1100.0, 1),  # stands still above it
        (1000.0, 0.0, 0.0, np.inf, 1000.0, 1),
        (900.0, 100.0, 500.0, np.inf, 500.0, 5),  # falls, and stands still then
        (900.0, 1e-9, 0.0, np.inf, 900.0, 1),
        (900.0, 40.0, -1e9, np.inf, 100.0, 20),  # never ends
        (900.0, 40.0, -1e9, 500.0, 100.0, 20),  # may come down to that
        (900.0, 40.0, -1e9, 100.0, 860.0, 1),  # will not come down to that
    ],
)
def test_a_search_ends(chi2: float, fall: float, least: float, reach: float, found: float, rounds: int) -> None:
    taken: list[int] = []
    base: Any = SimpleNamespace(chi2=1000.0)
    fit: Any = Falling(chi2, fall, least, taken)
    assert follow_to_end(base, fit, reach).chi2 == pytest.approx(found)
    assert len(taken) == rounds


@pytest.mark.parametrize(
    ("chi2", "size", "kept"),
    [
        ((900.0, 8_000.0, np.inf, 20_000.0), 900, [900.0, 8_000.0]),  # a weak effect is not that strong
        ((900.0, 8_000.0, 20_000.0), 100, [900.0, 8_000.0, 20_000.0]),  # a strong one may be
        ((40_000.0, 20_000.0, 30_000.0), 900, [20_000.0]),  # the nearest in any case
        ((np.inf,), 900, [np.inf]),
    ],
)
def test_severities_that_no_material_makes_room_for_are_left(
    chi2: tuple[float, ...], size: int, kept: list[float]
) -> None:
    base: Any = SimpleNamespace(chi2=1000.0, of=SimpleNamespace(session=SimpleNamespace(size=size)))
    rooms: Any = [SimpleNamespace(chi2=v) for v in chi2]
    assert [room.chi2 for room in drop_astray(rooms, base)] == kept


class Fitted:
    """A fit of one mechanism that is at its optimum: it explains 1.2 × what the screen promised, whatever film it starts from."""

    def __init__(self, score: Score) -> None:
        self.chi2 = 1000.0 - 1.2 * score.statistic
        self.log_evidence = -self.chi2 / 2
        self.theta, self.values, self.x = np.zeros(1), ({},), np.zeros(1)
        self.solution = SimpleNamespace(converged=True)
        self.of = SimpleNamespace(
            chosen=(score.chosen,),
            make_entries=lambda theta, values: theta,
            fit=lambda *_, **__: self,
            refine=lambda fit: fit,
            continue_fit=lambda fit, most: fit,
        )


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Mechanisms that are fitted from now on, in their order; without a session to fit them to."""
    order: list[str] = []

    def fit(base: object, score: Score, *_: object) -> Fitted:
        order.append(score.chosen.id)
        return Fitted(score)

    monkeypatch.setattr(fit_mechanisms, "fit_mechanism", fit)
    return order


BASE: Any = SimpleNamespace(
    chi2=1000.0,
    of=SimpleNamespace(
        weight=np.ones(400),
        model=SimpleNamespace(size=10),
        chosen=(),
        leaves_film=True,
        session=SimpleNamespace(size=400),
    ),
)
"""A base whose noise alone would leave 390."""


def list_scores(**promised: float) -> list[Score]:
    return [Score(Chosen(id, ""), {}, statistic, 1.0) for id, statistic in promised.items()]


def test_mechanisms_that_cannot_come_near_the_best_are_not_fitted(fitted: list[str]) -> None:
    scores = list_scores(slack=500.0, clamp_slip=45.0, gain_error=5.0, wrinkling=5.0)
    kept = fit_each_mechanism(BASE, scores, cast(Any, None), 8)
    # Of what film and rig can take the place of, a screen's promise says nothing.
    assert fitted == ["slack", "clamp_slip", "gain_error"]
    assert [f.chi2 for f in kept] == pytest.approx([400.0, 946.0, 994.0])


def test_mechanisms_that_cannot_come_near_the_goal_are_not_fitted(fitted: list[str]) -> None:
    scores = list_scores(slack=500.0, clamp_slip=45.0, gain_error=5.0, wrinkling=5.0)
    kept = fit_each_mechanism(BASE, scores, cast(Any, None), 8, goal=450.0)
    assert fitted == ["slack", "gain_error"]
    assert [f.chi2 for f in kept] == pytest.approx([400.0, 994.0])


def test_what_the_best_can_be_taken_for_is_fitted_wherever_it_stands_in_the_screen(fitted: list[str]) -> None:
    """A screen sees next to nothing of a strong mechanism whose place film and rig can take."""
    scores = list_scores(passive_strip=500.0, slack=45.0, gain_error=5.0, missing_relaxation=1.0)
    fit_each_mechanism(BASE, scores, cast(Any, None), 1)
    assert fitted == ["passive_strip", "missing_relaxation"]
