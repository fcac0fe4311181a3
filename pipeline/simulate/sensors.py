"""From a signal on the fine clock to the samples of a converter: latency, filter, decimation, noise, steps.

Belongs here: what every channel does. Effects that a laboratory does not know of are in `effects`.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from pipeline.simulate.tables import number, text, whole
from schemas.arrays import Float


@dataclass(frozen=True)
class Sensor:
    """One channel of a rig, canonical units.

    The converter has 2^`bits` steps between `low` and `high`; 0 bits: no steps and no limits. `filter_hz`: corner of a
    single-pole anti-alias filter, 0 for none; `delay_s`: latency that the laboratory knows and writes into the file.
    `unit`: the unit that the rig writes, the canonical one where empty.
    """

    sample_rate_hz: float = number(above=0)
    noise_sd: float = number(at_least=0)
    low: float = number()
    high: float = number()
    bits: int = whole(16, at_least=0)
    filter_hz: float = number(0.0, at_least=0)
    delay_s: float = number(0.0, at_least=0)
    sensor: str | None = text(None)
    unit: str | None = text(None)

    def __post_init__(self) -> None:
        if self.high <= self.low:
            raise ValueError(f"high {self.high:g} is not above low {self.low:g}")

    @property
    def resolution(self) -> float | None:
        """One step of the converter."""
        return (self.high - self.low) / 2**self.bits if self.bits else None

    def digitise(self, signal: Float, interval_s: float, factor: int, rng: np.random.Generator) -> Float:
        """Samples of a signal (n,) on a clock of `interval_s`: every `factor`-th instant, from the first on."""
        seen = delayed(signal, self.delay_s / interval_s) if self.delay_s else signal
        if self.filter_hz:
            seen = low_pass(seen, self.filter_hz, interval_s)
        return self.convert(seen[::factor], rng)

    def convert(self, values: Float, rng: np.random.Generator) -> Float:
        """Values with noise, in whole steps and within the range of the converter."""
        noisy = values + self.noise_sd * rng.standard_normal(values.shape) if self.noise_sd else values
        step = self.resolution
        if step is None:
            return noisy
        return np.clip(np.rint(noisy / step) * step, self.low, self.high - step)


def delayed(signal: Float, samples: float) -> Float:
    """The signal (n,) later by a number of samples that need not be whole; before the first sample it was at rest.

    Cubic interpolation: the error of a sine of the angular frequency ω is below (ωh)⁴/100.
    """
    whole_samples = math.floor(samples)
    part = samples - whole_samples
    padded = np.concatenate([np.full(whole_samples + 2, signal[0]), signal, signal[-1:]])
    weights = np.array(
        [
            (part + 1) * part * (part - 1) / 6,
            -(part + 1) * part * (part - 2) / 2,
            (part + 1) * (part - 1) * (part - 2) / 2,
            -part * (part - 1) * (part - 2) / 6,
        ]
    )
    n = signal.size
    # padded[n + k] is the sample `whole_samples` + 2 − k before sample n: the wanted instant lies between k = 1 and 2.
    return np.asarray(sum(weight * padded[k : k + n] for k, weight in enumerate(weights)))


def low_pass(signal: Float, corner_hz: float, interval_s: float) -> Float:
    """A single pole at `corner_hz`, settled at the first sample; exact for straight lines between the samples."""
    step = 2 * np.pi * corner_hz * interval_s
    keep = math.exp(-step)
    second = 1 - (1 - keep) / step
    first = (1 - keep) / step - keep
    start = signal[0]
    return np.asarray(start + lfilter([second, first], [1.0, -keep], signal - start))


def random_stream(seed: int, *names: str) -> np.random.Generator:
    """A random generator of its own for each name, whatever the order in which they are asked for."""
    digest = hashlib.sha256("/".join(names).encode()).digest()
    words = [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]
    return np.random.default_rng([seed, *words])
