"""The diagnosis against the virtual rig: its amplifier lags by itself, and its slow cycles hold nothing to be found."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.kinds import SPHS_RESPONSE, STEP_FORCE, RecordingFeatures
from pipeline.diagnose.features.records import rest_samples
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.simulate.campaign import read_campaign, simulate_one


def features(*names: str, plain: str = "") -> list[RecordingFeatures]:
    """Features of recordings of the demonstration campaign; what is hidden in the specimen `plain` is taken out."""
    content = tomllib.loads((files("pipeline.simulate") / "campaigns" / "thesis.toml").read_text(encoding="utf-8"))
    content["specimens"].get(plain, {}).pop("effects", None)
    campaign = read_campaign(content)
    planned = {p.recording_id: p for p in campaign.planned}
    return [reduce(simulate_one(campaign, planned[name]).recording) for name in names]


@pytest.mark.long
def test_an_amplifier_faster_than_the_samples_is_measured_rightly() -> None:
    """0.3 ms at 2 kHz: edges lie between samples, by which a fit that took them for exact would be led astray."""
    found = diagnose(features("SI-1-sphs-5kV", "SI-1-sphs-7kV", "SI-1-steps"))
    assert found.mechanisms == ("drive_lag",)
    assert found.extension is not None
    severities = found.extension.severities["drive_lag"]
    for key in ("rise_time_constant_s", "fall_time_constant_s"):
        assert abs(severities[key].value - 3e-4) < 3 * severities[key].sd
        assert severities[key].sd < 5e-5
    assert found.held_out is not None
    assert found.held_out.after < 0.02 * found.held_out.before


def test_the_plain_search_ends_in_one_valley_whatever_the_rounding() -> None:
    """Of a voltage that lags nothing else shows the film, and what film and rig cannot mend must not hide what they can."""
    given = features("SI-1-sphs-5kV", "SI-1-sphs-7kV", "SI-1-steps")
    ends = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        rounded = [
            replace(
                r, blocks=tuple(replace(b, value=b.value * (1 + 1e-12 * rng.normal(size=b.size))) for b in r.blocks)
            )
            for r in given
        ]
        session = make_session(rounded)
        found = fit_plain(session, Simulation(session))
        of_film = np.isin(session.kind, [SPHS_RESPONSE, STEP_FORCE])
        assert np.mean(found.misfit[of_film] ** 2) < 2
        ends.append(found.chi2 - np.sum(found.misfit[~of_film] ** 2))
    assert np.ptp(ends) < 1e-3 * min(ends)


CYCLES = [
    f"ST-2-cyclic-{hz}Hz-{strain}" for hz in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5) for strain in (0.1, 0.3, 0.5)
]


@pytest.mark.long
def test_slow_and_fast_cycles_of_a_plain_film_hold_nothing() -> None:
    assert diagnose(features(*CYCLES, "ST-2-relaxation", plain="ST-2")).verdict == "none"


@pytest.mark.long
def test_the_stack_of_the_demonstration_softens_with_its_strain() -> None:
    """Where it acts and on what it depends; its formula is not quite ours, at a noise of a millionth."""
    found = diagnose(features(*CYCLES, "ST-2-relaxation"))
    assert (found.stage, found.depends_on) == ("film", ("amplitude",))
    assert found.candidates[0].mechanism == "amplitude_softening"


def test_a_single_cyclic_test_that_begins_at_once_asks_for_the_arms_that_it_needs() -> None:
    """Its responses at one frequency are fewer than the entries of a film; its mean forces show the slow arms. The film has three."""
    found = diagnose(features("EM-2-cyclic"))
    assert len(found.plain_film.k) >= 2
    assert found.verdict == "none" or "missing_relaxation" in (*found.mechanisms, *found.also_possible)


@pytest.mark.parametrize("start", [lambda t: np.sin(t), lambda t: (1 - np.cos(t)) / 2], ids=["sine", "1 - cosine"])
@pytest.mark.parametrize("hz", [0.01, 0.1, 1.0])
def test_rest_ends_where_a_slow_cycle_begins(start, hz: float) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(seed=1)
    interval_s, rest = 0.02, 60
    t = np.arange(int(2 / hz / interval_s)) * interval_s
    motion = 5.0 * start(2 * np.pi * hz * t)
    x = np.concatenate([np.zeros(rest), motion]) + rng.normal(0, 5e-4, rest + motion.size)
    found = rest_samples(x, cycle=1 / (hz * interval_s))
    assert 0.15 * rest <= found <= rest
    assert np.abs(x[:found]).max() < 5 * 5e-4


@pytest.mark.parametrize("quantum", [0.0, 1e-3], ids=["smooth", "quantised"])
def test_a_filter_that_settles_is_rest(quantum: float) -> None:
    """Neighbours of noise that was smoothed differ by little, and its first samples are on their way to the level."""
    rng = np.random.default_rng(seed=4)
    rest, per_cycle = 42, 42
    noise = np.convolve(rng.normal(0, 4e-4, rest + 3 * per_cycle + 3), np.ones(4) / 4, "valid")
    settling = 9e-4 * np.exp(-np.arange(noise.size) / 4)
    x = (
        np.concatenate([np.zeros(rest), (1 - np.cos(2 * np.pi * np.arange(3 * per_cycle) / per_cycle))])
        + noise
        + settling
    )
    if quantum:
        x = np.round(x / quantum) * quantum
    assert 0.7 * rest <= rest_samples(x, cycle=per_cycle) <= rest
