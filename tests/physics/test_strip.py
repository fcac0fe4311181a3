"""A passive strip in series: what it takes of the extension the sensing region on the active film does not see."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.diagnose.features.kinds import CYCLIC_CAPACITANCE
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.mechanisms import make_effect
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.simulation.effects import NONE
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from tests.helpers.truth_rig import make_session as true_session

SESSION = 140_430_080
"""Seed of a session: specimen, pauses and noise follow from it."""

DESIGNS = (
    {"protocol": "chirp", "strain_pp": 0.02},
    {"protocol": "cyclic", "strain_pp": 0.12, "frequency_hz": 1.0, "cycles": 10},
    {"protocol": "cyclic", "strain_pp": 0.04, "frequency_hz": 0.2, "cycles": 3},
)
STRIP = {"compliance_share": 0.2, "time_constant_s": 0.05, "relaxing": 1.5}


@pytest.mark.slow
def test_the_capacitance_follows_the_active_film_alone() -> None:
    """Three springs in a row, written out: film, strip, and the load cell with its clamp."""
    session = make_session([reduce(r) for r in true_session(SESSION, DESIGNS, ()).recordings])
    simulation = Simulation(session)
    fitted = fit_plain(session, simulation)
    physical = fitted.model.physical(fitted.theta)
    effect = make_effect("passive_strip", STRIP)
    before, after = (simulation.predict(fitted.model, fitted.theta, e) for e in (NONE, effect))
    rig, film = physical.rigs[0], physical.film
    passive = film.k0 * (1 - STRIP["compliance_share"]) / STRIP["compliance_share"]
    seen = 0
    for p in session.places:
        # In the first cycle film and strip begin to relax.
        if p.block.kind != CYCLIC_CAPACITANCE or p.block.label == "cycle 1":
            continue
        f = float(p.block.frequency_hz[0])
        omega = 2 * np.pi * f
        lag = 1j * omega * STRIP["time_constant_s"]
        strip = passive * (1 + STRIP["relaxing"] * lag / (1 + lag))
        cell = complex(rig.stiffness - rig.mass * omega**2 + 1j * omega * rig.damping)
        compliances = [1 / complex(film.stiffness([f])[0]), 1 / strip, 1 / cell]
        alone = compliances[0] / (compliances[0] + compliances[2])
        share = compliances[0] / sum(compliances)
        harmonics = physical.pf_per_mm * np.array([share - alone, 0.0])
        expected = np.concatenate([harmonics.real, harmonics.imag])
        change = (after - before)[p.first : p.stop]
        assert change == pytest.approx(expected, abs=4e-3 * physical.pf_per_mm)
        assert abs(expected[0]) > 0.1 * physical.pf_per_mm
        seen += 1
    assert seen >= 2
