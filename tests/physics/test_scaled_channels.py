"""A channel in a wrong unit, put right in the features: they are those of the recording in the right unit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pipeline.diagnose.faults.undo import scale_channels
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from schemas.recording import Recording
from tests.helpers.truth_rig import make_session

SESSION = 613
"""Seed of the session: specimen and noise follow from it."""
DESIGNS: tuple[dict[str, Any], ...] = (
    {"protocol": "chirp", "strain_pp": 0.02, "rest_s": 1.0},
    {"protocol": "cyclic", "strain_pp": 0.08, "cycles": 6},
    {"protocol": "step", "loading": "mechanical", "hold_s": 10.0, "rest_s": 3.0, "after_s": 2.0},
    {"protocol": "cycle"},
    {"protocol": "sphs"},
    {"protocol": "step", "on_s": 3.0, "off_s": 3.0},
    {"protocol": "tap"},
    {"protocol": "weight"},
)
FACTORS = (
    ("displacement", 1e-3),
    ("displacement", -1.0),
    ("voltage", 1e3),
    ("voltage", -1.0),
    ("force", -9.81),
    ("capacitance", 10.0),
)
_THROUGH_THE_RIG = "displacement"
"""How strongly this channel's noise reaches the force depends on the rig's file, which has the right unit."""


@pytest.fixture(scope="module")
def recordings() -> tuple[Recording, ...]:
    return tuple(make_session(SESSION, DESIGNS).recordings)


def record_in(recording: Recording, quantity: str, factor: float) -> Recording:
    """The recording with a channel that has to be multiplied by a factor to be right."""
    channel = recording.channels[quantity]
    wrong = replace(
        channel,
        values=channel.values / factor,
        resolution=None if channel.resolution is None else channel.resolution / abs(factor),
    )
    return replace(recording, channels={**recording.channels, quantity: wrong})


def assert_alike(found: RecordingFeatures, wanted: RecordingFeatures) -> None:
    """All numbers of two sets of features, but for noise that reaches the force through the rig."""
    assert [b.kind for b in found.blocks] == [b.kind for b in wanted.blocks]
    for mended, right in zip(found.blocks, wanted.blocks, strict=True):
        names = ("value", "amplitude", "voltage_kv", "frequency_hz", "time_s", "cycle")
        pairs = [(name, getattr(mended, name), getattr(right, name)) for name in names]
        assert mended.support.keys() == right.support.keys()
        pairs += [(name, mended.support[name], right.support[name]) for name in right.support]
        pairs += [
            (name, mended.basis[i], right.basis[i])
            for i, name in enumerate(right.components)
            if not name.startswith(_THROUGH_THE_RIG)
        ]
        for name, ours, theirs in pairs:
            np.testing.assert_allclose(
                ours,
                theirs,
                rtol=1e-6,
                atol=1e-9 * np.nanmax(np.abs(theirs), initial=0.0),
                err_msg=f"{right.kind} {name}",
            )
    assert found.values == pytest.approx(wanted.values, rel=1e-6)
    for ours, theirs in zip(found.noise, wanted.noise, strict=True):
        np.testing.assert_allclose(ours.power, theirs.power, rtol=1e-6)
        assert ours.setting == pytest.approx(theirs.setting, rel=1e-3)


@pytest.mark.parametrize("number", range(len(DESIGNS)))
@pytest.mark.parametrize(("quantity", "factor"), FACTORS)
def test_a_unit_that_is_put_right_gives_the_features_of_the_right_unit(
    recordings: tuple[Recording, ...], number: int, quantity: str, factor: float
) -> None:
    """Amplitudes, windows of strain and exposures were left in the wrong unit: what depends on strain was asked at a wrong strain, and of
    a tap's ringing the logarithm of the frequency was scaled.
    """
    recording = recordings[number]
    if quantity not in recording.channels:
        return
    if recording.metadata.protocol == "weight":
        factor = abs(factor)  # a force that falls under masses is refused
    features = reduce(record_in(recording, quantity, factor))
    assert_alike(scale_channels(features, {quantity: factor}), reduce(recording))
