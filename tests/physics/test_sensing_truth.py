"""A few draws of the sensing study, pinned: intervals, wrinkling, migration and coats against truths of another form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.fit.sensing.coverage import fit_coverage
from pipeline.fit.sensing.migration import migration
from pipeline.fit.sensing.wrinkling import wrinkling
from pipeline.transform.capacitance_cycles import capacitance_cycles
from pipeline.transform.coats import Coat, measure_coat
from pipeline.transform.step import measure_steps
from schemas.errors import NotIdentifiableError
from tests.helpers import sensing_truth
from tests.studies.study_sensing import Tally, actuator, coats, electrode, film


@pytest.mark.slow
@pytest.mark.study
def test_intervals_hold_over_pinned_draws() -> None:
    """24 actuators and coatings give about 190 intervals; fewer than 88 % or all of them would be chance of 1 in 1000."""
    intervals = Tally()
    for seed in range(24):
        actuator(seed, intervals)
        coats(seed, intervals)
    tried = sum(intervals.tries.values())
    assert tried > 180
    assert 0.88 < intervals.share(*intervals.tries) < 1.0


@pytest.mark.slow
@pytest.mark.study
def test_wrinkling_is_found_where_it_is_and_nowhere_else() -> None:
    found, intervals = Tally(), Tally()
    for seed in range(20):
        film(seed, wrinkled=True, tally=found, intervals=intervals)
        film(seed, wrinkled=False, tally=found, intervals=intervals)
    assert found.share("found: films that wrinkle") == 1.0
    assert found.share("found: steps at and above the onset") >= 0.95
    assert found.share("found: steps more than 10 % below the onset are not said to wrinkle") >= 0.95
    assert found.share("false: films said to wrinkle that do not") == 0.0
    assert intervals.share("wrinkling onset") >= 0.8


@pytest.mark.slow
@pytest.mark.study
def test_onset_of_migration_is_near_and_only_where_there_is_one() -> None:
    found, intervals = Tally(), Tally()
    for seed in range(6):
        electrode(seed, migrating=True, tally=found, intervals=intervals)
        electrode(seed, migrating=False, tally=found, intervals=intervals)
    assert found.share("found: onsets within 10 % of the true cycle") == 1.0
    assert found.share("false: onsets in electrodes that do not migrate") == 0.0


def test_a_wave_that_is_distorted_from_the_start_has_no_early_onset() -> None:
    truth = sensing_truth.waves(np.random.default_rng(seed=5), migrating=False)
    cycles = capacitance_cycles(truth.recording, 1.0)
    assert cycles is not None
    assert migration(cycles).onset_cycle is None
    noisy = replace(cycles, harmonics=cycles.harmonics + 0.2)
    found = migration(noisy)
    assert found.onset_cycle is None
    assert found.distortion_before == pytest.approx(found.distortion_after, rel=0.05)


def test_cycles_of_a_capacitance_need_the_channel_and_enough_of_them() -> None:
    truth = sensing_truth.waves(np.random.default_rng(seed=6), migrating=False)
    channels = dict(truth.recording.channels)
    del channels["capacitance"]
    assert capacitance_cycles(replace(truth.recording, channels=channels), 1.0) is None
    assert capacitance_cycles(truth.recording, 0.01) is None


def test_films_of_two_levels_or_without_capacitance_keep_none() -> None:
    steps = measure_steps(sensing_truth.wrinkles(np.random.default_rng(seed=7), wrinkled=True).recording).steps
    marked, onset = wrinkling(steps[:2])
    assert onset is None
    assert [s.wrinkled for s in marked] == [None, None]
    bare = [replace(s, capacitance_step_pf=None) for s in steps]
    assert wrinkling(bare) == (tuple(bare), None)


def test_coats_that_are_not_enough_are_named() -> None:
    few = [Coat(f"c{i}", "E-1", i, 25.0 + i, 0.01) for i in range(1, 6)]
    with pytest.raises(NotIdentifiableError, match="5 numbers of coats"):
        fit_coverage(few)


def test_a_rise_that_has_not_saturated_says_so() -> None:
    n = np.arange(1, 9)
    c = 30 * (1 - np.exp(-n / 12.0))
    fit = fit_coverage([Coat(f"c{i}", "E-1", int(i), float(v), 0.005) for i, v in zip(n, c, strict=True)])
    assert fit.warnings
    assert fit.full_pf.lower < 30 < fit.full_pf.upper


def test_a_coat_is_the_mean_of_its_record_and_needs_its_number() -> None:
    t = np.arange(200) / 100
    rng = np.random.default_rng(seed=8)
    about = sensing_truth.metadata(protocol="coverage", coats=3)
    made = sensing_truth.recording(about, t, capacitance=25.0 + 0.002 * rng.standard_normal(t.size))
    coat = measure_coat(made)
    assert coat.coats == 3
    assert abs(coat.capacitance_pf - 25.0) < 4 * coat.capacitance_sd_pf < 0.002
    with pytest.raises(NotIdentifiableError, match="coats is missing"):
        measure_coat(replace(made, metadata=replace(about, coats=None)))
