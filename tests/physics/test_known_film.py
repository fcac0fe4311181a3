"""What the form of a fit leaves open counts as well: the next order, and a slow arm in the main spring."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.fit.actuator.known import allow_for_form
from pipeline.fit.relaxation.results import LUMPED
from pipeline.fit.relaxation.stored import StoredFit
from pipeline.physics.film import RelaxationModel, Shape

MODEL = RelaxationModel(0.7, (1.0,), (0.1,))
FIT = StoredFit(MODEL, Shape(1), Shape(1).names, 1e-6 * np.eye(3))
F = np.array([1.0, 3.0, 20.0])


def sd(fit: object) -> np.ndarray:
    """Of |k| in N/mm, linearised."""
    k = MODEL.stiffness(F)
    slopes = (fit.slopes(F) * k.conj()[:, None]).real / np.abs(k)[:, None]  # type: ignore[attr-defined]
    return np.sqrt(np.einsum("fi,ij,fj->f", slopes, fit.covariance, slopes))  # type: ignore[attr-defined]


def test_the_way_to_the_next_order_is_one_standard_deviation() -> None:
    other = RelaxationModel(0.69, (1.0, 0.05), (0.1, 1.0))
    formed = allow_for_form(FIT, other, "", 1.0)
    way = (other.stiffness(F) - MODEL.stiffness(F)) * MODEL.stiffness(F).conj() / np.abs(MODEL.stiffness(F))
    assert sd(formed) == pytest.approx(np.hypot(sd(FIT), way.real))
    assert sd(allow_for_form(FIT, None, "", 1.0)) == pytest.approx(sd(FIT))


def test_a_slow_arm_in_the_main_spring_matters_where_the_record_begins() -> None:
    """Half of the spring relaxes with 3.5 s: where it is taken for a spring, |k| at 1 Hz errs within what is allowed for."""
    true = RelaxationModel(0.35, (0.35, 1.0), (3.5, 0.1))
    error = np.abs(np.abs(true.stiffness(F)) - np.abs(MODEL.stiffness(F)))
    wide = sd(allow_for_form(FIT, None, f"one; {LUMPED}", 1.0))
    assert np.all(error < 2 * wide)
    assert wide[0] > 3 * sd(FIT)[0]
    assert wide[2] < 2 * sd(FIT)[2]
