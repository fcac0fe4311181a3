"""The lag of an amplifier, which command and measured voltage show, and beside which all else is asked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.mechanisms.drive import FURTHER
from pipeline.diagnose.search.amplifier import find_amplifier_lag
from pipeline.diagnose.search.extended_model import Extended, ExtendedFit
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.search.screen import Signatures, compute_secants, compute_signatures
from pipeline.diagnose.search.tempering import temper_weights
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from tests.helpers.truth_rig import KINDS, Effect, compact_session

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


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("beside", [(), pytest.param(("amplitude_softening",), marks=pytest.mark.long)])
def test_the_lag_of_an_amplifier_is_read_whatever_is_beside_it(beside: tuple[str, ...]) -> None:
    lag = find_amplifier_lag(*_screen(("drive_lag", *beside)))
    assert lag is not None
    assert lag.of.mechanism_ids == ("drive_lag",)
    assert lag.of.leaves_film


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("id", ["leakage", "drive_offset", "amplitude_softening"])
def test_what_is_no_lag_is_not_taken_for_one(id: str) -> None:
    assert find_amplifier_lag(*_screen((id,))) is None


@pytest.mark.long
@pytest.mark.slow
def test_a_lag_that_the_monitor_shows_in_part_is_one_cause() -> None:
    """The rest of it was told as a permittivity that falls with frequency, or, where small, as a force that is stamped late."""
    lag = Effect("drive_lag", 2e-4, {"fall_ratio": 1.2, "behind": 1.5})
    found = diagnose([reduce(r) for r in compact_session(SEED, [lag]).recordings])
    assert (found.verdict, found.mechanisms) == ("named", ("drive_lag",))
    assert not found.faults
    assert found.extension is not None
    assert found.extension.variants == {"drive_lag": FURTHER}
    behind = found.extension.severities["drive_lag"]["further_time_constant_s"].value
    assert behind == pytest.approx(3e-4, rel=0.2)
