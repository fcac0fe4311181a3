"""Units are free: what a rig calls 1 may be a millionth or a million of it, and every fit says the same of the film.

Each recording is measured as it is and with the values of one channel multiplied by a power of ten. Numbers without a unit and
times stay; every other number goes with a whole power of the factor, the same for large and small ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from datetime import datetime
from typing import Any

import numpy as np
import pytest

from pipeline.analyse.creep import analyse_creep
from pipeline.analyse.cycle import cycle_fits, cycle_loops
from pipeline.analyse.isotonic import analyse_isotonic
from pipeline.analyse.pull import analyse_pull
from pipeline.diagnose.single.cycle_diagnosis import diagnose_cycle, estimate_noise_sd
from pipeline.diagnose.single.cycle_model import make_cycle
from pipeline.fit.relaxation.identify import fit_specimen
from pipeline.fit.relaxation.results import SpecimenFits
from pipeline.fit.relaxation.time_domain import CycleFits
from pipeline.transform.force_map import measure_force_map
from pipeline.transform.respond import respond
from pipeline.transform.step import measure_steps
from schemas.recording import Channel, Recording
from tests.physics import test_creep, test_force_map, test_isotonic, test_pull, test_steps
from tests.physics.rig_truth import recording, schroeder

POWERS = (-4, -2, -1, 1, 2, 4)
"""With which numbers may go: a variance with the square, a compliance with the inverse; of what is per square of a voltage twice that."""
LOGARITHMS = (".theta", ".covariance")
"""What a result keeps as logarithms for those who fit on."""
Measure = Callable[[Recording], Any]


def scaled(given: Recording, quantities: tuple[str, ...], factor: float) -> Recording:
    channels = {
        name: replace(channel, values=channel.values * factor) if name in quantities else channel
        for name, channel in given.channels.items()
    }
    return replace(given, channels=channels)


def numbers(found: Any, path: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Every number of a result by the path that leads to it; texts name units and sizes of their own, and are left out."""
    if hasattr(found, "to_pydict"):
        columns = found.to_pydict().items()
        found = {n: np.array([np.nan if x is None else x for x in v]) for n, v in columns if _is_of_numbers(v)}
    if path.endswith(LOGARITHMS):
        return
    if found is None or isinstance(found, (str, datetime, bytes)) or callable(found):
        return
    if isinstance(found, (bool, int, float, complex, np.number, np.bool_)):
        yield path, np.atleast_1d(found)
    elif isinstance(found, np.ndarray):
        if found.dtype.kind in "bifc" and found.size:
            yield path, found.ravel()
    elif isinstance(found, dict):
        for name, value in found.items():
            yield from numbers(value, f"{path}.{name}")
    elif is_dataclass(found):
        for field in fields(found):
            yield from numbers(getattr(found, field.name), f"{path}.{field.name}")
    elif isinstance(found, (list, tuple, frozenset)):
        for i, value in enumerate(found):
            yield from numbers(value, f"{path}[{i}]")


def _is_of_numbers(values: list[Any]) -> bool:
    return all(isinstance(x, (bool, int, float, type(None))) for x in values) and any(x is not None for x in values)


def off(measured: np.ndarray, other: np.ndarray, factor: float, share: float) -> float | None:
    """The power of the factor by which numbers differ; None where there is none."""
    if measured.shape != other.shape:
        return None
    finite = np.isfinite(measured)
    if not np.array_equal(finite, np.isfinite(other)):
        return None
    measured, other = measured[finite], other[finite]
    for power in (0, *POWERS):
        expected = measured * float(factor) ** power
        # What is next to nothing beside its neighbours is rounding of these.
        least = 1e-3 * np.abs(expected).max(initial=0.0)
        if np.all(np.abs(other - expected) <= share * np.maximum(np.abs(expected), least)):
            return power
    return None


def assert_free_of_units(given: Recording, quantities: tuple[str, ...], measure: Measure, share: float) -> None:
    plain = dict(numbers(measure(given)))
    assert plain
    powers: dict[str, set[float]] = {}
    for factor in (1e-6, 1e6):
        other = dict(numbers(measure(scaled(given, quantities, factor))))
        assert other.keys() == plain.keys()
        for path, values in plain.items():
            power = off(values, other[path], factor, share)
            assert power is not None, f"{path}: {values[:4]} against {other[path][:4]} at a factor {factor:g}"
            powers.setdefault(path, set()).add(power)
    moved = {path: power for path, power in powers.items() if len(power) > 1 and not np.allclose(plain[path], 0)}
    assert not moved
    assert any(power != {0} for power in powers.values())


