"""Responses of several recordings averaged in complex form, with the spread between them kept apart from the noise.

A material that depends on strain then widens the spread instead of passing as noise. Averages of magnitude and phase
taken separately (thesis, fig 4-9) are biased and are not offered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.transform.response import FrequencyResponse
from schemas.arrays import Bool, Complex, Float, Int

SAME_FREQUENCY = 0.01
SAME_AMPLITUDE = 0.05
_SMOOTHED_OVER = 5
"""Lines over which the between-recording variance is pooled: one line alone says little about it."""


def average(responses: Sequence[FrequencyResponse]) -> FrequencyResponse:
    """Mean of responses of one quantity, at their common lines.

    Recordings of one amplitude (within 5 %) are repeats and are averaged first; the amplitudes are then averaged with the
    weights 1/(σ² + s²), s² the between-amplitude variance of DerSimonian and Laird (1986), pooled over neighbouring lines.
    Lines of different recordings belong together when they are equal, or nearest to each other within 1 % (the value is
    then brought to the common frequency along its own slope). Only usable lines count. `between_spread` is s, both
    components together, NaN where a single amplitude has the line; `recording_id` is None.

    Raises `ValueError` for no responses or mixed quantities or loadings.
    """
    if not responses:
        raise ValueError("no responses to average")
    kinds = {(r.quantity, r.loading) for r in responses}
    if len(kinds) > 1:
        raise ValueError(f"responses of several kinds: {sorted(kinds)}")
    groups = group_by_amplitude(responses)
    levels = [_combined(group) if len(group) > 1 else group[0] for group in groups]
    result = _combined(levels) if len(levels) > 1 else levels[0]
    specimens = {r.specimen_id for r in responses}
    spread = result.between_spread
    return FrequencyResponse(
        frequency_hz=result.frequency_hz,
        value=result.value,
        variance=result.variance,
        usable=result.usable,
        unusable_because=result.unusable_because,
        quantity=result.quantity,
        loading=result.loading,
        noise_variance=result.noise_variance,
        amplification=result.amplification,
        systematic=result.systematic,
        between_spread=np.full(result.frequency_hz.shape, np.nan) if spread is None else spread,
        effective_lines=result.effective_lines,
        repeats=len(responses),
        amplitude=levels[0].amplitude if len(levels) == 1 else None,
        specimen_id=specimens.pop() if len(specimens) == 1 else None,
        details={
            "recordings": [r.recording_id for r in responses],
            "amplitudes": [r.amplitude for r in levels],
            "recordings_per_amplitude": [len(g) for g in groups],
        },
    )


@dataclass(frozen=True)
class _Table:
    """Values of R responses at L common lines, (R, L); NaN and infinite variance where a response has no such line."""

    frequency_hz: Float
    value: Complex
    variance: Float
    noise: Float
    systematic: Complex | None
    amplification: Float
    usable: Bool
    reason: list[str]


def group_by_amplitude(responses: Sequence[FrequencyResponse]) -> list[list[FrequencyResponse]]:
    """Groups of equal amplitude in ascending order; responses without amplitude stand alone."""
    known = sorted((r for r in responses if r.amplitude is not None), key=lambda r: r.amplitude or 0.0)
    groups: list[list[FrequencyResponse]] = []
    for r in known:
        first = groups[-1][0].amplitude if groups else None
        if first is not None and abs((r.amplitude or 0.0) - first) <= SAME_AMPLITUDE * abs(first):
            groups[-1].append(r)
        else:
            groups.append([r])
    return groups + [[r] for r in responses if r.amplitude is None]


def _combined(responses: Sequence[FrequencyResponse]) -> FrequencyResponse:
    table = _table(responses)
    present = np.isfinite(table.variance) & table.usable
    weight = np.where(present, 1 / np.where(present, table.variance, 1.0), 0.0)
    count = present.sum(axis=0)
    value = np.where(present, table.value, 0.0)
    between = _between(value, weight, count)
    weight = np.where(present, 1 / (np.where(present, table.variance, 1.0) + between), 0.0)
    total = weight.sum(axis=0)
    some = total > 0
    share = weight / np.where(some, total, 1.0)
    mean = (share * value).sum(axis=0)
    variance = np.where(some, 1 / np.where(some, total, 1.0), np.nan)
    noise = (share**2 * np.where(present & np.isfinite(table.noise), table.noise, 0.0)).sum(axis=0)
    # Lines that are usable nowhere keep the plain mean of what there is, to be shown and not to be used.
    there = np.isfinite(table.value)
    plain = np.where(there, table.value, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    systematic = None
    if table.systematic is not None:
        systematic = np.einsum("rl,rlm->lm", share, np.where(present[:, :, None], table.systematic, 0.0))
    first = responses[0]
    amplitudes = [r.amplitude for r in responses if r.amplitude is not None]
    return FrequencyResponse(
        frequency_hz=table.frequency_hz,
        value=np.where(some, mean, plain),
        variance=variance,
        usable=some,
        unusable_because=tuple("" if ok else why for ok, why in zip(some, table.reason, strict=True)),
        quantity=first.quantity,
        loading=first.loading,
        noise_variance=noise,
        amplification=(share * np.where(present, table.amplification, 0.0)).sum(axis=0),
        systematic=systematic,
        between_spread=np.where(count > 1, np.sqrt(between), np.nan),
        effective_lines=float(some.sum()),
        amplitude=float(np.mean(amplitudes)) if amplitudes else None,
    )


def _between(value: Complex, weight: Float, count: Int) -> Float:
    """Between-recording variance s² (L,), both components: Q − (R − 1) over its factor, pooled over near lines."""
    total = weight.sum(axis=0)
    safe = np.where(total > 0, total, 1.0)
    mean = (weight * value).sum(axis=0) / safe
    q = (weight * np.abs(value - mean) ** 2).sum(axis=0) - np.maximum(count - 1, 0)
    factor = total - (weight**2).sum(axis=0) / safe
    several = count > 1
    # Pooled relative to the size of the response, which changes over the band.
    size = np.where(several, np.abs(mean), 1.0) ** 2
    size = np.maximum(size, np.finfo(float).tiny)
    excess = np.where(several, q / np.maximum(factor * size, np.finfo(float).tiny), 0.0)
    trust = several.astype(float)
    kernel = np.ones(min(_SMOOTHED_OVER, excess.size))
    pooled = np.convolve(excess * trust, kernel, mode="same") / np.maximum(np.convolve(trust, kernel, mode="same"), 1.0)
    return np.where(several, np.maximum(pooled, 0.0) * size, 0.0)


def _table(responses: Sequence[FrequencyResponse]) -> _Table:
    grid = _common_lines(responses)
    shape = len(responses), grid.size
    value = np.full(shape, np.nan, dtype=complex)
    variance, noise, amplification = np.full(shape, np.inf), np.full(shape, np.nan), np.full(shape, np.nan)
    usable = np.zeros(shape, dtype=bool)
    columns = {None if r.systematic is None else r.systematic.shape[1] for r in responses}
    shared = columns.pop() if len(columns) == 1 else None
    systematic = None if shared is None else np.zeros((*shape, shared), dtype=complex)
    reason = [""] * grid.size
    for i, r in enumerate(responses):
        mine, theirs = _match(r.frequency_hz, grid)
        value[i, theirs] = _moved(r, grid, mine, theirs)
        variance[i, theirs] = np.where(np.isfinite(r.variance[mine]), r.variance[mine], np.inf)
        # An estimate without variance counts, but far less than any that has one.
        lacking = ~np.isfinite(r.variance[mine]) & r.usable[mine]
        variance[i, theirs[lacking]] = np.abs(r.value[mine[lacking]]) ** 2
        noise[i, theirs] = (r.variance if r.noise_variance is None else r.noise_variance)[mine]
        amplification[i, theirs] = 1.0 if r.amplification is None else r.amplification[mine]
        usable[i, theirs] = r.usable[mine]
        if systematic is not None and r.systematic is not None:
            systematic[i, theirs] = r.systematic[mine]
        for m, t in zip(mine, theirs, strict=True):
            reason[t] = reason[t] or r.unusable_because[m]
    # A variance of zero would let one recording decide alone.
    size = np.abs(np.where(np.isfinite(value), value, 1.0))
    variance = np.maximum(variance, 1e-12 * size**2 + np.finfo(float).tiny)
    return _Table(grid, value, variance, noise, systematic, amplification, usable, reason)


def _common_lines(responses: Sequence[FrequencyResponse]) -> Float:
    """Lines of the response that has most, and those of the others that are not within 1 % of one already there."""
    grid = max(responses, key=lambda r: r.frequency_hz.size).frequency_hz
    for r in responses:
        mine, _ = _match(r.frequency_hz, grid)
        left = np.setdiff1d(np.arange(r.frequency_hz.size), mine)
        if left.size:
            fresh = r.frequency_hz[left]
            near = np.abs(fresh[:, None] / grid[None, :] - 1).min(axis=1) <= SAME_FREQUENCY
            grid = np.sort(np.concatenate([grid, fresh[~near]]))
    return grid


def _match(frequency: Float, grid: Float) -> tuple[Int, Int]:
    """Indices into `frequency` and `grid` of lines that are each other's nearest and within 1 %."""
    nearest = np.abs(frequency[:, None] - grid[None, :]).argmin(axis=1)
    back = np.abs(frequency[:, None] - grid[None, :]).argmin(axis=0)
    mine = np.arange(frequency.size)
    good = (back[nearest] == mine) & (np.abs(frequency / grid[nearest] - 1) <= SAME_FREQUENCY)
    return mine[good], nearest[good]


def _moved(response: FrequencyResponse, grid: Float, mine: Int, theirs: Int) -> Complex:
    """Values at the grid's frequencies, along the slope over ln f of the response's own lines."""
    value = response.value[mine]
    shift = np.log(grid[theirs] / response.frequency_hz[mine])
    if np.abs(shift).max(initial=0.0) < 1e-6 or response.frequency_hz.size < 3:
        return value
    slope = np.gradient(response.value, np.log(response.frequency_hz))
    return np.asarray(value + slope[mine] * shift)
