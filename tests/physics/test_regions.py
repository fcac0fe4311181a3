"""Stages that depend on something without a law: improbable where nothing is hidden, the right one where something unlisted is."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.search.consensus import find_consensus
from pipeline.diagnose.search.extended_model import Chosen, Extended, ExtendedFit
from pipeline.diagnose.search.form_functions import allow_form_errors, differentiate_regions, weigh_regions
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.search.posterior import ANYTHING, PLAIN, Posterior, weigh_fit
from pipeline.diagnose.search.regions import list_regions
from pipeline.diagnose.search.tempering import temper_weights
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from schemas.recording import Recording
from tests.helpers.truth_rig import Effect
from tests.helpers.truth_rig import make_session as true_session
from tests.physics.courses import of_a_spring

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
    return fit_under_noise([reduce(r) for r in true_session(seed, designs, effects).recordings])


def fit_under_noise(recordings: Sequence[RecordingFeatures]) -> ExtendedFit:
    session = make_session(recordings)
    simulation = Simulation(session)
    fitted = fit_plain(session, simulation)
    of = Extended(session, simulation, fitted.model, (), np.ones(session.size))
    return of.refine(of.fit(fitted.theta, most=3))


def compare_with_plain(fit: ExtendedFit) -> Posterior:
    """The plain model and all regions, about the film that most groups of features agree on."""
    of = fit.of.reweigh(temper_weights(fit.of.session, fit.misfit))
    tempered = of.refine(of.fit(fit.theta))
    agreed = find_consensus([tempered, fit], None)
    return Posterior.of(
        [weigh_fit(fit, noise_alone=True), agreed, *weigh_regions(agreed, differentiate_regions(agreed.model))]
    )


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("seed", SESSIONS)
def test_no_region_is_likely_where_nothing_is_hidden(seed: int) -> None:
    found = compare_with_plain(plain_model(seed))
    assert found.probability[PLAIN] > 0.9
    assert sum(found.probability.values()) == pytest.approx(1.0)
    assert len(found.regions) >= 12


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "stages", "depends_on", "further"),
    [
        (Effect("clamp_misalignment", 0.02), {"film", "sensor"}, {"amplitude"}, ()),
        (Effect("humidity", 0.02), {"film", "sensor"}, {"session_time", "exposure"}, ()),
        # Once more at a lower voltage: what rises with the voltage alone has fallen again, what the exposure does has not.
        (
            Effect("frame_attraction", 0.05),
            {"actuation", "drive"},
            {"voltage"},
            ({"protocol": "sphs", "drive_kv": 5.5},),
        ),
    ],
    ids=lambda v: v.id if isinstance(v, Effect) else "",
)
def test_what_is_in_no_list_is_told_by_where_it_acts_and_what_it_depends_on(
    effect: Effect, stages: set[str], depends_on: set[str], further: Designs
) -> None:
    """Stages that show alike in these tests (a gain of the force is a stiffness) are one answer."""
    found = compare_with_plain(plain_model(303, effect, designs=DESIGNS + further))
    assert found.probability[PLAIN] < 0.01
    first = found.regions[0]
    assert first.stages <= stages, first.name
    assert first.depends_on <= depends_on, first.name


def pick_up_voltage(recording: Recording, per_kv: float, per_kv_a_second: float) -> Recording:
    """The recording with a force N that follows its voltage kV and the rate of that."""
    voltage, force = (recording.channels.get(name) for name in ("voltage", "force"))
    if voltage is None or force is None:
        return recording
    time_s = force.time_ns * 1e-9
    kv = np.interp(time_s, voltage.time_ns * 1e-9, voltage.values)
    more = per_kv * kv + per_kv_a_second * np.gradient(kv, time_s)
    changed = replace(force, values=force.values + more)
    return replace(recording, channels={**recording.channels, "force": changed})


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(("per_kv", "per_kv_a_second"), [(2e-4, 0.0), (0.0, 2e-6)])
def test_a_voltage_that_reaches_the_reading_past_the_film_is_told_as_that(
    per_kv: float, per_kv_a_second: float
) -> None:
    recordings = [pick_up_voltage(r, per_kv, per_kv_a_second) for r in true_session(303, DESIGNS, ()).recordings]
    found = compare_with_plain(fit_under_noise([reduce(r) for r in recordings]))
    assert found.probability["sensor/voltage"] > 0.9


def drag(recording: Recording, n_s2_per_mm2: float) -> Recording:
    """The recording with a force N against the square of the driven end's speed mm/s."""
    motion, force = (recording.channels.get(name) for name in ("displacement", "force"))
    if motion is None or force is None:
        return recording
    time_s = force.time_ns * 1e-9
    speed = np.gradient(np.interp(time_s, motion.time_ns * 1e-9, motion.values), time_s)
    changed = replace(force, values=force.values + n_s2_per_mm2 * speed * np.abs(speed))
    return replace(recording, channels={**recording.channels, "force": changed})


