"""A gain that is not the same everywhere: above and below rest, at small and large forces, early and late."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.mechanisms.sensor import GAIN_ERROR
from pipeline.diagnose.simulation.effects import bent
from schemas.arrays import Float
from schemas.recording import Recording
from tests.helpers.everyday_faults import change_channel
from tests.helpers.truth_rig import compact_session

SEED = 990_000_003
UNEVEN = ["by side", "by level", "in time"]


@pytest.mark.parametrize("form", UNEVEN)
def test_a_gain_that_differs_by_side_level_or_time_is_named_in_that_form(form: str) -> None:
    """Where its even part is the film's, only that is seen."""
    recordings = compact_session(SEED, ()).recordings
    largest = max(float(np.nanmax(r.channels["force"].values)) for r in recordings if "force" in r.channels)

    def misread(recording: Recording, share: float) -> Recording:
        def read(force: Float) -> Float:
            rest = float(np.median(force[:20]))
            apart = {
                "by side": np.abs(force - rest),
                "by level": force**2 / largest,
                "in time": force * (2 * share - 1),
            }
            return np.asarray(1.03 * force + 0.03 * apart[form])

        return change_channel(recording, "force", read)

    told = [misread(r, i / (len(recordings) - 1)) for i, r in enumerate(recordings)]
    found = diagnose([reduce(r) for r in told])
    assert found.mechanisms == ("gain_error",)
    assert {c.variant for c in found.candidates if c.mechanism == "gain_error"} == {f"force, {form}"}


def test_where_no_test_tells_a_large_force_no_gain_rises_with_it() -> None:
    """Of multisines alone: it had been infinite."""
    effect = GAIN_ERROR.effect({"gain": 0.1, "unevenness": 1.0}, "force, by level")
    assert not bent(np.array([1.0, 2.0]), 1.0, 0.0, effect.reading).any()
