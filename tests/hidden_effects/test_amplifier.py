"""The lag of an amplifier, which command and measured voltage show, and beside which all else is asked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.search.amplifier import find_amplifier_lag
from pipeline.diagnose.search.extended_model import Extended, ExtendedFit
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.search.screen import Signatures, compute_secants, compute_signatures
from pipeline.diagnose.search.tempering import temper_weights
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from tests.helpers.truth_rig import KINDS, compact_session

SEED = 990_000_001


def _screen(hidden: Sequence[str]) -> tuple[ExtendedFit, Signatures]:
    """The plain model of a session with hidden effects, under weights that allow for causes, and the signatures about it."""
    own = compact_session(SEED, [(id, KINDS[id].typical) for id in hidden])
    session = make_session([reduce(r) for r in own.recordings])
    simulation = Simulation(session)
    plain = fit_plain(session, simulation)
    of = Extended(session, simulation, plain.model, (), np.ones(session.size))
    fit = of.refine(of.fit(plain.theta))
    changes = compute_secants(fit)
    tempered = of.reweigh(temper_weights(session, fit.misfit))
    base = tempered.refine(tempered.fit(fit.theta))
    return base, compute_signatures(changes, base)


@pytest.mark.slow
@pytest.mark.parametrize("beside", [(), ("amplitude_softening",)])
def test_the_lag_of_an_amplifier_is_read_whatever_is_beside_it(beside: tuple[str, ...]) -> None:
    lag = find_amplifier_lag(*_screen(("drive_lag", *beside)))
    assert lag is not None
    assert lag.of.mechanism_ids == ("drive_lag",)
    assert lag.of.leaves_film


@pytest.mark.slow
@pytest.mark.parametrize("id", ["leakage", "drive_offset", "amplitude_softening"])
def test_what_is_no_lag_is_not_taken_for_one(id: str) -> None:
    assert find_amplifier_lag(*_screen((id,))) is None
