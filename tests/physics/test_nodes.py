"""Nodes of simulated responses: cubics between them carry a resonance, whatever the rig file says of its damping."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.diagnose.simulation.nodes import POINTS, Elsewhere, carried, fewer_nodes, interpolation, response_nodes
from schemas.metadata import RigConstants

MASS_KG, STIFFNESS_N_PER_MM = 0.36, 34.0


@given(
    ratio=st.floats(0.004, 0.03),
    stated=st.floats(0.5, 2.5),
    alone=st.floats(0.97, 1.25),
    film=st.floats(0.0, 0.2),
)
def test_a_resonance_lighter_or_lower_than_stated_is_carried(
    ratio: float, stated: float, alone: float, film: float
) -> None:
    """At worst half way between two nodes by 0.3 % of the peak, of either sign in turn: features take means over many nodes."""
    mass = 1e-3 * MASS_KG
    damping = ratio * 2 * np.sqrt(STIFFNESS_N_PER_MM * mass)
    rig = RigConstants(
        rig_id="r",
        clamp_mass_kg=MASS_KG,
        load_cell_stiffness_n_per_mm=STIFFNESS_N_PER_MM * alone**2,
        load_cell_damping_n_s_per_mm=stated * damping,
        load_cell_damping_n_s_per_mm_sd=0.3 * stated * damping,
    )

    def response(frequency: np.ndarray) -> np.ndarray:
        s = 2j * np.pi * frequency
        return np.asarray(STIFFNESS_N_PER_MM / (STIFFNESS_N_PER_MM * (1 + film) + damping * s + mass * s**2))

    nodes = response_nodes(rig)
    frequency = np.linspace(1.0, 200.0, 20_000)
    missed = np.abs(interpolation(nodes, frequency) @ response(nodes) - response(frequency))
    assert missed.max() < 3e-3 * np.abs(response(frequency)).max()


def test_a_rig_file_without_a_spread_of_the_damping_has_nodes_for_the_lightest() -> None:
    known = RigConstants(rig_id="r", clamp_mass_kg=MASS_KG, load_cell_stiffness_n_per_mm=STIFFNESS_N_PER_MM)
    nodes = response_nodes(known)
    near = nodes[(nodes > 48) & (nodes < 52)]
    assert np.diff(np.log(near)).max() == pytest.approx(0.004 / 4, rel=0.01)


@given(
    ratio=st.floats(0.004, 0.3),
    film=st.floats(0.0, 1.0),
    shift=st.floats(-0.4, 0.4),
    lighter=st.floats(0.05, 3.0),
)
@example(ratio=0.0058, film=0.0, shift=0.0, lighter=1.0)
@example(ratio=0.004, film=1.0, shift=0.0, lighter=1.0)
def test_few_nodes_carry_a_resonance_or_say_that_they_do_not(
    ratio: float, film: float, shift: float, lighter: float
) -> None:
    """Whatever they are asked about: of what they do not refuse they miss 1e-3 of the peak at worst."""
    mass = 1e-3 * MASS_KG

    def impedance(frequency: np.ndarray, ratio: float, film: float, mass: float) -> np.ndarray:
        s = 2j * np.pi * frequency
        damping = 2 * ratio * np.sqrt(STIFFNESS_N_PER_MM * mass)
        return np.asarray(1 + film + (damping * s + mass * s**2) / STIFFNESS_N_PER_MM)

    nodes = response_nodes(
        RigConstants(rig_id="r", clamp_mass_kg=MASS_KG, load_cell_stiffness_n_per_mm=STIFFNESS_N_PER_MM)
    )
    few = fewer_nodes(nodes, impedance(nodes, ratio, film, mass), (0.0, float(nodes[-1])))
    assert few.size < nodes.size / 2
    frequency = np.linspace(1.0, 200.0, 20_000)
    other = ratio * lighter, film, mass * np.exp(shift)
    try:
        carried(impedance(few, *other))
    except Elsewhere:
        # About what they are for they never refuse.
        assert lighter < 1 or shift != 0
        return
    seen, true = 1 / impedance(few, *other), 1 / impedance(frequency, *other)
    missed = np.abs(interpolation(few, frequency, POINTS) @ seen - true)
    assert missed.max() < 1e-3 * np.abs(true).max()


@given(ratio=st.floats(0.004, 0.3), film=st.floats(0.0, 1.0), end=st.floats(8.0, 200.0), shift=st.floats(-0.05, 0.05))
@example(ratio=0.02, film=0.02, end=40.0, shift=0.0)
def test_few_nodes_carry_what_rises_towards_a_resonance_beyond_their_end(
    ratio: float, film: float, end: float, shift: float
) -> None:
    """Sweeps that ended at 100 Hz, below a clamp at 133 Hz, were missed by 25 times the noise, and a sound session had a cause."""
    mass = 1e-3 * MASS_KG

    def respond(frequency: np.ndarray, mass: float) -> np.ndarray:
        s = 2j * np.pi * frequency
        damping = 2 * ratio * np.sqrt(STIFFNESS_N_PER_MM * mass)
        return np.asarray(1 / (1 + film + (damping * s + mass * s**2) / STIFFNESS_N_PER_MM))

    nodes = response_nodes(
        RigConstants(rig_id="r", clamp_mass_kg=MASS_KG, load_cell_stiffness_n_per_mm=STIFFNESS_N_PER_MM)
    )
    few = fewer_nodes(nodes, 1 / respond(nodes, mass), (0.0, float(nodes[np.searchsorted(nodes, end)])))
    frequency, other = np.geomspace(1.0, end, 2000), mass * np.exp(shift)
    try:
        carried(1 / respond(few, other))
    except Elsewhere:
        return
    missed = np.abs(interpolation(few, frequency, POINTS) @ respond(few, other) - respond(frequency, other))
    assert missed.max() < 3e-4 * np.abs(respond(frequency, other)).max()
