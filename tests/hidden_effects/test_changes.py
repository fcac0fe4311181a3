"""Films and rigs that are others from one recording on, or in one: told where the features alone, or the search, have to say so."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from pipeline.diagnose.faults.change import merge_foreign
from pipeline.diagnose.faults.fault import Fault
from pipeline.diagnose.faults.find import check_recordings
from pipeline.diagnose.faults.fitted import assemble_session
from pipeline.diagnose.faults.session_wide import find_contradicting_units
from pipeline.diagnose.faults.undo import scale_channels
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from schemas.recording import Recording
from tests.helpers.everyday_faults import mix_in
from tests.helpers.truth_rig import compact_designs, make_session
from tests.helpers.truth_rig.material import Specimen, random_specimen

SEED = 990_000_003
STIFFER = 1.22
"""A film that was clamped anew: all springs by one factor, its actuation as before."""


@lru_cache(maxsize=1)
def own_film() -> Specimen:
    return random_specimen(np.random.default_rng(SEED), name="S-changes")


def stiffer(specimen: Specimen, factor: float) -> Specimen:
    """The specimen with all springs by a factor."""
    film = specimen.film
    return replace(specimen, film=replace(film, k0=factor * film.k0, k=tuple(factor * k for k in film.k)))


@lru_cache(maxsize=4)
def recordings(factor: float = 1.0, slower: float = 1.0) -> tuple[Recording, ...]:
    """A session with nothing hidden, of a film with springs and relaxation times by these factors."""
    specimen = stiffer(own_film(), factor)
    film = replace(specimen.film, tau=tuple(slower * t for t in specimen.film.tau))
    return tuple(make_session(SEED, compact_designs(), material=replace(specimen, film=film)).recordings)


@lru_cache(maxsize=1)
def sound() -> tuple[RecordingFeatures, ...]:
    return tuple(reduce(r) for r in recordings())


def change_from(first: int) -> list[RecordingFeatures]:
    """The session with a stiffer film from one recording on."""
    mixed = list(recordings())
    for number in range(first, len(mixed)):
        mixed = mix_in(mixed, recordings(STIFFER), number)
    return [f if m is r else reduce(m) for f, r, m in zip(sound(), recordings(), mixed, strict=True)]


def test_a_film_whose_springs_alone_change_is_a_changed_specimen() -> None:
    """It was several foreign recordings, for a tear takes as much off the actuation."""
    found = check_recordings(change_from(5))
    assert [f.cause for f in found.faults] == ["specimen_changed"]
    assert found.faults[0].recordings == tuple(f.recording_id for f in sound()[5:])


def test_a_sweep_of_a_film_with_other_relaxation_times_is_foreign() -> None:
    """No search from the film of the others reaches one that relaxes a thousand times as slowly."""
    mixed = mix_in(recordings(), recordings(1.0, 1e3), 9)
    found = check_recordings([*sound()[:9], reduce(mixed[9])])
    assert [(f.cause, f.recordings) for f in found.faults] == [("foreign_recording", (sound()[9].recording_id,))]


def test_a_multisine_on_another_rig_is_foreign_to_the_rig() -> None:
    """Another film whose resonance lies there would have to be as soft as none is."""
    designs = list(compact_designs())
    number = next(i for i, design in enumerate(designs) if design["protocol"] == "sphs")
    designs[number] = {**designs[number], "extra_clamp_mass_kg": 0.2}
    session = list(make_session(SEED, designs, material=own_film()).recordings)
    metadata = replace(session[number].metadata, extra_clamp_mass_kg=None)
    session[number] = replace(session[number], metadata=metadata)
    (fault,) = check_recordings([reduce(r) for r in session]).faults
    assert (fault.cause, fault.recordings) == ("foreign_rig", (metadata.recording_id,))


def test_what_only_is_doubted_of_another_film_is_part_of_a_change() -> None:
    features = [f for f in change_from(7) if f.loading == "mechanical"]
    tests = [f.recording_id for f in features]
    named = [Fault("foreign_recording", (tests[0],), 0.99, "")]
    session = assemble_session(features)
    (change,) = merge_foreign(named, session, tests[1:4])
    assert (change.cause, change.recordings) == ("specimen_changed", tuple(tests[4:]))
    assert merge_foreign(named, session) == named


@pytest.mark.parametrize("low", [(0, 1, 2, 3, 4), (1, 2, 3)])
def test_forces_of_some_tests_in_another_unit_are_named_before_all_else(low: tuple[int, ...]) -> None:
    """As many as the others, or not the most: at rest and in their noise they are a thousand times as small."""
    features = [scale_channels(f, {"force": 1e-3}) if i in low else f for i, f in enumerate(sound())]
    found = check_recordings(features)
    (fault,) = found.faults
    assert (fault.cause, fault.recordings) == ("unit_slip", tuple(features[i].recording_id for i in low))
    assert {(c.key, c.value_proposed) for c in fault.corrections if c.recording_id in fault.recordings} == {
        ("columns.force.scale", "1000")
    }
    assert found.is_barred


def test_one_test_among_several_and_a_tension_that_was_set_anew_are_no_other_unit() -> None:
    assert find_contradicting_units([scale_channels(sound()[0], {"force": 1e-3}), *sound()[1:]]) is None
    released = [replace(f, values={**f.values, "rest_force_n": 1e-3 * f.values["rest_force_n"]}) for f in sound()[:5]]
    assert find_contradicting_units([*released, *sound()[5:]]) is None, "their noise is that of the others"
    assert find_contradicting_units(sound()) is None
