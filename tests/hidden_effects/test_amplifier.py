"""The lag of an amplifier, which command and measured voltage show, and beside which all else is asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.kinds import AMPLIFIER, RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.mechanisms.drive import FURTHER
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.amplifier import find_amplifier_lag
from pipeline.diagnose.search.extended_model import Chosen, Extended, ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import temper_fit
from pipeline.diagnose.search.held_out import predict_left_out
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.search.screen import (
    Signatures,
    compute_secants,
    compute_signatures,
    find_best_scores,
    renew_secants,
)
from pipeline.diagnose.search.tempering import temper_weights
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.least_squares import central
from schemas.recording import Recording
from tests.helpers.truth_rig import KINDS, Effect, compact_session

SEED = 990_000_001


@cache
def _screen(hidden: tuple[str, ...]) -> tuple[ExtendedFit, Signatures]:
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


@pytest.mark.slow
def test_a_gain_behind_a_lag_is_no_gain_before_it() -> None:
    """Of every session with a lag the screen promised a gain of the voltage that no fit could keep, and all mechanisms were fitted."""
    plain, signatures = _screen(("drive_lag",))
    lag = find_amplifier_lag(plain, signatures)
    assert lag is not None
    given, changes = temper_fit(lag), compute_secants(plain)
    before = compute_signatures(changes, given)
    renewed = renew_secants(changes, given)
    anew = compute_signatures(renewed, given)
    gain = Chosen("gain_error", "voltage")
    assert any(s.chosen == gain and before.reaches(s.statistic, RULES.cause.level) for s in find_best_scores(before))
    assert not any(s.chosen == gain and anew.reaches(s.statistic, RULES.cause.level) for s in find_best_scores(anew))
    held = {c.id for c in renewed.chosen}
    assert held == {c.id for c in changes.chosen} - {"drive_lag"}


@pytest.mark.long
@pytest.mark.slow
def test_a_fit_beside_a_lag_borrows_its_slopes_and_renews_its_own() -> None:
    plain, signatures = _screen(("drive_lag",))
    lag = find_amplifier_lag(plain, signatures)
    assert lag is not None
    of = replace(lag.of, chosen=(*lag.of.chosen, Chosen("gain_error", "force")))
    assert of.settled == lag.x.size
    assert lag.of.settled == plain.x.size
    lent = of.lend(lag)
    x = of.make_entries(lag.theta, (*lag.values, {"gain": 1e-6}))
    (residual,) = of.residuals(x[None])
    assert lent.shape == (residual.size, x.size)
    exact = central(of.residuals, x, *of.limits)
    size = np.sqrt(np.sum(exact[:, : lag.x.size] ** 2, axis=0))
    off = np.sqrt(np.sum((lent - exact)[:, : lag.x.size] ** 2, axis=0))
    assert np.all(off < 0.01 * np.maximum(size, 1e-3 * size.max()))
    assert not lent[:, lag.x.size :].any()


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


LAG = Effect("drive_lag", 2e-3, {"fall_ratio": 1.8, "slew_kv_per_s": 2700.0})


@pytest.mark.slow
def test_what_causes_beside_a_lag_gain_is_not_the_lags() -> None:
    """Alone it is measured by what the amplifier makes of its command; beside it a cause that does nothing gains nothing."""
    base, signatures = _screen(("drive_lag",))
    lag = find_amplifier_lag(base, signatures)
    assert lag is not None
    alone = predict_left_out(base, lag)
    assert alone is not None
    assert {p.kind for p in alone.predicted} <= AMPLIFIER
    assert alone.gain > 0.9
    of = replace(lag.of, chosen=(*lag.of.chosen, Chosen("amplitude_softening", "running")))
    beside = predict_left_out(base, of.fit(of.make_entries(lag.theta, (*lag.values, {"drop": 1e-3})), most=10))
    if beside is not None:
        assert not {p.kind for p in beside.predicted} & AMPLIFIER
        assert not beside.gain > 0.5


def _state_lag(recordings: Sequence[Recording], factor: float) -> list[RecordingFeatures]:
    """Features of recordings whose rig's file states the lag of the virtual rig's amplifier, its time constants times a factor."""
    stated = {
        "amplifier_rise_time_constant_s": 2e-3 * factor,
        "amplifier_fall_time_constant_s": 3.6e-3 * factor,
        "amplifier_slew_kv_per_s": 2700.0,
    }
    return [reduce(replace(r, rig=replace(r.rig, **stated))) for r in recordings]


@pytest.mark.slow
def test_a_lag_that_the_rigs_file_states_is_no_finding() -> None:
    """Every amplifier lags: each film of the laboratory was said to have a cause."""
    found = diagnose(_state_lag(compact_session(SEED, [LAG]).recordings, 1.0))
    assert found.verdict == "none", found.mechanisms
    assert any("lags as its rig's file states" in text for text in found.could_not_ask)


@pytest.mark.slow
def test_a_lag_that_the_rigs_file_states_otherwise_is_a_finding() -> None:
    found = diagnose(_state_lag(compact_session(SEED, [LAG]).recordings, 0.3))
    assert (found.verdict, found.mechanisms) == ("named", ("drive_lag",))


@pytest.mark.long
@pytest.mark.slow
def test_what_is_beside_a_lag_of_the_file_is_told_alone() -> None:
    session = compact_session(SEED, [LAG, ("amplitude_softening", KINDS["amplitude_softening"].typical)])
    found = diagnose(_state_lag(session.recordings, 1.0))
    assert found.mechanisms == ("amplitude_softening",)
