"""Faults of everyday life in sessions without any hidden effect are named with their recordings; sound sessions have none."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from datetime import timedelta
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.faults.another_film import doubt_change, weigh_change
from pipeline.diagnose.faults.change import merge_foreign, shows_in_more_than_one_test
from pipeline.diagnose.faults.fault import Fault
from pipeline.diagnose.faults.find import Checked, check_recordings, judge_together
from pipeline.diagnose.faults.fitted import assemble_session, fit_session
from pipeline.diagnose.faults.levels import read_levels
from pipeline.diagnose.faults.predict import Suspect
from pipeline.diagnose.faults.session_wide import find_swapped_in_all
from pipeline.diagnose.features.kinds import AMPLIFIER, RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.posterior import Posterior
from pipeline.diagnose.simulation.session import make_session as join_features
from pipeline.simulate.campaign import packaged_campaigns, read_campaign, simulate_one
from schemas.recording import Recording
from tests.helpers.everyday_faults import EDITS, change_channel, change_metadata, change_rig, mix_in
from tests.helpers.plain_evidence import find_plain
from tests.helpers.truth_rig import KINDS, compact_designs, compact_session, make_session

SEED, ANOTHER_SEED = 990_000_001, 990_000_002


@lru_cache(maxsize=2)
def recordings(seed: int = SEED) -> tuple[Recording, ...]:
    """A session with nothing hidden."""
    return tuple(compact_session(seed, ()).recordings)


@lru_cache(maxsize=2)
def sound(seed: int = SEED) -> tuple[RecordingFeatures, ...]:
    return tuple(reduce(r) for r in recordings(seed))


def edited(name: str) -> list[RecordingFeatures]:
    """Features of the session with a fault; what is not edited is not reduced again."""
    before, after = recordings(), EDITS[name](recordings())
    return [f if a is b else reduce(b) for f, a, b in zip(sound(), before, after, strict=True)]


@lru_cache(maxsize=8)
def check(name: str) -> Checked:
    """What is found in the session with a fault."""
    return check_recordings(edited(name))


ONE_RECORDING = [
    name for name, edit in EDITS.items() if len(edit.chosen(recordings())) == 1 and edit.cause != "gain_error"
]
"""A gain of one recording alone, by a factor that is no usual slip, is no fault: a film that softens does that, too."""


@pytest.mark.long_after(7)
@pytest.mark.parametrize("name", ONE_RECORDING)
def test_a_fault_of_one_recording_is_named_with_it(name: str) -> None:
    edit = EDITS[name]
    checked = check(name)
    (fault,) = checked.faults
    assert fault.cause in (edit.cause, *edit.instead), fault.finding
    assert fault.recordings == edit.culprits(recordings())
    assert fault.probability > 0.5
    assert checked.plain.chi2 < 1.2 * checked.session.size, "the others agree"
    if edit.key:
        best = max((c for c in fault.corrections if c.key == edit.key), key=lambda c: c.probability)
        assert edit.is_put_right(best)
        assert best.probability > 0.5


def test_another_specimens_recording_is_foreign() -> None:
    number = 6
    mixed = mix_in(recordings(), recordings(ANOTHER_SEED), number)
    checked = check_recordings([*sound()[:number], reduce(mixed[number]), *sound()[number + 1 :]])
    assert [(f.cause, f.recordings) for f in checked.faults] == [
        ("foreign_recording", (recordings()[number].metadata.recording_id,))
    ]


def test_a_foreign_recording_is_told_beside_a_mechanism_that_others_show() -> None:
    """A sweep like it shows nothing of the kind, whatever the film does where it is pulled farther."""
    session = tuple(
        compact_session(SEED, [("amplitude_softening", FACTOR * KINDS["amplitude_softening"].typical)]).recordings
    )
    number = max(i for i, r in enumerate(session) if r.metadata.protocol == "chirp")
    mixed = mix_in(session, recordings(ANOTHER_SEED), number)
    checked = check_recordings([reduce(r) for r in mixed])
    assert [(f.cause, f.recordings) for f in checked.faults] == [
        ("foreign_recording", (session[number].metadata.recording_id,))
    ]


@pytest.mark.parametrize("known", [1.0, 0.05])
def test_a_sweep_on_another_rig_than_its_metadata_name_is_foreign_to_the_rig(known: float) -> None:
    """Its clamp is heavier by a mass that nobody wrote down; no film explains it, and it was said to be anything.

    However well the file knows its own rig, which makes the other one be many of its standard deviations away.
    """
    designs = list(compact_designs())
    number = max(i for i, design in enumerate(designs) if design["protocol"] == "chirp")
    designs[number] = {**designs[number], "extra_clamp_mass_kg": 0.2}
    session = list(make_session(SEED, designs).recordings)
    metadata = replace(session[number].metadata, extra_clamp_mass_kg=None)
    session[number] = replace(session[number], metadata=metadata)
    surely = {f"{name}_sd": known for name in ("clamp_mass_kg", "load_cell_stiffness_n_per_mm")}
    session = [change_rig(r, **surely) for r in session]
    (fault,) = check_recordings([reduce(r) for r in session]).faults
    assert (fault.cause, fault.recordings) == ("foreign_rig", (metadata.recording_id,))
    assert [(c.key, c.value_proposed) for c in fault.corrections] == [("rig_id", "")]


def test_tests_from_one_on_that_a_rig_of_their_own_explains_are_foreign_to_the_rig() -> None:
    """Its clamp is heavier, which was said to be another film, or anything."""
    sweeps = [design for design in compact_designs() if design["protocol"] == "chirp"]
    rest = [design for design in compact_designs() if design["protocol"] not in ("chirp", "tap")]
    designs = [*sweeps, *rest, *({**design, "extra_clamp_mass_kg": 0.2} for design in sweeps)]
    made = make_session(SEED, designs).recordings
    session = [replace(r, metadata=replace(r.metadata, extra_clamp_mass_kg=None)) for r in made]
    (fault,) = check_recordings([reduce(r) for r in session]).faults
    assert fault.cause == "foreign_rig"
    assert fault.recordings == tuple(r.metadata.recording_id for r in session[-len(sweeps) :])


def test_a_slip_of_the_last_sweep_is_no_change_of_the_film() -> None:
    """Nothing but it and the first one pulls at the film: a film that changed before all other tests left less than the slip had made."""
    protocols = [(r.metadata.protocol, r.metadata.loading) for r in recordings()]
    own = [n for n, p in enumerate(protocols) if p == ("chirp", "mechanical") or p[1] == "electrical"]
    last = max(n for n in own if protocols[n][0] == "chirp")
    chosen = sorted({own[0], last} | {n for n in own if protocols[n][1] == "electrical"}, key=lambda n: (n == last, n))
    slip = reduce(change_channel(recordings()[last], "displacement", lambda v: v * 2 * 2**0.5))
    (fault,) = check_recordings([slip if n == last else sound()[n] for n in chosen]).faults
    assert (fault.cause, fault.recordings) == ("unit_slip", (slip.recording_id,))


def session_of_demonstration(**mislabelled: Any) -> list[RecordingFeatures]:
    """The session of SI-2 in the demonstration, with a sweep of SI-1 that was filed under its name; by keys of that test."""
    table = tomllib.loads(packaged_campaigns()["demo"].read_text(encoding="utf-8"))
    table["specimens"]["PA-9"] = table["specimens"]["SI-1"] | {"stiffness_scale": 0.4}
    sweep = next(entry for entry in table["recordings"] if entry.get("id") == "SI-2-chirp-0.45mm")
    sweep |= mislabelled
    campaign = read_campaign(table)
    own = [p for p in campaign.planned if (p.label or p.specimen) == campaign.specimens["SI-2"]]
    return [reduce(simulate_one(campaign, planned).recording) for planned in own]


def test_a_sweep_that_was_filed_under_a_like_films_name_is_foreign() -> None:
    """A film of the same kind, an eighth stiffer, is another film as well as one that is like nothing else."""
    faults = check_recordings(session_of_demonstration()).faults
    assert [(f.cause, f.recordings) for f in faults] == [("foreign_recording", ("SI-2-chirp-0.45mm",))]


@pytest.mark.long
def test_what_no_cause_explains_in_one_recording_is_asked_without_it() -> None:
    """It is the only one that goes so far: a mechanism that only shows there may be behind it, but has to explain it."""
    sweep = session_of_demonstration(amplitude_mm=2.5, specimens=["PA-9"])
    found = diagnose(sweep)
    assert (found.verdict, found.mechanisms) == ("named", ("foreign_recording",))
    assert found.faults[0].recordings == ("SI-2-chirp-0.45mm",)


def test_several_foreign_recordings_before_all_others_are_a_changed_specimen() -> None:
    tests = [i for i, r in enumerate(recordings()) if r.metadata.loading != "calibration"]
    mixed = list(recordings())
    for number in tests[:3]:
        mixed = mix_in(mixed, recordings(ANOTHER_SEED), number)
    faults = [Fault("foreign_recording", (mixed[number].metadata.recording_id,), 0.99, "") for number in tests[:3]]
    session = assemble_session(
        [reduce(m) if m is not r else f for m, r, f in zip(mixed, recordings(), sound(), strict=True)]
    )
    [change] = merge_foreign(faults, session)
    assert (change.cause, change.probability) == ("specimen_changed", 0.99)
    assert change.recordings == tuple(mixed[number].metadata.recording_id for number in tests[3:])
    assert merge_foreign(faults[:1], session) == faults[:1]
    scattered = [faults[0], replace(faults[1], recordings=(mixed[tests[4]].metadata.recording_id,))]
    assert merge_foreign(scattered, session) == scattered


def make_worse(found: Evidence, by: float) -> Evidence:
    """A search whose hypotheses are all less probable by that log evidence."""
    assert found.posterior is not None
    worse = [replace(h, log_evidence=h.log_evidence - by) for h in found.posterior.hypotheses]
    return replace(found, posterior=Posterior(tuple(worse)))


def test_a_change_is_less_probable_than_a_cause_that_explains_as_much() -> None:
    """What the search for causes finds with the recordings after the change, and without them, decides."""
    features = list(sound())
    as_one = fit_session(features)
    fault = Fault("specimen_changed", tuple(r.recording_id for r in features[len(features) // 2 :]), 0.99, "changed")
    change = doubt_change(fault, as_one, as_one[2])
    together, apart = (find_plain(part) for part in (features, features[: len(features) // 2]))
    assert weigh_change(change, together, apart) < 1 / 2
    assert weigh_change(change, make_worse(together, 100.0), apart) > 0.95
    unknown = replace(change, doubt=replace(change.doubt, recordings=()))
    assert weigh_change(unknown, together, apart) == 1.0, "what cannot be asked by itself speaks against nothing"


def test_a_gain_that_changed_midway_reads_the_rest_otherwise_too() -> None:
    name = "force read 0.8 times from the seventh recording on"
    (fault,) = check(name).faults
    assert fault.cause == "gain_error"
    assert fault.recordings == EDITS[name].culprits(recordings())
    assert "0.800 times" in fault.finding
    assert {c.key for c in fault.corrections} == {"columns.force.scale"}
    assert [float(c.value_proposed) for c in fault.corrections] == pytest.approx([1.25] * 4, rel=2e-3)


@pytest.mark.long
def test_a_small_change_is_told_where_film_and_actuation_are_each_of_one_side() -> None:
    """The sweeps that most agree on came after it, the multisines before."""
    name = "force read 0.92 times from the fifth recording on"
    (fault,) = check(name).faults
    assert (fault.cause, fault.recordings) == ("gain_error", EDITS[name].culprits(recordings()))
    assert all(EDITS[name].is_put_right(c) for c in fault.corrections)


@pytest.mark.long
def test_a_film_clamped_anew_to_the_same_tension_is_another_from_there_on() -> None:
    name = "film clamped anew from the seventh recording on"
    (fault,) = check(name).faults
    assert fault.cause == "specimen_changed"
    assert fault.recordings == EDITS[name].culprits(recordings())
    assert "0.800 times" in fault.finding


@pytest.mark.long_after(1)
@pytest.mark.parametrize("name", ["strain_pp of all doubled", "thickness doubled", "width halved", "length doubled"])
def test_wrong_sizes_and_strains_are_named_and_said_not_to_be_told_apart(name: str) -> None:
    edit = EDITS[name]
    (fault,) = check(name).faults
    assert fault.cause in (edit.cause, *edit.instead)
    assert not fault.sets_aside
    assert len({c.key for c in fault.corrections}) > 1


@pytest.mark.long
def test_sizes_wrong_by_no_usual_slip_are_one_of_several_explanations() -> None:
    """A thickness read five times too large, or a gain, or a permittivity that falls with the field: at one voltage these are one."""
    session = [change_metadata(r, film_thickness_mm=5.0) for r in recordings()]
    found = diagnose([reduce(r) for r in session])
    assert (found.verdict, found.mechanisms[0]) == ("ambiguous", "size_wrong")
    assert "gain_error" in found.also_possible
    assert found.probabilities["size_wrong"] == pytest.approx(0.5, abs=0.05)


def test_a_delay_that_all_sweeps_have_and_nothing_else_is_named_with_all_of_them() -> None:
    """One by one, each may as well show a mechanism."""
    name = "force of all sweeps 4.5 ms late"
    late = edited(name)
    plain, session = fit_session(sound())[2], assemble_session(late)
    numbers = EDITS[name].chosen(recordings())
    levels = dict(zip((r.recording_id for r in late), read_levels(late), strict=True))
    fault = judge_together(Suspect.of(session, numbers, plain, 0), numbers, levels)
    assert fault is not None
    assert fault.cause == "channel_skew"
    assert fault.recordings == EDITS[name].culprits(recordings())
    assert {c.key for c in fault.corrections} == {"columns.force.delay_s"}
    assert [float(c.value_proposed) for c in fault.corrections] == pytest.approx([4.5e-3] * len(numbers), rel=1e-2)


SHARED = [
    "clock of the force 60 ppm fast in all",
    "force of all sweeps 4.5 ms late",
    "strain_pp of all mechanical tests but the first doubled",
    "clamp mass ten times",
    pytest.param("clamp mass in g", marks=pytest.mark.long),
    "force of all doubled",
    "displacement of all in m",
    "displacement of all in inches",
    "voltage of all in V",
    "voltage of all in MV",
    "voltage of all halved",
]


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("name", SHARED)
def test_what_many_recordings_share_is_named_with_all_of_them(name: str) -> None:
    """Each of them seems to have a fault of its own, or to show a mechanism."""
    edit, found = EDITS[name], check(name).faults
    assert {f.cause for f in found} == {edit.cause}
    assert {id for f in found for id in f.recordings} == set(edit.culprits(recordings()))
    best = [max((c for c in f.corrections if c.key == edit.key), key=lambda c: c.probability) for f in found]
    assert all(edit.is_put_right(c) for c in best)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    ("id", "factor", "seed"),
    [
        ("cyclic_softening", 3.0, 771_000_104),
        ("sensor_delay", 2.5, 771_000_114),
        ("thermal_softening", 4.0, 771_000_104),
    ],
)
def test_where_others_show_a_mechanism_it_is_no_fault_of_one_recording(id: str, factor: float, seed: int) -> None:
    """The last sweep was called another film's, the multisines late."""
    session = compact_session(seed, [(id, factor * KINDS[id].typical)])
    assert not check_recordings([reduce(r) for r in session.recordings]).faults


