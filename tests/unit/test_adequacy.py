"""One rule of inadequacy: what may be told of a model, and which places pages, statements and the command line call wrong."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from pipeline.diagnose.adequacy import Shortfall, combine, is_at_end
from pipeline.diagnose.judge import judge_predictions
from pipeline.diagnose.results import Estimate
from pipeline.diagnose.single.comparison import Comparison, RankedModel, TriedModel, compare_predictions
from schemas.places import LEVEL, SIGN, is_beyond_noise, list_negative, list_wrong

_SHAPE = np.sqrt(2) * np.sin(np.arange(400) * 0.3)


def _compare(*models: TriedModel, misfit: float = 100.0) -> Comparison:
    measured = np.random.default_rng(5).standard_normal(400)
    plain = TriedModel("", "", "", {}, misfit * _SHAPE, misfit * _SHAPE[:200], misfit * _SHAPE[None, :200])
    return compare_predictions(plain, models, measured, measured[:200], 1.0)


def _leave(id: str, share: float, *, spread: float = 0.0, **known: Any) -> TriedModel:
    """A cause that leaves a share of the misfit of a hundred times the noise; its prediction may be so many times as wrong."""
    left = 100.0 * float(np.sqrt(share)) * _SHAPE
    drawn = left[None, :200] * np.linspace(1 - spread, 1 + spread, 201)[:, None]
    return TriedModel(id, "a form", "", {"x": Estimate(1.0, 0.1, 0.8, 1.2)}, left, left[:200], drawn, **known)


def test_what_leaves_too_much_is_no_cause_and_several_are_told_beside_what_is_in_no_list() -> None:
    assert judge_predictions(_compare(_leave("slack", 0.26))) == "unknown"
    assert judge_predictions(_compare(_leave("slack", 0.26), _leave("clamp_slip", 0.26))) == "ambiguous"
    assert judge_predictions(_compare(_leave("slack", 0.45), _leave("clamp_slip", 0.45))) == "unknown"
    assert judge_predictions(_compare(_leave("slack", 0.0), _leave("clamp_slip", 0.0))) == "ambiguous"


@pytest.mark.parametrize("known", [{"at_limit": True}, {"unresolved": True}])
def test_a_cause_at_the_end_of_its_search_is_not_named(known: Mapping[str, bool]) -> None:
    """As in a session, where no cause is named whose severity has ended at its limit."""
    assert judge_predictions(_compare(_leave("slack", 0.01))) == "named"
    assert judge_predictions(_compare(_leave("slack", 0.01, **known))) == "unknown"


def test_what_is_told_gains_for_certain_even_if_a_better_guess_does_not() -> None:
    """The best prediction may be one that could as well be worse than nothing: that was told, with a gain from below 0."""
    found = _compare(_leave("slack", 0.001, spread=40.0), _leave("clamp_slip", 0.002, spread=0.9))
    assert [p.model.mechanism for p in found.ranked] == ["slack", "clamp_slip"]
    assert found.ranked[0].lower <= 0
    assert judge_predictions(found) == "named"
    assert found.told.model.mechanism == "clamp_slip"
    assert found.told.lower > 0


def test_what_is_told_is_adequate_where_anything_is() -> None:
    found = _compare(_leave("slack", 0.01, at_limit=True), _leave("slack", 0.012, spread=0.9))
    assert found.told is found.ranked[1]
    assert judge_predictions(found) == "named"


@pytest.mark.parametrize(
    ("shortfall", "words"),
    [
        (Shortfall(), ""),
        (Shortfall(left=0.05, something_else=0.5), ""),
        (Shortfall(left=0.26), "leaves 26"),
        (Shortfall(something_else=0.9), "something else"),
        (Shortfall(at_limit=True), "as strong as a search allows"),
        (Shortfall(unresolved=True), "finer than the samples"),
    ],
)
def test_a_model_is_adequate_where_there_is_nothing_to_say_against_it(shortfall: Shortfall, words: str) -> None:
    assert shortfall.is_adequate == (words == "")
    assert words in shortfall.describe()
    assert shortfall.is_adequate == (shortfall.describe() == "")


@pytest.mark.parametrize(
    ("value", "neutral", "low", "high", "expected"),
    [(20.0, 0.0, 0.0, 20.0, True), (19.0, 0.0, 0.0, 20.0, False), (-5.0, 0.0, -5.0, 5.0, True), (0.0, 0.0, 0.0, 20.0, False),
     (-0.9, 0.0, -0.9, 100.0, True), (0.9, 0.0, -0.9, 100.0, False), (12.0, -12.0, -12.0, 12.0, True)],
)  # fmt: skip
def test_a_search_has_ended_at_a_limit(value: float, neutral: float, low: float, high: float, expected: bool) -> None:
    assert is_at_end(value, neutral, low, high) == expected


def test_places_are_judged_with_all_others_that_were_asked() -> None:
    """Each of 50 places of a clean session is beyond the noise at 1 % now and then: every other page said so below "within the noise"."""
    rng = np.random.default_rng(3)
    clean = [[{"where_found": "band", "p_value": p, "statement": ""} for p in rng.uniform(size=50)] for _ in range(400)]
    listed = np.mean([bool(list_wrong(rows, "unknown")) for rows in clean])
    assert np.mean([min(r["p_value"] for r in rows) < LEVEL for rows in clean]) > 0.3
    assert listed < 0.03
    assert not any(list_wrong(rows, "none") for rows in clean)
    assert combine([0.5, 0.001]) == pytest.approx(0.002)
    assert combine([]) == 1.0


def test_a_negative_stiffness_is_no_place_of_a_diagnosis() -> None:
    sign = {"where_found": SIGN, "p_value": 1e-9, "statement": "the stiffness is negative"}
    wrong = {"where_found": "band", "p_value": 1e-5, "statement": "missed"}
    within = {"where_found": "band", "p_value": 0.008, "statement": "missed"}
    assert list_negative([sign, wrong, within]) == [sign]
    assert list_wrong([sign, wrong, within], "named") == [wrong]
    assert list_wrong([sign, wrong, within], "none") == []
    assert not is_beyond_noise(None, 1)


def test_ranked_models_say_what_speaks_against_them() -> None:
    ranked: RankedModel = _compare(_leave("slack", 0.26)).ranked[0]
    assert ranked.shortfall.left == pytest.approx(0.26, abs=0.01)
