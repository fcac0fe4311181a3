"""A gain that is not the same everywhere: above and below rest, at small and large forces, early and late."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.reduce import reduce
from schemas.arrays import Float
from schemas.recording import Recording
from tests.helpers.everyday_faults import change_channel
from tests.helpers.truth_rig import compact_session

SEED = 990_000_003


@pytest.mark.parametrize("form", ["by side", "by level", "in time"])
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