@pytest.mark.long
def test_a_delay_that_all_mechanical_tests_have_is_the_sensors() -> None:
    """No recording has that fault: a displacement sensor that lags, or a filter of its channel, is a mechanism."""
    assert not check("force of all mechanical tests 1.6 ms late").faults


def test_a_clock_that_all_tests_share_is_seen_in_sinusoids_and_periods_alike() -> None:
    name = "clock of all tests 6 % off"
    checked = check(name)
    (fault,) = checked.faults
    assert fault.cause == "sample_rate_wrong"
    assert fault.recordings == EDITS[name].culprits(recordings())
    assert float(fault.corrections[0].value_proposed) == pytest.approx(1 / 0.94, rel=2e-3)
    assert checked.plain.chi2 < 1.2 * checked.session.size, "they agree once they are put right"


@pytest.mark.long
@pytest.mark.parametrize("channel", ["force", "displacement"])
def test_a_sign_that_is_the_opposite_one_in_all_tests_is_told_by_the_tension(channel: str) -> None:
    (fault,) = check(f"{channel} of all with its sign flipped").faults
    assert fault.cause == "sign_flipped"
    assert {(c.key, c.value_proposed) for c in fault.corrections} == {(f"columns.{channel}.scale", "-1")}


@pytest.mark.long
def test_an_amplifier_that_lags_its_command_hides_no_fault() -> None:
    """What it makes of its command is no matter of film and rig: all recordings seemed to disagree."""
    name = "force of one sweep 2 ms late"
    lagging = []
    for features in edited(name):
        blocks = tuple(
            replace(b, value=b.value + 50 * np.sqrt(np.abs(np.diagonal(b.basis.sum(axis=0)))))
            if b.kind in AMPLIFIER and b.basis.ndim == 3
            else b
            for b in features.blocks
        )
        lagging.append(replace(features, blocks=blocks))
    (fault,) = check_recordings(lagging).faults
    assert (fault.cause, fault.recordings) == ("channel_skew", EDITS[name].culprits(recordings()))


