"""Electrodes that crack where the film is stretched: the capacitance follows the film's strain, not the displacement's."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.diagnose.features.kinds import CYCLIC_CAPACITANCE
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.simulation.effects import NONE, Cracks, Effect
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from tests.helpers.judging import Case, judge
from tests.helpers.truth_rig import make_session as true_session

SESSION = 140_430_080
"""Seed of a session: specimen, pauses and noise follow from it."""

LOST, POWER, SAMPLES = 0.05, 1.7, 720
DESIGNS = (
    {"protocol": "chirp", "strain_pp": 0.02},
    {"protocol": "cyclic", "strain_pp": 0.12, "frequency_hz": 1.0, "cycles": 10},
    {"protocol": "cyclic", "strain_pp": 0.04, "frequency_hz": 0.2, "cycles": 3},
)


@pytest.mark.slow
def test_cracks_open_with_the_strain_of_the_film() -> None:
    """Against the same in time: sample by sample what is lost of the capacitance, and its harmonics over those of the displacement."""
    session = make_session([reduce(r) for r in true_session(SESSION, DESIGNS, ()).recordings])
    simulation = Simulation(session)
    fitted = fit_plain(session, simulation)
    cracked = Effect(opening=(Cracks(lambda view: LOST, POWER),))
    change = simulation.predict(fitted.model, fitted.theta, cracked) - simulation.predict(
        fitted.model, fitted.theta, NONE
    )
    physical = fitted.model.physical(fitted.theta)
    rig = physical.rigs[0]
    turn = np.arange(SAMPLES) / SAMPLES
    seen = 0
    for p in session.places:
        if p.block.kind != CYCLIC_CAPACITANCE:
            continue
        f, amplitude = float(p.block.frequency_hz[0]), float(p.block.support["input_mm"][0])
        omega = 2 * np.pi * f
        on_cell = -rig.mass * omega**2 + 1j * omega * rig.damping
        before_film = 1 + on_cell * rig.compliance
        film = complex(before_film / (before_film + physical.film.stiffness([f])[0] * rig.compliance))
        extension = amplitude * abs(film) * (1 + np.cos(2 * np.pi * turn + np.angle(film)))
        rest = session.recordings[p.recording].values["capacitance_rest_pf"]
        largest = session.scale.strain * session.scale.length_mm
        lost = (rest + physical.pf_per_mm * extension) * LOST * (extension / largest) ** POWER
        harmonics = [np.mean(2 * lost * np.exp(-2j * np.pi * m * turn)) / amplitude for m in (1, 2)]
        assert abs(np.angle(harmonics[0])) > 0.03
        expected = -np.concatenate([np.real(harmonics), np.imag(harmonics)])
        assert change[p.first : p.stop] == pytest.approx(expected, abs=1e-3 * abs(harmonics[0]))
        seen += 1
    assert seen >= 2
    assert np.count_nonzero(change) == 4 * seen


@pytest.mark.long
@pytest.mark.slow
def test_dying_electrodes_leave_the_film_as_it_is() -> None:
    """What cracks take of the capacitance has a phase; put down to the load cell, it moved the film by ten standard deviations."""
    found = judge(Case(SESSION, effects=(("electrode_degradation", 3.0),)))
    assert found.named[0] == "electrode_degradation"
    assert found.apart_after < 3.0