@pytest.mark.slow
def test_a_force_that_follows_the_speed_is_told_as_that() -> None:
    recordings = [drag(r, 5e-6) for r in true_session(303, DESIGNS, ()).recordings]
    found = compare_with_plain(fit_under_noise([reduce(r) for r in recordings]))
    assert found.regions[0].name == "rig/rate", {h.name: found.probability[h.name] for h in found.hypotheses[:4]}
    assert found.probability["rig/rate"] > 0.9


@pytest.mark.long
@pytest.mark.slow
def test_a_narrow_resonance_of_no_list_is_something_else_and_not_noise() -> None:
    """A response that is free at many frequencies costs more than to leave the few groups that show it to anything."""
    found = compare_with_plain(plain_model(303, Effect("acoustic_resonance", 0.2)))
    assert found.probability[PLAIN] < 0.01
    assert found.probability[ANYTHING] > 0.3


@pytest.mark.long
@pytest.mark.slow
def test_a_region_tells_its_function_with_a_band() -> None:
    found = compare_with_plain(plain_model(303, Effect("frame_attraction", 0.2)))
    region = found.regions[0].region
    assert region is not None
    values, sd = region.tell()
    assert values.shape == sd.shape == region.region.at.shape
    assert np.abs(values).max() > 2 * sd[np.argmax(np.abs(values))]


def test_electrical_tests_alone_are_asked_without_a_warning() -> None:
    """Nothing says there what a large strain or reading is."""
    fit = plain_model(SESSIONS[0], designs=({"protocol": "sphs", "drive_kv": 8.0},))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = compare_with_plain(fit)
    assert {h.name for h in found.regions} >= {"actuation/voltage", "actuation/frequency"}
    assert not any(h.name.startswith("contact") for h in found.regions)


def test_every_region_has_a_name_of_its_own_and_as_many_widths_as_shapes() -> None:
    session = make_session([reduce(r) for r in true_session(301, DESIGNS, ()).recordings])
    regions = list(list_regions(session))
    assert len({r.id for r in regions}) == len(regions)
    for r in regions:
        assert len(r.effects) == r.width.size == r.shapes.shape[1]
        assert r.shapes.shape[0] == r.at.size


def test_a_film_that_is_asked_at_one_time_alone_has_no_rate() -> None:
    """A plateau with one window: the diagnosis of a session of another rig ended there with a traceback."""
    session = make_session([reduce(r) for r in true_session(301, DESIGNS, ()).recordings])
    once = of_a_spring(np.full((3, 1), 0.01), length_mm=30.0, largest=session.scale.strain, periodic=False)
    for region in list_regions(session):
        for effect in region.effects:
            for bent in effect.tension:
                assert np.isfinite(bent(once)).all()


@pytest.mark.long
def test_a_gain_that_changes_from_test_to_test_is_seen_beside_what_rubs() -> None:
    fit = plain_model(SESSIONS[0])
    regions = {r.id: r for r in list_regions(fit.of.session)}
    rubs, gain = regions["contact/amplitude"], regions["sensor/session_time"]
    weights = np.zeros(len(rubs.effects))
    weights[0] = 0.01

    rubbing = rubs.weigh(weights)
    alone, both = (fit.of.simulation.predict(fit.of.model, fit.theta, e) for e in (rubbing, rubbing | gain.effects[0]))
    assert np.isfinite(both).all()
    assert not np.array_equal(alone, both)


@pytest.mark.long
@pytest.mark.slow
def test_a_cause_may_be_another_function_of_what_it_depends_on_and_of_nothing_else() -> None:
    """An attraction to the frame acts as a voltage that is another function of the recorded one, which an offset can be and a gain cannot."""
    plain = plain_model(303, Effect("frame_attraction", 0.2))
    starts = {
        "drive_offset": ("offset", {"offset_kv": 0.1}),
        "gain_error": ("force", {"gain": 0.02}),
    }
    found = []
    for id, (variant, values) in starts.items():
        of = replace(plain.of, chosen=(Chosen(id, variant),))
        found.append(weigh_fit(of.fit(of.make_entries(plain.theta, (values,)), most=20)))
    bent = allow_form_errors(found, differentiate_regions(plain))
    offset, gain = (after.log_evidence - before.log_evidence for before, after in zip(found, bent, strict=True))
    assert offset > 3.0
    assert abs(gain) < 0.1  # nothing is left that it could take up


@pytest.mark.long
@pytest.mark.slow
def test_a_form_that_is_right_loses_next_to_nothing_by_the_doubt_about_it() -> None:
    plain = plain_model(303, Effect("drive_offset", 0.3))
    of = replace(plain.of, chosen=(Chosen("drive_offset", "offset"),))
    hypothesis = weigh_fit(of.fit(of.make_entries(plain.theta, ({"offset_kv": 0.3},)), most=20))
    (bent,) = allow_form_errors([hypothesis], differentiate_regions(plain))
    assert hypothesis.log_evidence - np.log(2) - 0.01 < bent.log_evidence < hypothesis.log_evidence + 2.0