def test_a_recording_of_which_only_the_amplifier_is_left_ends_no_diagnosis() -> None:
    """Its film and hum are left out of what is asked of a suspect, which then was empty."""
    number = next(n for n, f in enumerate(sound()) if f.protocol == "sphs")
    bare = replace(sound()[number], blocks=tuple(b for b in sound()[number].blocks if b.kind in AMPLIFIER))
    features = [*sound()[:number], bare, *sound()[number + 1 :]]
    session, _, plain = fit_session(features)
    levels = dict(zip((r.recording_id for r in features), read_levels(features), strict=True))
    suspect = Suspect.of(session, [number], plain, 0)
    assert suspect.size == sum(b.size for b in bare.blocks)
    assert judge_together(suspect, [number], levels) is None
    assert not check_recordings(features).faults


def _with_noise(features: RecordingFeatures, quantity: str, factor: float) -> RecordingFeatures:
    """A recording in which the noise of a channel has `factor` times the power."""
    noise = [replace(n, power=factor * n.power) if n.quantity == quantity else n for n in features.noise]
    return replace(features, noise=tuple(noise))


def test_tests_under_voltage_that_are_all_in_doubt_are_judged_by_their_sizes() -> None:
    """Without any of them the others say nothing of the actuation, nor of the capacitance."""
    ranged = [_with_noise(r, "force", 1e6) if r.loading == "electrical" else r for r in sound()]
    assert sum(own.is_suspect for own in read_levels(ranged)) == sum(r.loading == "electrical" for r in ranged)
    assert not check_recordings(ranged).faults