def noisy(values: np.ndarray, sd: float, seed: int) -> np.ndarray:
    return values + np.random.default_rng(seed).normal(0, sd, values.size)


def cycled(**about: Any) -> Recording:
    """Two branches on a neo-Hookean film, by an exponential step from sample to sample."""
    time = np.arange(0, 16, 0.02)
    stretch = 1 + 0.25 * (8 - np.abs(8 - time))
    stress = 12 * (stretch - stretch**-2)
    for gamma, tau in ((30.0, 4.0), (60.0, 0.3)):
        q = np.zeros(time.size)
        for i in range(1, time.size):
            left = math.exp(-(time[i] - time[i - 1]) / tau)
            q[i] = q[i - 1] * left + gamma * tau * (stretch[i] - stretch[i - 1]) / (time[i] - time[i - 1]) * (1 - left)
        stress = stress + q
    channels = {"stretch": stretch, "stress": noisy(stress, 0.3, 1)}
    return recording(channels, 50.0, protocol="cycle", **about)


def forced() -> Recording:
    """The same as force and displacement of a film whose sizes are known."""
    made = cycled(film_length_mm=50, film_width_mm=20, film_thickness_mm=0.2, stretch_1=1)
    stretch, stress = (made.channels[name].values for name in ("stretch", "stress"))
    stamps = made.channels["stretch"].time_ns
    channels = {"displacement": 50 * (stretch - 1), "force": 4e-3 * stress}
    return replace(made, channels={name: Channel(name, stamps, values) for name, values in channels.items()})


def held() -> Recording:
    time = np.arange(0, 60, 0.002)
    x = 2 * np.clip((time - 4.0) / 0.1, 0, 1)
    since = np.maximum(time - 4.05, 0.0)
    f = x * (0.4 + 0.4 * np.exp(-since / 2.5) + 1.0 * np.exp(-since / 0.1))
    return recording({"displacement": noisy(3 + x, 5e-4, 1), "force": noisy(0.7 + f, 1e-3, 2)}, 500.0, protocol="step")


def swept() -> Recording:
    time = np.arange(0, 24, 0.002)
    t = np.clip(time - 2, 0, 20)
    rate = math.log(50) / 20
    x = 0.2 * np.sin(2 * np.pi * np.expm1(rate * t) / rate)
    frequency = np.fft.rfftfreq(2 * x.size, 0.002)
    s = 2j * np.pi * frequency
    force = np.fft.irfft(np.fft.rfft(x, 2 * x.size) * (1 + 1.5 * 0.05 * s / (1.5 + 0.05 * s)))[: x.size]
    about = {"frequency_start_hz": 1, "frequency_stop_hz": 50, "sweep": "log"}
    return recording({"displacement": noisy(x, 1e-4, 1), "force": noisy(force, 1e-3, 2)}, 500.0, **about)


def shaken() -> Recording:
    time = np.arange(0, 5, 0.002)
    x = 1 - np.cos(2 * np.pi * 2 * time)
    force = 0.5 * (1 - np.cos(2 * np.pi * 2 * time + 0.3))
    channels = {"displacement": noisy(x, 5e-4, 1), "force": noisy(0.5 + force, 1e-3, 2)}
    return recording(channels, 500.0, protocol="cyclic", frequency_hz=2.0, cycles=10)


def driven() -> Recording:
    u = schroeder(np.arange(1, 51), 1000)
    voltage = np.concatenate([np.zeros(500), np.tile(3.5 * (1 + u), 8)])
    force = -2e-3 * voltage**2
    about = {"protocol": "sphs", "loading": "electrical", "period_s": 1.0, "lines": "full"}
    band = {"frequency_start_hz": 1.0, "frequency_stop_hz": 50.0}
    return recording(
        {"voltage": noisy(voltage, 3e-3, 1), "force": noisy(0.9 + force, 1e-3, 2)}, 1000.0, **about, **band
    )


def torn() -> Recording:
    time, stretch, stress = test_pull.pulled(0.3, samples=1500)
    return recording({"stretch": stretch, "stress": stress}, 1 / (time[1] - time[0]), protocol="pull")


