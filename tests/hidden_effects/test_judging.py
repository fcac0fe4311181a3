"""What a diagnosis calls detectable, against the traces that effects of other forms leave without noise."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.judging import Case, clean, judge, smallest_of
from tests.helpers.truth_rig import KINDS, Effect, random_effect

SESSION = 103
"""Seed of a session: specimen, pauses and noise follow from it."""

CASE = Case(SESSION)


@pytest.mark.long
@pytest.mark.parametrize("id", ["cyclic_softening", "wrinkling", "leakage"])
def test_what_is_called_detectable_is(id: str) -> None:
    """Within a factor of two: the forms differ, and the hardest fifth of the shapes is not promised."""
    kind = KINDS[id]
    drawn = random_effect(id, kind.typical, np.random.default_rng(seed=3))
    true = smallest_of(CASE, drawn)
    said = clean(CASE.seed, CASE.size).smallest_parameters[id]
    assert true is not None
    assert 0.5 < said[kind.key if kind.key in said else next(iter(said))] / true < 2.0


@pytest.mark.long
def test_a_gain_that_the_film_absorbs_needs_to_be_large() -> None:
    """Of the displacement that is measured all simulations are told: what the film's stiffness takes up leaves no trace."""
    true = smallest_of(CASE, Effect("gain_error", 0.05, {"channel": "displacement"}))
    assert true is None or true > 0.005


@pytest.mark.long
def test_a_bias_is_what_the_effect_does_to_the_film() -> None:
    """Not what the noise does to it: leakage acts on the drive alone, and the clean session has the same noise."""
    assert judge(Case(CASE.seed, effects=(("leakage", 3.0),))).bias < 1.0
    assert judge(Case(CASE.seed, effects=(("missing_relaxation", 3.0),))).bias > 3.0