def test_the_noise_of_a_command_casts_no_doubt() -> None:
    """A generator's numbers have less noise in one kind of test than in another."""
    quiet = [_with_noise(r, "command", 1e-8) if r.protocol == "sphs" else r for r in sound()]
    assert not any(own.is_suspect for own in read_levels(quiet))


@pytest.mark.long_after(1)
@pytest.mark.parametrize("seed", [SEED, ANOTHER_SEED])
def test_a_sound_session_has_no_fault(seed: int) -> None:
    checked = check_recordings(sound(seed))
    assert not checked.faults
    assert len(checked.session.recordings) == len(sound(seed))


FACTOR = 3.0
"""Of the typical severity."""


@pytest.mark.long
@pytest.mark.parametrize("id", ["amplitude_softening", "wrinkling", "slack", "cyclic_softening", "sensor_saturation"])
def test_a_mechanism_is_no_fault_of_the_recording_where_it_shows_most(id: str) -> None:
    session = compact_session(SEED, [(id, FACTOR * KINDS[id].typical)])
    assert not check_recordings([reduce(r) for r in session.recordings]).faults


@pytest.mark.long
def test_the_diagnosis_says_the_fault_first_and_the_rest_is_sound() -> None:
    found = diagnose(edited("force of one sweep in mN"))
    assert (found.verdict, found.mechanisms) == ("named", ("unit_slip",))
    assert found.faults[0].recordings == EDITS["force of one sweep in mN"].culprits(recordings())
    assert found.extension is None
    assert found.stage == "record"
    assert max(found.probabilities, key=lambda name: found.probabilities[name]) == "unit_slip"
    assert len(found.residuals) == len(sound()) - 1


