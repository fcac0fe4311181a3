"""What a simulation misses is told as what it is: a phase in degrees, a size as a share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pipeline.diagnose.features.kinds import CHIRP_RESPONSE, RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.search.discrepancies import list_discrepancies
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.simulation.session import make_session
from schemas.arrays import Complex
from tests.helpers.plain_evidence import find_plain
from tests.helpers.truth_rig import make_session as true_session

SESSION = 105
"""Seed of a session: specimen, pauses and noise follow from it."""
TESTS = tuple({"protocol": "chirp", "strain_pp": s} for s in (0.006, 0.03))


@pytest.fixture(scope="module")
def features() -> list[RecordingFeatures]:
    return [reduce(r) for r in true_session(SESSION, TESTS).recordings]


@pytest.fixture(scope="module")
def fit(features: list[RecordingFeatures]) -> ExtendedFit:
    return find_plain(features).noise_fit


def change(features: RecordingFeatures, how: Callable[[Complex], Complex]) -> RecordingFeatures:
    """The features with the response of the sweep changed."""
    blocks = []
    for block in features.blocks:
        value = block.value
        if block.kind == CHIRP_RESPONSE:
            half = value.size // 2
            z = how(value[:half] + 1j * value[half:])
            value = np.concatenate([z.real, z.imag])
        blocks.append(replace(block, value=value))
    return replace(features, blocks=tuple(blocks))


@pytest.mark.parametrize(
    ("how", "words"),
    [
        (lambda z: z * np.exp(1j * np.radians(4.0)), "is missed by 4° of its phase, simulated too late"),
        (lambda z: z * np.exp(-1j * np.radians(12.0)), "is missed by 12° of its phase, simulated too early"),
        (lambda z: 1.25 * z, "is missed by 20 % of it"),
    ],
)
def test_a_response_is_missed_by_a_phase_or_by_a_share(
    features: list[RecordingFeatures], fit: ExtendedFit, how: Callable[[Complex], Complex], words: str
) -> None:
    session = make_session([features[0], change(features[1], how)])
    told = list_discrepancies(replace(fit, of=replace(fit.of, session=session)))
    own = [d.statement for d in told if d.recording_id == features[1].recording_id and "response" in d.statement]
    assert own
    assert all(words in statement for statement in own), own
