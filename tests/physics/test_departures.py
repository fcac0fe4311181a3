"""Quantities left free beside a fitted model: silent where nothing is hidden, and the right one where something unlisted is."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.proposals.designs import Proposal
from pipeline.diagnose.proposals.imagined import Seen, imagine_session
from pipeline.diagnose.search.extended_model import Extended, ExtendedFit
from pipeline.diagnose.search.free_quantities import FreeQuantity, fit_free_quantities
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.search.screen import make_absorbed_basis, project_out
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from tests.helpers.truth_rig import Effect
from tests.helpers.truth_rig import make_session as true_session

SESSIONS = (301, 302)
"""Seeds of sessions with nothing hidden."""

Designs = tuple[dict[str, Any], ...]
DESIGNS: Designs = (
    {"protocol": "chirp", "strain_pp": 0.006},
    {"protocol": "cyclic", "strain_pp": 0.04, "frequency_hz": 1.0, "cycles": 10},
    {"protocol": "sphs", "drive_kv": 5.5},
    {"protocol": "cyclic", "strain_pp": 0.12, "frequency_hz": 1.0, "cycles": 10},
    {"protocol": "sphs", "drive_kv": 8.0},
    {"protocol": "chirp", "strain_pp": 0.02},
)


def plain_model(seed: int, *effects: Effect, designs: Designs = DESIGNS) -> ExtendedFit:
    session = make_session([reduce(r) for r in true_session(seed, designs, effects).recordings])
    simulation = Simulation(session)
    fitted = fit_plain(session, simulation)
    of = Extended(session, simulation, fitted.model, (), np.ones(session.size))
    return of.refine(of.fit(fitted.theta, most=3))


def beside_the_plain_model(seed: int, *effects: Effect, designs: Designs = DESIGNS) -> Sequence[FreeQuantity]:
    return fit_free_quantities(plain_model(seed, *effects, designs=designs))


@pytest.mark.slow
@pytest.mark.parametrize("seed", SESSIONS)
def test_nothing_departs_where_nothing_is_hidden(seed: int) -> None:
    fit = plain_model(seed)
    found = fit_free_quantities(fit)
    assert len(found) >= 9
    assert min(d.p_value for d in found) > 1e-4, found[0]
    some = fit_free_quantities(fit, {found[-1].text})
    assert [d.statistic for d in some] == [d.statistic for d in found if d.text == found[-1].text]
    # No knot of the stiffness above the band: a change there shows through the edges of windows alone, and no noise law holds for it.
    assert max(d.degrees_of_freedom for d in found) <= 2 * np.count_nonzero(np.geomspace(5.0, 160.0, 26) < 110)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "words"),
    [
        (Effect("clamp_misalignment", 0.02), "the force follows the strain in another way"),
        (Effect("acoustic_resonance", 0.05), "the stiffness under mechanical tests follows the frequency in another way"),
        (Effect("humidity", 0.02), "the stiffness comes and goes over the session"),
        (Effect("edge_tear", 0.05), "the stiffness changes for good"),
        (Effect("frame_attraction", 0.05), "the actuation follows the voltage in another way"),
    ],
    ids=lambda v: v.id if isinstance(v, Effect) else "",
)  # fmt: skip
def test_what_is_in_no_list_departs_where_it_acts(effect: Effect, words: str) -> None:
    found = beside_the_plain_model(303, effect)
    assert found[0].p_value < 1e-8
    assert words in [d.text for d in found if d.p_value < 1e-8]
    assert found[0].excess == pytest.approx(found[0].statistic - found[0].degrees_of_freedom)


@pytest.mark.slow
def test_at_its_best_values_a_quantity_changes_the_features_by_what_it_explains() -> None:
    fit = plain_model(303, Effect("humidity", 0.02))
    of = fit.of
    for d in fit_free_quantities(fit):
        if d.degrees_of_freedom < len(d.effects):
            continue
        seen = of.weight * of.session.whiten(np.nan_to_num(d.compute_change(of, fit.x)))
        gram, along = project_out(fit, seen[:, None], make_absorbed_basis(fit))
        assert (gram.item(), along.item()) == pytest.approx((d.statistic, d.statistic), rel=1e-3), d.text


@pytest.mark.slow
def test_what_differs_from_recording_to_recording_says_nothing_of_a_further_one() -> None:
    fit = plain_model(303, Effect("humidity", 0.02))
    proposal = Proposal(
        {"protocol": "cyclic", "loading": "mechanical", "strain_pp": 0.04, "frequency_hz": 1.0, "cycles": 10.0},
        "ten cycles",
    )
    made = imagine_session(fit, proposal)
    assert made is not None
    later = Seen.of_fit(*made, fit).of
    changes = {d.text: np.abs(d.compute_change(later, fit.x)).max() for d in fit_free_quantities(fit)}
    assert changes["the stiffness differs from recording to recording"] < 1e-9
    assert changes["the stiffness changes for good"] > 1e-4


def test_electrical_tests_alone_are_asked_without_a_warning() -> None:
    """Nothing says there what a large strain or reading is."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = beside_the_plain_model(SESSIONS[0], designs=({"protocol": "sphs", "drive_kv": 8.0},))
    assert found
    assert "the reading follows the force in another way" not in [d.text for d in found]