@pytest.mark.long
def test_faults_and_what_is_beside_them_are_consistent() -> None:
    found = diagnose(edited("strain_pp of all doubled"))
    assert (found.verdict, found.mechanisms, found.also_possible) == ("ambiguous", ("strain_wrong",), ("size_wrong",))
    assert found.stage == "record"
    assert found.p_value < 1e-6
    assert sum(found.probabilities.values()) == pytest.approx(1.0)
    assert found.probabilities["strain_wrong"] > found.probabilities["size_wrong"] > 0.1


def _tap(name: str | None) -> RecordingFeatures:
    """Features of a tap on the clamp of the session's rig, whose file is edited."""
    session = make_session(SEED, ({"protocol": "tap", "loading": "calibration"},), ())
    return reduce((session.recordings if name is None else EDITS[name](session.recordings))[0])


@pytest.mark.long
def test_a_tap_tells_of_a_wrong_file_where_the_responses_are_too_few() -> None:
    """A clamp filed ten times too heavy makes of sound recordings some that seem to have faults of their own."""
    name = "clamp mass ten times"
    few = [f for f in edited(name) if f.protocol not in ("chirp", "tap")]
    tap = _tap(name)
    (fault,) = check_recordings([*few, tap]).faults
    assert fault.cause == "rig_constants"
    assert fault.bars
    assert set(fault.recordings) == {f.recording_id for f in (*few, tap)}
    proposed = {c.key: float(c.value_now) / float(c.value_proposed) for c in fault.corrections}
    assert proposed == pytest.approx({"rig.clamp_mass_kg": 10.0, "rig.load_cell_stiffness_n_per_mm": 0.1}, rel=1e-3)


