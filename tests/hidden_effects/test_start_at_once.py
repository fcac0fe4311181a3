"""Recordings of machines whose test begins with the record: no rest before the first sweep or cycle, sweeps with hardly any between.

A diagnosis once left all of these out without a word, and judged on what was left.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.kinds import CHIRP_RESPONSE, CYCLIC_RESPONSE
from pipeline.diagnose.features.records import rest_samples
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.results import Diagnosis
from schemas.recording import Recording
from tests.helpers.truth_rig import Effect, compact_session
from tests.helpers.truth_rig import make_session as true_session
from tests.hidden_effects.test_forms import CYCLES, SESSION, explained

SESSION_SEED = 103


def without_rest(recording: Recording) -> Recording:
    """A chirp or a cyclic recording from its first movement on; all others as they are."""
    if recording.metadata.protocol not in ("chirp", "cyclic"):
        return recording
    given = recording.channels["displacement"]
    begin_ns = int(given.time_ns[rest_samples(given.values)])
    channels = {}
    for quantity, channel in recording.channels.items():
        kept = channel.time_ns >= begin_ns
        channels[quantity] = replace(channel, time_ns=channel.time_ns[kept], values=channel.values[kept])
    return replace(recording, channels=channels)


def only_first_sweep(recording: Recording) -> Recording:
    """A chirp from its first movement to the end of its first sweep: no rest at all."""
    cut = without_rest(recording)
    given = cut.channels["displacement"]
    first = given.time_ns < cut.start_ns + int(0.9e9 * recording.metadata.period_s)
    moves = np.abs(given.values - given.values[0]) > 0.02 * np.ptp(given.values)
    stop_ns = int(given.time_ns[np.flatnonzero(moves & first)[-1]])
    channels = {}
    for quantity, channel in cut.channels.items():
        kept = channel.time_ns < stop_ns
        channels[quantity] = replace(channel, time_ns=channel.time_ns[kept], values=channel.values[kept])
    return replace(cut, metadata=replace(cut.metadata, repeats=1, period_s=None, rest_before_s=None), channels=channels)


def diagnose_without_rest(*effects: Effect) -> Diagnosis:
    session = compact_session(SESSION_SEED, effects)
    return diagnose([reduce(without_rest(recording)) for recording in session.recordings])


def test_every_sweep_and_cycle_counts_without_rest_before_it() -> None:
    for recording in compact_session(SESSION_SEED, ()).recordings:
        kind = {"chirp": CHIRP_RESPONSE, "cyclic": CYCLIC_RESPONSE}.get(recording.metadata.protocol)
        if kind is None:
            continue
        whole, cut = reduce(recording), reduce(without_rest(recording))
        responses = [[b for b in features.blocks if b.kind == kind] for features in (whole, cut)]
        assert len(responses[0]) == len(responses[1]) > 0
        # The first cycles of a film that settles depend on where they are taken to begin.
        settled = slice(None) if kind == CHIRP_RESPONSE else slice(-1, None)
        for before, after in zip(responses[0][settled], responses[1][settled], strict=True):
            size = np.abs(before.value).max()
            assert np.abs(before.value - after.value).max() < 0.02 * size


def test_a_sweep_without_any_rest_tells_its_noise_beyond_its_harmonics() -> None:
    for recording in compact_session(SESSION_SEED, ()).recordings:
        if recording.metadata.protocol != "chirp":
            continue
        whole, cut = reduce(recording), reduce(only_first_sweep(recording))
        (alone,) = [b for b in cut.blocks if b.kind == CHIRP_RESPONSE]
        first = next(b for b in whole.blocks if b.kind == CHIRP_RESPONSE)
        assert alone.value.size > 0.9 * first.value.size
        for quantity in ("displacement", "force"):
            found, expected = (
                float(np.mean([np.median(n.power) * n.interval_s for n in f.noise if n.quantity == quantity]))
                for f in (cut, whole)
            )
            assert found == pytest.approx(expected, rel=0.5), quantity


@pytest.mark.long
def test_nothing_is_found_in_a_clean_session_without_rest() -> None:
    assert diagnose_without_rest().verdict == "none"


@pytest.mark.long
@pytest.mark.parametrize(
    ("cause", "severity"),
    [
        ("rig_constants", 0.2),
        ("missing_relaxation", 0.2),
        pytest.param("amplitude_softening", 0.1, marks=pytest.mark.long),
    ],
)
def test_causes_are_named_without_rest(cause: str, severity: float) -> None:
    found = diagnose_without_rest(Effect(cause, severity))
    assert found.verdict in ("named", "ambiguous")
    assert found.mechanisms[0] == cause


def test_what_shifts_a_mean_shifts_it_in_the_cycles_that_it_is_told_against_as_well() -> None:
    """Without rest a mean is told against that of the last cycles: a film that stiffens moves all of them alike."""
    truth = true_session(SESSION, CYCLES, [Effect("strain_stiffening", 0.8, {})])
    cut = replace(truth, recordings=tuple(without_rest(r) for r in truth.recordings))
    share, _ = explained(cut, "strain_stiffening", "", {"stiffening": 0.3, "asymmetry": 0.5, "exponent": 2.0})
    assert share > 0.99