def determined(fits: SpecimenFits) -> Any:
    """The fits up to the chosen order, and how well the others fit: arms that the data do not tell may lie anywhere in a valley."""
    kept = tuple(fit for fit in fits.fits if fit.order <= fits.selected_order)
    return kept, fits.selected_order, [fit.chi2 + fit.data for fit in fits.fits]


def determined_of_cycle(fits: CycleFits) -> Any:
    told = tuple(fit for fit in fits.fits if None not in (*fit.gamma_sd, *fit.tau_sd))
    assert told
    return told, fits.selected_order, [fit.sse for fit in fits.fits]


def answered_and_fitted(given: Recording) -> Any:
    found = respond(given)
    if found.relaxation is not None:
        return found, determined(fit_specimen([], relaxations=[found.relaxation]))
    return found, determined(fit_specimen(found.responses))


def cause_of_cycle(given: Recording) -> Any:
    """What the diagnosis of one large cycle tells: how the plain model predicts, and what share each mechanism explains."""
    time = (given.channels["stretch"].time_ns - given.start_ns) * 1e-9
    stretch, stress = (given.channels[name].values[::4] for name in ("stretch", "stress"))
    found, comparison = diagnose_cycle(make_cycle(time[::4], stretch, stress, None, "c", "s"))
    explained = {one.model.equation: (one.before, one.explained) for one in comparison.ranked}
    chosen = {name: found.verdict == name for name in ("none", "named", "ambiguous", "unknown")}
    return comparison.p_value, explained, chosen, estimate_noise_sd(stress)


def loops_in_mm(given: Recording) -> Any:
    """Loops without what counts from an absolute stretch: a displacement in another unit is another stretch of the same film."""
    return cycle_loops(given).drop_columns(["stretch_low", "stretch_high", "modulus_kpa"])


SHARE = 1e-3
"""What searches that end within their tolerance may differ by."""
CASES: dict[str, tuple[Callable[[], Recording], tuple[str, ...], Measure]] = {
    "cycle of stress": (cycled, ("stress",), lambda r: [determined_of_cycle(one) for one in cycle_fits(r).fits]),
    "cycle of force": (forced, ("force",), lambda r: [determined_of_cycle(one) for one in cycle_fits(r).fits]),
    "loops of stress": (cycled, ("stress",), cycle_loops),
    "loops of force": (forced, ("force",), cycle_loops),
    "loops of displacement": (forced, ("displacement",), loops_in_mm),
    "cause of a cycle": (cycled, ("stress",), cause_of_cycle),
    "hold, force": (held, ("force",), answered_and_fitted),
    "hold, displacement": (held, ("displacement",), answered_and_fitted),
    "sweep, force": (swept, ("force",), answered_and_fitted),
    "sweep, displacement": (swept, ("displacement",), answered_and_fitted),
    "cyclic, force": (shaken, ("force",), respond),
    "cyclic, displacement": (shaken, ("displacement",), respond),
    "multisine, force": (driven, ("force",), respond),
    "multisine, voltage": (driven, ("voltage",), respond),
    "steps, force": (lambda: test_steps.record([8.0] * 4), ("force",), measure_steps),
    "steps, capacitance": (lambda: test_steps.record([8.0] * 4), ("capacitance",), measure_steps),
    "static force": (lambda: test_force_map.recording(cycles=3), ("force_1", "force_2"), measure_force_map),
    "creep, force": (test_creep.recorded, ("force",), lambda r: analyse_creep(r)[1]),
    "creep, displacement": (test_creep.recorded, ("displacement",), lambda r: analyse_creep(r)[1]),
    "strokes": (test_isotonic.recorded, ("displacement",), lambda r: analyse_isotonic(r)[1]),
    "pull": (torn, ("stress",), analyse_pull),
}


LONG = ("cycle of stress", "cause of a cycle", "static force")


@pytest.mark.long_after(1)
@pytest.mark.parametrize("case", [pytest.param(c, marks=[pytest.mark.slow] if c in LONG else []) for c in CASES])
def test_fits_do_not_know_the_unit_of_a_channel(case: str) -> None:
    make, quantities, measure = CASES[case]
    assert_free_of_units(make(), quantities, measure, SHARE)
