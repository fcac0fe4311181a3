"""Sessions of relaxations alone, that begin with a rest or with the record: what a testing machine exports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.records import rest_samples
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.results import Diagnosis
from schemas.recording import Recording
from tests.helpers.truth_rig import Effect, make_session

RELAXATIONS = [{"protocol": "step", "loading": "mechanical", "strain_pp": strain} for strain in (0.02, 0.05, 0.08)]


def cut_rest(recording: Recording) -> Recording:
    """The recording from its first movement on."""
    given = recording.channels["displacement"]
    begin_ns = int(given.time_ns[rest_samples(given.values)])
    channels = {
        quantity: replace(c, time_ns=c.time_ns[c.time_ns >= begin_ns], values=c.values[c.time_ns >= begin_ns])
        for quantity, c in recording.channels.items()
    }
    return replace(recording, channels=channels)


def diagnose_relaxations(seed: int, *effects: Effect, with_rest: bool) -> Diagnosis:
    recordings = make_session(seed, RELAXATIONS, effects).recordings
    return diagnose([reduce(r if with_rest else cut_rest(r)) for r in recordings])


@pytest.mark.long_after(1)
@pytest.mark.parametrize("with_rest", [True, False])
def test_nothing_is_found_where_nothing_is_hidden(with_rest: bool) -> None:
    assert diagnose_relaxations(7, with_rest=with_rest).verdict == "none"


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(("seed", "with_rest"), [(7, True), (7, False), (8, False)])
def test_a_film_that_stiffens_with_strain_is_named(seed: int, with_rest: bool) -> None:
    """Without rest the displacement begins with one noisy sample: how far each step goes is known no better."""
    found = diagnose_relaxations(seed, Effect("strain_stiffening", 0.3, {}), with_rest=with_rest)
    assert found.verdict == "named"
    assert found.mechanisms == ("strain_stiffening",)


def test_the_noise_is_told_from_the_hold_where_there_is_no_rest() -> None:
    (recording,) = make_session(7, RELAXATIONS[:1], ()).recordings
    at_rest, in_hold = (
        {n.quantity: float(np.average(n.power, weights=n.weight)) for n in reduce(r).noise}
        for r in (recording, cut_rest(recording))
    )
    assert in_hold["force"] == pytest.approx(at_rest["force"], rel=0.3)
