"""Sizes that the actuation contradicts are believed where a cause explains it as well as wrong sizes do."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from pipeline.diagnose.faults.fault import SIZE_WRONG, UNIT_SLIP, Fault
from pipeline.diagnose.faults.sized import find_doubt, replace_doubt, weigh_sizes
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.simulation.parameters import ACTUATION

DOUBT = Fault(
    SIZE_WRONG, ("r-1",), RULES.fault.no_slip, "the voltage acts 0.7 times as strongly", alike=("gain_error",)
)
SLIP = replace(DOUBT, probability=RULES.fault.named, alike=())
OTHER = Fault(UNIT_SLIP, ("r-2",), 1.0, "the force is recorded 1000 times too large")


def make_evidence(log_evidence: float, known: float, sd: float = 0.04) -> Evidence:
    """An evidence whose best model knows the logarithm of the actuation to `known`, with a prior of `sd`."""
    model = SimpleNamespace(index=lambda name: 0 if name == ACTUATION else None, prior_sd=np.array([sd]))
    best = SimpleNamespace(model=SimpleNamespace(covariance=np.array([[known**2]])))
    noise_fit = SimpleNamespace(of=SimpleNamespace(model=model))
    return cast(Evidence, SimpleNamespace(log_evidence=log_evidence, best=best, noise_fit=noise_fit))


@pytest.mark.parametrize("known", [0.0, 1e-3, 0.05, 1.0, 100.0])
def test_what_explains_the_session_alike_leaves_the_sizes_right(known: float) -> None:
    assert weigh_sizes(make_evidence(-50.0, known), make_evidence(-50.0, known)) < 1 - RULES.fault.named


@pytest.mark.parametrize("known", [1e-3, 0.05, 1.0])
def test_sizes_are_wrong_where_no_cause_explains_the_session_with_them(known: float) -> None:
    assert weigh_sizes(make_evidence(-50.0, known), make_evidence(-80.0, known)) > RULES.fault.named


def test_only_a_factor_that_is_no_usual_slip_is_a_doubt() -> None:
    assert find_doubt([OTHER, SLIP]) is None
    assert find_doubt([OTHER, DOUBT]) is DOUBT


def test_a_doubt_that_is_excluded_is_said_no_more_and_one_that_is_not_stays() -> None:
    assert replace_doubt([OTHER, DOUBT], DOUBT, 0.001) == (OTHER,)
    assert replace_doubt([OTHER, DOUBT], DOUBT, 0.2) == (OTHER, replace(DOUBT, probability=0.2))
