"""Exports whose force stands still at rest: rounded to the step of a converter, set to zero, or computed without noise.

Such a rest shows no noise, and next to none every model is wrong by thousands of times its noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.records import find_converter_step, rest_samples
from pipeline.diagnose.features.reduce import reduce
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording
from tests.helpers.truth_rig import Effect, make_session

SESSION = [
    {"protocol": "chirp", "loading": "mechanical"},
    {"protocol": "cyclic", "loading": "mechanical"},
    {"protocol": "step", "loading": "mechanical"},
    {"protocol": "cycle", "loading": "mechanical"},
    {"protocol": "sphs", "loading": "electrical"},
    {"protocol": "step", "loading": "electrical"},
]
STEP_N = 0.001
"""Six times the noise of the force."""


def still(recording: Recording) -> Recording:
    """The force set to its mean while the input rests, as machines export it that reset their reading."""
    given = recording.channels["displacement" if recording.metadata.loading == "mechanical" else "voltage"]
    force = recording.channels["force"]
    rests = force.time_ns <= given.time_ns[max(rest_samples(given.values) - 1, 0)]
    values = np.where(rests, force.values[rests].mean(), force.values)
    return replace(recording, channels={**recording.channels, "force": replace(force, values=values)})


def round_force(recording: Recording, *, step: float = STEP_N, stated: bool = True) -> Recording:
    """The force in whole steps of a converter."""
    force = recording.channels["force"]
    rounded = replace(force, values=np.round(force.values / step) * step, resolution=step if stated else None)
    return replace(recording, channels={**recording.channels, "force": rounded})


def round_unsaid(recording: Recording) -> Recording:
    """The same with a file that does not say so."""
    return round_force(recording, stated=False)


@pytest.mark.long_after(1)
@pytest.mark.parametrize("alter", [still, round_force, round_unsaid])
def test_nothing_is_found_where_nothing_is_hidden(alter: Callable[[Recording], Recording]) -> None:
    recordings = make_session(7, SESSION).recordings
    found = diagnose([reduce(alter(r)) for r in recordings])
    assert (found.verdict, found.faults) == ("none", ())


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("alter", [still, pytest.param(round_force, marks=pytest.mark.long)])
def test_an_effect_is_found_all_the_same(alter: Callable[[Recording], Recording]) -> None:
    recordings = make_session(7, SESSION, [Effect("strain_stiffening", 0.3, {})]).recordings
    found = diagnose([reduce(alter(r)) for r in recordings])
    assert (found.verdict, found.mechanisms) == ("named", ("strain_stiffening",))


@pytest.mark.parametrize("design", SESSION, ids=lambda d: f"{d['loading']} {d['protocol']}")
def test_noise_is_that_of_the_rounding_which_hides_it(design: dict[str, str]) -> None:
    (recording,) = make_session(7, [design]).recordings
    rest = rest_samples(
        recording.channels["displacement" if "displacement" in recording.channels else "voltage"].values
    )
    whole = round_force(recording)
    assert np.ptp(whole.channels["force"].values[: max(rest, 1)]) < 2.1 * STEP_N
    power = [n.power.min() * n.interval_s for n in reduce(whole).noise if n.quantity == "force"]
    own_s = float(np.median(np.diff(recording.channels["force"].time_ns))) * 1e-9
    assert power
    assert max(power) >= 0.9 * STEP_N**2 / 12 * own_s


def test_cycles_without_noise_or_step_are_not_judged() -> None:
    (recording,) = make_session(7, SESSION[3:4]).recordings
    force = recording.channels["force"]
    smooth = np.interp(force.time_ns, force.time_ns[::200], force.values[::200])
    calm = still(replace(recording, channels={**recording.channels, "force": replace(force, values=smooth)}))
    with pytest.raises(NotIdentifiableError):
        diagnose([reduce(calm)])


@pytest.mark.parametrize("step", [1e-4, 0.001, 0.3])
def test_the_step_of_a_converter_is_that_of_which_all_changes_are_multiples(step: float) -> None:
    codes = np.random.default_rng(3).integers(-50, 50, 400)
    assert find_converter_step(codes * step + 0.123) == pytest.approx(step)
    assert find_converter_step(np.append(codes * step, np.nan)) == pytest.approx(step)
    assert find_converter_step(np.random.default_rng(4).standard_normal(400)) == 0.0
    assert find_converter_step(np.zeros(50)) == 0.0