def test_a_tap_before_all_else_says_nothing_of_the_films_length() -> None:
    """The film is not in the clamps yet: a length that no file states made all tensions a hundred times too small."""
    tap = _tap(None)
    first = replace(tap, started_at=min(f.started_at for f in sound()) - timedelta(hours=1))
    assert "strain_length_mm" not in tap.values
    assert join_features([first, *sound()]).scale.length_mm == join_features(sound()).scale.length_mm > 1


def test_a_tap_on_something_else_is_told_where_the_tests_agree_with_the_file() -> None:
    tap = _tap("clamp mass ten times")
    checked = check_recordings([*sound(), tap])
    (fault,) = checked.faults
    assert (fault.cause, fault.recordings) == ("foreign_rig", (tap.recording_id,))
    assert not fault.bars


def test_weights_tell_the_unit_of_forces_below_the_resonance() -> None:
    """There the responses are those of a film in any unit."""
    slow = [{"protocol": "cyclic", "frequency_hz": f, "strain_pp": 0.04} for f in (0.5, 1.0, 2.0)]
    session = make_session(SEED, (*slow, {"protocol": "weight", "loading": "calibration"}), ())
    slip = 0.5 / 2**0.5
    read = [change_channel(r, "force", lambda force: force * slip) for r in session.recordings]
    (fault,) = check_recordings([reduce(r) for r in read]).faults
    assert (fault.cause, len(fault.recordings)) == ("unit_slip", 4)
    (proposed,) = {float(c.value_proposed) for c in fault.corrections}
    assert proposed == pytest.approx(1 / slip, rel=1e-3)
    assert not check_recordings([reduce(r) for r in session.recordings]).faults


