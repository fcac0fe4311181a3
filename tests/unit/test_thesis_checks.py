"""Printed models of the thesis recomputed: against the reference numbers that were worked out for this project by hand."""

from __future__ import annotations

import numpy as np
import pytest

from reports.pages.campaign import thesis_checks as thesis
from reports.pages.campaign.literature import _changed
from reports.pages.campaign.reference import POLYACRYLATE, SILICONE, STACK, ReferenceModel


@pytest.mark.parametrize(
    ("model", "at", "expected"),
    [
        (STACK.models[0], (0.01, 0.1, 1, 5), ((0.407, 8.9), (0.811, 45.8), (2.457, 16.2), (2.594, 3.4))),
        (STACK.models[1], (0.01, 0.1, 1, 5), ((0.417, 10.9), (0.787, 26.9), (1.916, 28.9), (2.553, 8.1))),
        (STACK.models[2], (0.01, 0.1, 1, 5), ((0.416, 9.8), (0.742, 21.8), (1.341, 36.1), (2.561, 46.7))),
        (SILICONE.models[0], (1, 10, 50, 100), ((0.290, 0.2), (0.290, 1.7), (0.299, 8.3), (0.324, 14.5))),
        (POLYACRYLATE.models[0], (1, 10, 50, 100), ((1.256, 29.2), (4.252, 25.2), (4.962, 5.8), (4.990, 2.9))),
        (POLYACRYLATE.models[1], (1, 10, 50, 100), ((1.325, 33.9), (5.141, 35.1), (8.119, 16.6), (8.730, 9.3))),
        (POLYACRYLATE.models[2], (1, 10, 50, 100), ((1.205, 27.2), (3.945, 44.0), (8.739, 50.5), (14.222, 51.1))),
    ],
)
def test_curves_of_the_printed_models(model: ReferenceModel, at: tuple, expected: tuple) -> None:
    k = thesis.of(model, np.array(at, dtype=float))
    assert np.abs(k) == pytest.approx([m for m, _ in expected], abs=6e-4)
    assert np.degrees(np.angle(k)) == pytest.approx([p for _, p in expected], abs=0.06)


def test_differences_depend_on_the_grid() -> None:
    first, _, third = STACK.models
    assert thesis.difference(first, third, thesis.grid(0.01, 5, thesis.LOGARITHMIC)) == pytest.approx(
        (0.46, 17.0), rel=0.02
    )
    assert thesis.difference(first, third, thesis.grid(0.01, 5, thesis.LINEAR)) == pytest.approx((0.58, 30.1), rel=0.02)
    first, _, third = POLYACRYLATE.models
    assert thesis.difference(first, third, thesis.grid(1, 100, thesis.LINEAR))[0] == pytest.approx(4.02, abs=0.01)
    assert thesis.difference(first, third, thesis.grid(1, 70, thesis.LINEAR))[0] == pytest.approx(2.45, abs=0.01)
    assert thesis.difference(first, third, thesis.grid(1, 100, thesis.LOGARITHMIC))[0] == pytest.approx(1.50, abs=0.01)


def test_times_phases_and_dashpots() -> None:
    assert thesis.relaxation_times(STACK.models[2]) == pytest.approx((2.5, 0.1, 0.001))
    assert thesis.largest_phase_deg(STACK.models[0]) == pytest.approx(47.2, abs=0.05)
    assert thesis.largest_phase_deg(POLYACRYLATE.models[0]) == pytest.approx(41.8, abs=0.05)
    for film, change in ((STACK, 0.019), (POLYACRYLATE, 0.34)):
        f = thesis.grid(film.low_hz, film.high_hz, thesis.LOGARITHMIC)
        rigid = thesis.of(thesis.with_dashpot(film.models[2]), f) / thesis.of(film.models[2], f)
        assert np.abs(rigid - 1).max() == pytest.approx(change, rel=0.03)


def test_every_disagreement_is_stated_with_its_number() -> None:
    found = {c.where: c for c in thesis.checks(52.0)}
    said = {
        "section 4.4.1, table 4.2": ("−59", "−46", "−91", "−79"),
        "section 4.4.1": ("0.080", "0.16"),
        "table 4.4 against 4.3": ("4.02", "2.45", "1.49"),
        "section 4.4.2, table 4.4": ("7.0", "61"),
        "table 4.4, silicone": ("3.4 times",),
        "section 4.4.2, silicone": ("8.3°", "14.5°"),
        "table 4.2 against 4.3": ("6.5 times", "7.8 times"),
        "eq 4.11 and 4.13": ("2\u00a0N/mm as printed", "0.5\u00a0N/mm"),
        "eq 4.18 to 4.22": ("3.91 times too stiff at 40",),
    }
    for where, numbers in said.items():
        assert not found[where].agrees
        for number in numbers:
            assert number in found[where].recomputed, (where, number)
    assert {c.where for c in found.values() if c.agrees} == {
        "section 4.4.1, figure 4-8",
        "table 4.3, third order",
        "tables 4.3 and 4.4, first order",
    }
    assert "eq 4.18 to 4.22" not in {c.where for c in thesis.checks()}


def test_one_parameter_at_a_time() -> None:
    f = np.array([1e-6, 1e6])
    for model in (thesis.EXAMPLE_FIRST, thesis.EXAMPLE_SECOND):
        base = np.abs(thesis.of(model, f))
        for arm in range(1, model.order + 1):
            stiffer = np.abs(thesis.of(_changed(model, "k", arm, 2.0), f))
            assert stiffer == pytest.approx([base[0], base[1] + model.k[arm]], rel=1e-4)
            assert np.abs(thesis.of(_changed(model, "c", arm, 2.0), f)) == pytest.approx(base, rel=1e-4)
