"""The plain model with mechanisms: how their parameters are searched, and how well severities are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnose.mechanisms import MECHANISMS
from pipeline.diagnose.proposals.imagined import Seen
from pipeline.diagnose.search.extended_model import Chosen, Coordinate, Extended, ExtendedFit
from tests.physics.test_regions import plain_model

COORDINATES = [Coordinate(0, p) for m in MECHANISMS.values() for p in m.parameters]


@given(share=st.floats(0.0, 1.0))
def test_an_entry_gives_its_value_back(share: float) -> None:
    for c in COORDINATES:
        p = c.parameter
        value = p.low * (p.high / p.low) ** share if p.log else p.low + (p.high - p.low) * share
        assert c.value(c.entry(value)) == pytest.approx(value, rel=1e-9), p.name
        low, high = c.limits
        assert low - 1e-9 <= c.entry(value) <= high + 1e-9, p.name


@pytest.mark.parametrize(("id", "name"), [("rig_constants", "mass_error"), ("gain_error", "gain")])
def test_errors_of_factors_add_up_as_logarithms(id: str, name: str) -> None:
    """So that an error and the constant that it multiplies, which is searched in the logarithm, can change places."""
    c = Coordinate(0, MECHANISMS[id].parameter(name))
    both = c.value(c.entry(0.1) + c.entry(-0.3))
    assert 1 + both == pytest.approx(1.1 * 0.7)
    assert c.value(-1e6) >= -1.0
    assert np.isfinite(c.value(1e6))


@pytest.fixture(scope="module")
def softened() -> ExtendedFit:
    """A film that does not soften, fitted with one that does."""
    plain = plain_model(311)
    chosen = (Chosen("amplitude_softening", MECHANISMS["amplitude_softening"].variants[0]),)
    of = Extended(plain.of.session, plain.of.simulation, plain.of.model, chosen, plain.of.weight)
    return of.refine(of.fit(of.make_entries(plain.theta, ({"drop": 0.02},)), most=3))


@pytest.mark.long
@pytest.mark.slow
def test_what_a_recording_says_of_a_cause_makes_it_dearer(softened: ExtendedFit) -> None:
    """The same recordings once more: less is left of the volume that its parameters have, never more."""
    of = softened.of
    seen = Seen.of_fit(of.session, of.simulation, softened)
    assert seen.measure_narrowing(np.zeros(of.session.size)) < -0.5
    wrong = seen.measure_narrowing(np.full(of.session.size, 1e4))
    assert wrong == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("id", ["slack", "drive_offset", "field_dependent_permittivity", "passive_strip"])
def test_the_prior_of_a_severity_is_a_density(id: str) -> None:
    """It integrates to 1 over all sizes, and what is far below the plausible range is hardly believed."""
    parameter = MECHANISMS[id].severities[0]
    c = Coordinate(0, parameter)
    size = np.geomspace(parameter.low * 1e-6, parameter.high * 1e6, 40_001)
    x = np.array([c.entry(float(v)) for v in size])
    density = np.exp([c.log_density(float(v)) for v in x]) * (2 if parameter.signed else 1)
    assert np.trapezoid(density, x) == pytest.approx(1.0, abs=2e-3)
    by_size = density * (1 if c.logarithmic else x)
    at_low = np.interp(parameter.low, size, by_size)
    assert np.interp(parameter.low / 100, size, by_size) == pytest.approx(at_low / 100, rel=0.02)
