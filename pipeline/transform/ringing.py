"""The ringing of a tapped clamp: where it rings, and the damped sinusoid that it is."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.optimize import least_squares

from pipeline.transform.noise import autoregression, density_ratio
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError

_FEWEST_CYCLES = 5.0
"""Cycles of a ring at least that are worth a fit."""
_LEAST_DECAY = 1e-6
"""Share of the angular frequency by which a ring decays at least."""


def rings(force: Float, where: str) -> list[tuple[int, int]]:
    """(first, stop) samples of each ringing, from the end of its blow to the next one's start or the end."""
    n = force.size
    if n < 64:
        return []
    level = float(np.median(force))
    x = force - level
    # Noise from the quiet parts, blows from the envelope: blocks that are far louder than the block before.
    block = max(8, n // 2000)
    blocks = x[: n // block * block].reshape(-1, block)
    loudness = np.sqrt((blocks**2).mean(axis=1))
    quiet = float(np.quantile(loudness, 0.05))
    loudest = float(loudness.max())
    if loudest < 6 * quiet:
        raise NotIdentifiableError(
            "the force shows no ringing above its noise", where=where, expected="at least one tap"
        )
    before = np.array([max(quiet, float(loudness[max(0, i - 3) : i].max(initial=0.0))) for i in range(loudness.size)])
    jumps = np.flatnonzero((loudness > 2.5 * before) & (loudness > 0.1 * loudest))
    starts: list[int] = []
    for j in jumps:
        if not starts or j - starts[-1] > 4:
            starts.append(int(j))
    if not starts:
        starts = [int(loudness.argmax())]
    edges = [*starts, loudness.size]
    result = []
    for a, b in itertools.pairwise(edges):
        part = slice(a * block, b * block - (block if b < loudness.size else 0))
        # The blow itself is over after the largest deflection; one more cycle is left for what it excites besides.
        peak = part.start + int(np.abs(x[part]).argmax())
        result.append((peak, max(part.stop, peak + 1)))
    return result


def damped_sinusoid(force: Float, interval: float) -> tuple[float, float, float, float] | None:
    """(f, sd, ζ, sd) of A e^{−ζω₀t} cos(ω_d t + φ) + offset, None when the signal does not carry it."""
    n = force.size
    if n < 64:
        return None
    spectrum = np.abs(np.fft.rfft((force - force.mean()) * np.hanning(n)))
    k = int(spectrum[2:].argmax()) + 2
    rough = k / (n * interval)
    cycle = 1 / (rough * interval)
    if cycle < 4 or n < _FEWEST_CYCLES * cycle:
        return None
    force = force[int(cycle) :]
    # Keep to where the ringing is above the noise: later samples only dilute.
    envelope = _envelope(force, cycle)
    floor = float(np.median(envelope[-max(1, envelope.size // 10) :]))
    loud = envelope > max(3 * floor, 0.01 * float(envelope.max()))
    stop = int((int(np.flatnonzero(~loud)[0]) if not loud.all() else loud.size) * cycle)
    # Some quiet samples fix the offset.
    x = force[: min(max(stop, int(_FEWEST_CYCLES * cycle)) + int(2 * cycle), force.size)]
    if x.size < _FEWEST_CYCLES * cycle or stop < _FEWEST_CYCLES * cycle:
        return None
    t = np.arange(x.size) * interval
    last = envelope[min(max(int(stop / cycle) - 1, 1), envelope.size - 1)]
    decay = float(np.log(max(envelope[0] / max(last, np.finfo(float).tiny), 1.01))) / (stop * interval)

    def columns(p: Float) -> Float:
        wave = np.exp((-np.exp(p[1]) + 1j * p[0]) * t)
        return np.column_stack([wave.real, wave.imag, np.ones_like(t)])

    def residual(p: Float) -> Float:
        design = columns(p)
        solution, *_ = np.linalg.lstsq(design, x, rcond=None)
        return np.asarray(x - design @ solution)

    # A wave that is gone from one sample to the next, or loses nothing in a million cycles, is no ring.
    turn = 2 * np.pi * rough
    slowest, fastest = float(np.log(_LEAST_DECAY * turn)), -float(np.log(interval))
    bounds = [0.5 * turn, slowest], [2 * turn, fastest]
    begin = float(np.clip(np.log(decay), slowest + 1, fastest - 1))
    best = None
    for scale in (1.0, 0.997, 1.003):
        found = least_squares(
            residual, [turn * scale, begin], x_scale=[np.exp(begin), 1.0], method="trf", bounds=bounds
        )
        if best is None or found.cost < best.cost:
            best = found
    if best is None:
        return None
    design = columns(best.x)
    linear, *_ = np.linalg.lstsq(design, x, rcond=None)
    left = x - design @ linear
    if float(left.var()) > 0.25 * float(x.var()):
        return None
    wd, s = float(best.x[0]), float(np.exp(best.x[1]))
    wave, other = design[:, 0], design[:, 1]
    by_frequency = t * (-linear[0] * other + linear[1] * wave)
    by_decay = -t * (linear[0] * wave + linear[1] * other)
    whole = np.column_stack([design, by_frequency, by_decay])
    inverse = np.linalg.inv(whole.T @ whole)
    turns = wd / (2 * np.pi) * interval
    coefficients, innovation = autoregression(left, np.array([0.0, *[turns] * 4]))
    noise = innovation * density_ratio(coefficients, turns)
    cov = noise * inverse[3:, 3:]
    w0 = float(np.hypot(wd, s))
    zeta = s / w0
    g = np.array([wd / w0, s / w0])
    gz = np.array([-s * wd / w0**3, wd**2 / w0**3])
    return (
        w0 / (2 * np.pi),
        float(np.sqrt(g @ cov @ g)) / (2 * np.pi),
        zeta,
        float(np.sqrt(gz @ cov @ gz)),
    )


def _envelope(x: Float, cycle: float) -> Float:
    """Half peak to peak of each cycle."""
    edges = (np.arange(int(x.size / cycle)) * cycle).astype(int)
    if edges.size < 2:
        return np.array([np.ptp(x) / 2])
    return (np.maximum.reduceat(x, edges) - np.minimum.reduceat(x, edges)) / 2
