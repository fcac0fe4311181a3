"""Lost samples of a system cost what they touch: the longest part without one is asked."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.analyse.single import take_single
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

PERIOD, PERIODS = 256, 4


def _multisine(*lost: int) -> Recording:
    """Four periods of a multisine, the given samples of its output lost."""
    size = PERIOD * PERIODS
    given = sum(np.sin(2 * np.pi * k * np.arange(size) / PERIOD - k * k) for k in range(1, 20))
    answer = 2 * given
    answer[list(lost)] = np.nan
    ns = np.arange(size) * 10_000_000
    about = RecordingMetadata.parse(
        {
            "recording_id": "r1", "protocol": "sphs", "loading": "other", "specimen_id": "S-1", "period_s": PERIOD * 0.01,
            "started_at": "2026-03-01T12:00:00+00:00",
        },
        where="r1",
    )  # fmt: skip
    channels = {"input": Channel("input", ns, given, unit="V"), "output": Channel("output", ns, answer, unit="mm")}
    return Recording(about, RigConstants(), channels)


@pytest.mark.parametrize(
    ("lost", "first", "last"),
    [((), 0, 1024), ((700,), 0, 700), ((100, 600), 101, 600), ((0, 1, 2, 1023), 3, 1023)],
)
def test_the_longest_part_without_a_loss_is_asked(lost: tuple[int, ...], first: int, last: int) -> None:
    recording = _multisine(*lost)
    found = take_single(recording)
    assert found is not None
    part = recording.channels["output"].values[first:last]
    assert found.channels["output"] == pytest.approx(part - part.mean())
    assert found.channels["input"] == pytest.approx(part / 2 - part.mean() / 2)


def test_a_record_of_lost_samples_alone_is_not_asked() -> None:
    assert take_single(_multisine(*range(PERIOD * PERIODS))) is None
