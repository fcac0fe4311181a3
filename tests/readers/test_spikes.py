"""A single sample of a response that stands alone is told and left out; edges, noise and answers to an edge are not."""

from __future__ import annotations

import numpy as np
import pytest

from ingest.canonical import canonical
from ingest.plausible import find_spikes
from schemas.recording import RawChannel, RawRecording

TIME_S = np.arange(0, 20, 0.02)
DRIVEN = np.sin(2 * np.pi * (0.1 + 0.02 * TIME_S) * TIME_S)
STEP = (TIME_S > 1).astype(float)


def respond(to: np.ndarray, noise: float = 0.002) -> np.ndarray:
    """A lag of 0.3 s with noise."""
    out = np.zeros(to.size)
    for i in range(1, to.size):
        out[i] = out[i - 1] + (to[i - 1] - out[i - 1]) * 0.02 / 0.3
    return out + noise * np.random.default_rng(29).standard_normal(to.size)


@pytest.mark.parametrize("size", [1e2, 1e6, 1e12, -1e3])
@pytest.mark.parametrize("place", [0, 1, 50, 617, 998, 999])
def test_a_spike_stands_alone_wherever_it_is(size: float, place: int) -> None:
    values = respond(DRIVEN)
    values[place] = size
    assert np.flatnonzero(find_spikes(values, DRIVEN)).tolist() == [place]


def test_a_few_spikes_of_different_size_are_all_found() -> None:
    values = respond(STEP)
    values[[100, 400, 700]] = 30.0, -1e4, 1e9
    assert np.flatnonzero(find_spikes(values, STEP)).tolist() == [100, 400, 700]


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.1])
def test_ordinary_responses_have_none(noise: float) -> None:
    for driven in (DRIVEN, STEP, np.random.default_rng(1).standard_normal(TIME_S.size)):
        assert not find_spikes(respond(driven, noise), driven).any()
        assert not find_spikes(driven + noise, driven).any()


def test_what_answers_an_edge_with_one_sample_is_no_spike() -> None:
    """A charge that a step of the input moves: its change, sample by sample."""
    assert not find_spikes(np.diff(STEP, prepend=0.0), STEP).any()


def test_a_spike_of_a_system_is_a_problem_of_its_recording() -> None:
    values = respond(DRIVEN)
    values[617] = 1e12
    time_ns = (TIME_S * 1e9).astype(np.int64)
    raw = RawRecording(
        rig={},
        channels=(RawChannel("input", "V", time_ns, DRIVEN), RawChannel("output", "1", time_ns, values)),
        metadata={
            "recording_id": "r1", "protocol": "sphs", "loading": "other", "specimen_id": "S-1",
            "started_at": "2026-03-01T12:00:00+00:00",
        },
    )  # fmt: skip
    found = canonical(raw, where="r1.csv")
    assert found.problems == ("output: one sample of 1e+12 at 12.34 s stands alone, a spike: NULL",)
    assert np.flatnonzero(np.isnan(found.channels["output"].values)).tolist() == [617]
