"""Local polynomial estimate of a frequency response with its variance, for many lines at once.

Around bin k the response is a polynomial in the distance r of the bins, Y(k+r) = (Σ h_s r^s) U(k+r) [+ Σ t_s r^s] + noise:
H = h_0, and what the polynomial leaves over is the noise (Pintelon and Schoukens, System Identification, 2nd ed.,
section 7.2). The bracket is the transient of a record that does not begin and end at rest. Which bins belong to which
line is decided here as well; what the spectra are is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from schemas.arrays import Bool, Complex, Float, Int

DEGREE = 2
_STEEPEST = 3.0
"""Power of frequency with which the spectrum of a transient may change."""
_LACK_OF_FIT = 1e-3
"""Level of the test that finds a window too wide for its polynomial."""


@dataclass(frozen=True)
class Windows:
    """Bins of lines at `line` (L,): `index` (L, W) into the spectra, `offset` (L, W) bins from the line, `inside` (L, W) in use.

    Rows have W = the widest window; unused places point at the line itself and are left out.
    """

    line: Int
    index: Int
    offset: Float
    inside: Bool

    def narrowed(self, half_width: Int) -> Windows:
        """The same lines with windows of at most `half_width` (L,) bins to each side."""
        inside = self.inside & (np.abs(self.offset) <= half_width[:, None])
        width = int(np.abs(self.offset[inside]).max(initial=0))
        keep = (np.abs(self.offset) <= width).any(axis=0)
        return Windows(self.line, self.index[:, keep], self.offset[:, keep], inside[:, keep])


@dataclass(frozen=True)
class LocalFit:
    """Estimates at L lines.

    Parameters
    ----------
    value : (L,) complex
    variance : (L,) E|Δvalue|², both components
    noise : (L,) variance of one bin of the output beyond the polynomial, both components
    gain : (L,) variance / noise
    degrees_of_freedom : (L,) complex ones, bins less coefficients
    half_width : (L,) bins that were used to each side
    degree : (L,) degree that was used
    """

    value: Complex
    variance: Float
    noise: Float
    gain: Float
    degrees_of_freedom: Float
    half_width: Int
    degree: Int


def log_lines(first: float, last: float, *, wanted: int = 100, half_width: int = 12) -> tuple[Int, Int]:
    """Bins of lines from `first` to `last` (in bins) and their half widths n, both (L,).

    Log-spaced where that leaves room for windows that do not overlap, 2n + 1 bins apart below; n grows with frequency.
    Estimates are then independent of each other. In the lowest lines n is at most a third of the bin, because a response
    is smooth in relative frequency.
    """
    ratio = (last / first) ** (1 / (wanted - 1))
    bins, widths = [max(1, round(first))], [_low_width(first, half_width)]
    while True:
        k = bins[-1]
        width = _low_width(k, half_width)
        if round(k * (ratio - 1)) > 2 * width:
            step = round(k * (ratio - 1))
            width = (step - 1) // 2
        else:
            width = max(width, _low_width(k + 2 * width + 1, half_width))
            step = widths[-1] + width + 1
        if k + step > last + 0.5:
            return np.array(bins, dtype=np.int64), np.array(widths, dtype=np.int64)
        bins.append(k + step)
        widths.append(width)


def _low_width(line: float, half_width: int) -> int:
    return int(np.clip(line // 3, min(6, half_width), half_width))


def windows(lines: Int, half_width: Int, bins: int) -> Windows:
    """Windows around `lines` (L,) within the bins 1 … bins − 1; bin 0 holds offsets and is never used."""
    widest = int(half_width.max())
    offset = np.arange(-widest, widest + 1)
    index = lines[:, None] + offset[None, :]
    inside = (np.abs(offset)[None, :] <= half_width[:, None]) & (index >= 1) & (index < bins)
    spread = np.broadcast_to(offset, index.shape).astype(float)
    return Windows(lines, np.where(inside, index, lines[:, None]), spread, inside)


def neighbours(positions: Int, count: int) -> Windows:
    """Windows over the `count` nearest of the lines themselves, for spectra known at `positions` (L,) only."""
    lines = positions.size
    count = min(count, lines)
    first = np.clip(np.arange(lines) - count // 2, 0, lines - count)
    index = first[:, None] + np.arange(count)[None, :]
    offset = (positions[index] - positions[:, None]).astype(float)
    return Windows(positions, index, offset, np.ones(index.shape, dtype=bool))


def fit(
    input_: Complex,
    output: Complex,
    at: Windows,
    *,
    degree: int = DEGREE,
    transient_scale: Float | None = None,
) -> LocalFit:
    """Local polynomials of one degree.

    With `transient_scale` (L,) the transient is part of the model. Its columns are nearly those of the response itself,
    because the spectrum of a sweep is smooth, so they are held by a prior: `transient_scale` is the standard deviation of
    the transient's spectrum at the line, as the ends of the record suggest it, and the spectrum changes over the window no
    faster than about the third power of frequency.
    """
    u, y = input_[at.index] * at.inside, output[at.index] * at.inside
    reach = np.maximum(np.abs(at.offset * at.inside).max(axis=1), 1.0)
    r = at.offset / reach[:, None]
    powers = (r[:, :, None] ** np.arange(degree + 1)) * at.inside[:, :, None]
    design = powers * u[:, :, None]
    bins = at.inside.sum(axis=1)
    if transient_scale is None:
        coefficients, inverse = _least_squares(design, y)
        residual = y - np.einsum("lwc,lc->lw", design, coefficients)
        freedom = np.maximum(bins - design.shape[2], 1).astype(float)
        noise = _power(residual) / freedom
    else:
        whole = np.concatenate([design, powers.astype(complex)], axis=2)
        free, _ = _least_squares(whole, y)
        residual = y - np.einsum("lwc,lc->lw", whole, free)
        freedom = np.maximum(bins - whole.shape[2], 1).astype(float)
        noise = _power(residual) / freedom
        # Rows of a prior: coefficient t_s is 0 ± scale; a scale far above the noise leaves the transient free.
        weight = np.sqrt(noise) / np.maximum(transient_scale, np.finfo(float).tiny)
        lines, columns = whole.shape[0], whole.shape[2]
        prior = np.zeros((lines, degree + 1, columns), dtype=complex)
        smooth = np.minimum(_STEEPEST * reach / np.maximum(at.line, 1), 1.0)
        for s in range(degree + 1):
            prior[:, s, degree + 1 + s] = weight / smooth**s
        held = np.concatenate([whole, prior], axis=1)
        coefficients, inverse = _least_squares(held, np.concatenate([y, np.zeros((lines, degree + 1))], axis=1))
    gain = inverse[:, 0]
    return LocalFit(
        value=coefficients[:, 0],
        variance=noise * gain,
        noise=noise,
        gain=gain,
        degrees_of_freedom=freedom,
        half_width=np.rint(reach).astype(np.int64),
        degree=np.full(bins.shape, degree, dtype=np.int64),
    )


def adaptive_fit(
    input_: Complex, output: Complex, lines: Int, half_width: Int, *, transient_scale: Float | None = None
) -> LocalFit:
    """Local polynomials with windows as wide as the response allows.

    Where the residual of a window is significantly larger than that of one half as wide (a lightly damped resonance is no
    polynomial over a wide window), the narrower is taken, and in the narrowest the degree goes up by two. Shapes (L,).
    """
    classes = np.frexp(half_width)[1] // 2
    parts = [np.flatnonzero(classes == c) for c in np.unique(classes)]
    fits = [
        _adaptive(input_, output, lines[p], half_width[p], None if transient_scale is None else transient_scale[p])
        for p in parts
    ]
    order = np.argsort(np.concatenate(parts))
    return LocalFit(*(np.concatenate([getattr(f, n) for f in fits])[order] for n in LocalFit.__dataclass_fields__))


def _adaptive(input_: Complex, output: Complex, lines: Int, half_width: Int, transient_scale: Float | None) -> LocalFit:
    """The same for lines whose windows are of similar width, so that little of the arrays is padding."""
    # Narrow windows cannot tell a transient from a response.
    narrowest = np.minimum(half_width, 6 if transient_scale is None else 12)
    at = windows(lines, half_width, input_.size)
    best = fit(input_, output, at, transient_scale=transient_scale)
    width = half_width.copy()
    while True:
        narrower = np.maximum(width // 2, narrowest)
        active = narrower < width
        if not active.any():
            break
        width = np.where(active, narrower, width)
        tried = fit(input_, output, at.narrowed(width), transient_scale=transient_scale)
        best = _choose(best, tried, active & _significantly_larger(best, tried))
    if transient_scale is None:
        tried = fit(input_, output, at.narrowed(narrowest), degree=DEGREE + 2)
        best = _choose(best, tried, _significantly_larger(best, tried))
    return best


def _significantly_larger(wide: LocalFit, narrow: LocalFit) -> Bool:
    # A window contains the narrower one; the F quantile is then conservative, which keeps wide windows.
    limit = fdtri(2 * wide.degrees_of_freedom, 2 * narrow.degrees_of_freedom, 1 - _LACK_OF_FIT)
    return np.asarray(wide.noise > limit * narrow.noise)


def _choose(old: LocalFit, new: LocalFit, take: Bool) -> LocalFit:
    return LocalFit(*(np.where(take, getattr(new, n), getattr(old, n)) for n in LocalFit.__dataclass_fields__))


def _power(residual: Complex) -> Float:
    return np.asarray((residual.real**2 + residual.imag**2).sum(axis=1))


def _least_squares(design: Complex, data: Complex) -> tuple[Complex, Float]:
    """Coefficients (L, c) and diagonal of (XᴴX)⁻¹ (L, c) of L complex systems, by QR of columns scaled to length 1."""
    scale = np.sqrt(
        np.einsum("lwc,lwc->lc", design.real, design.real) + np.einsum("lwc,lwc->lc", design.imag, design.imag)
    )
    scale = np.where(scale > 0, scale, 1.0)
    q, r = np.linalg.qr(design / scale[:, None, :])
    # An empty column (no input at all) would make R singular; its coefficient then means nothing and its gain is huge.
    diagonal = np.einsum("lcc->lc", r)
    weak = np.abs(diagonal) < 1e-12
    r = r + np.einsum("lc,cd->lcd", np.where(weak, 1e-12, 0.0), np.eye(r.shape[1]))
    inverse = np.linalg.inv(r)
    right = np.einsum("lwc,lw->lc", q.conj(), data)
    coefficients = np.einsum("lcd,ld->lc", inverse, right) / scale
    return coefficients, (np.abs(inverse) ** 2).sum(axis=2) / scale**2