@pytest.mark.parametrize(
    ("tests", "first", "is_seen"),
    [
        ("chirp chirp sphs sphs step step", 4, False),
        ("chirp chirp sphs step cyclic sphs", 3, True),
        ("chirp sphs step cyclic", 2, True),
        ("chirp chirp cyclic cyclic", 2, False),
    ],
    ids=["steps alone after it", "sinusoids on both sides", "both loadings on both sides", "cycles alone after it"],
)
def test_a_change_has_to_show_in_more_than_one_kind_of_test(tests: str, first: int, is_seen: bool) -> None:
    """What the steps that come last show alone may be a permittivity that falls with the frequency."""
    loading = {"chirp": "mechanical", "cyclic": "mechanical", "sphs": "electrical", "step": "electrical"}
    a = sound()[0]
    recordings = tuple(
        replace(a, protocol=p, loading=loading[p], recording_id=str(i)) for i, p in enumerate(tests.split())
    )
    session = replace(join_features(sound()), recordings=recordings)
    assert shows_in_more_than_one_test(session, np.arange(len(recordings)) >= first) is is_seen


@pytest.mark.long
def test_channels_swapped_in_all_mechanical_tests_rest_at_the_tension_of_the_others() -> None:
    edit = EDITS["channels of one sweep swapped"].edit
    session = [edit(r) if r.metadata.loading == "mechanical" else r for r in recordings()]
    checked = check_recordings([reduce(r) for r in session])
    (fault,) = checked.faults
    assert fault.cause == "channels_swapped"
    assert set(fault.recordings) == {r.metadata.recording_id for r in session if r.metadata.loading == "mechanical"}
    assert checked.is_barred


def test_channels_swapped_in_all_tests_show_where_none_is_under_voltage() -> None:
    """The force swings by the stated travel and rests at nothing."""
    edit = EDITS["channels of one sweep swapped"].edit
    session = [reduce(edit(r)) for r in recordings() if r.metadata.loading == "mechanical"]
    fault = find_swapped_in_all(session)
    assert fault is not None
    assert fault.bars
    assert find_swapped_in_all([reduce(r) for r in recordings() if r.metadata.loading == "mechanical"]) is None


def test_lengths_that_contradict_the_pre_stretch_are_named() -> None:
    session = [change_metadata(r, film_length_mm=2.0) for r in recordings()]
    (fault,) = check_recordings([reduce(r) for r in session]).faults
    assert fault.cause == "size_wrong"
    best = max((c for c in fault.corrections), key=lambda c: c.probability)
    assert best.key == "film_length_mm"
    assert float(best.value_proposed) == pytest.approx(recordings()[0].metadata.film_length_mm)
