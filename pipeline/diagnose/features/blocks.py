"""Making blocks of features from functionals: what the protocols share. No protocol's own functionals belong here."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse

from pipeline.diagnose.features.functionals import Component, Functionals, Operator
from pipeline.diagnose.features.kinds import FeatureBlock
from schemas.arrays import Bool, Complex, Float

_MATTERS = 0.1
"""Sum of dropped weights times the largest response, in standard deviations of the feature; most of it cancels."""
UNIT_NOISE = "unit/0"
"""Part of the noise that no channel's law scales."""
GroupEdges = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Signals:
    """Input and output of a record on one clock, both without their rest level (N,).

    `factor`, `slow` and `spectrum` are those of `Functionals.operator`, `components` the parts of the noise of this record.
    `noise_sd` of one sample of the output and `largest_response` say which weights of an operator are too small to matter.
    """

    input: Float
    output: Float
    interval_s: float
    nodes: Float
    components: tuple[Component, ...]
    factor: Callable[[Float], Complex] | None = None
    slow: bool = False
    spectrum: Callable[[Float], Complex] | None = None
    noise_sd: float = 0.0
    largest_response: float = 1.0

    def during(self, first: int, stop: int) -> Signals:
        """The samples first … stop − 1 as a record of their own, before which all rested."""
        return replace(self, input=self.input[first:stop], output=self.output[first:stop])


def block(
    kind: str,
    label: str,
    signals: Signals,
    kernels: Float,
    first: int,
    *,
    is_complex: bool,
    frequency: float | Float = np.nan,
    amplitude: float | Float = np.nan,
    voltage: float | Float = np.nan,
    cycle: float | Float = np.nan,
    time: float | Float = np.nan,
    support: dict[str, Float] | None = None,
    components: Sequence[Component] | None = None,
    drifts: bool = False,
) -> FeatureBlock:
    """A block of the functionals `kernels` (n, M) beginning at sample `first`; covariates (n,) or (n/2,) for complex ones."""
    found = Functionals(kernels, first, signals.output.size, signals.interval_s)
    used = signals.components if components is None else tuple(components)
    extra = dict(support or {})
    basis = found.covariances(used)
    made = found.operator(
        signals.input,
        signals.nodes,
        factor=signals.factor,
        slow=signals.slow,
        spectrum=signals.spectrum,
        tolerance=_MATTERS * signals.noise_sd / signals.largest_response * np.sqrt(np.diag(basis[0])),
    )
    extra |= operator_support(made)
    if drifts:
        extra |= drift_support(kernels, first, signals.interval_s)
    return assembled(
        kind,
        label,
        found.values(signals.output),
        tuple(c.name for c in used),
        basis,
        is_complex=is_complex,
        frequency=frequency,
        amplitude=amplitude,
        voltage=voltage,
        cycle=cycle,
        time=time,
        support=extra,
    )


def assembled(
    kind: str,
    label: str,
    value: Float,
    components: tuple[str, ...],
    basis: Float,
    *,
    is_complex: bool,
    frequency: float | Float = np.nan,
    amplitude: float | Float = np.nan,
    voltage: float | Float = np.nan,
    cycle: float | Float = np.nan,
    time: float | Float = np.nan,
    support: dict[str, Float] | None = None,
) -> FeatureBlock:
    """A block with covariates repeated for the imaginary parts of complex values."""
    count = value.size // 2 if is_complex else value.size

    def column(x: float | Float) -> Float:
        one = np.broadcast_to(np.asarray(x, dtype=float), (count,))
        return np.tile(one, 2) if is_complex else one.copy()

    return FeatureBlock(
        kind=kind,
        label=label,
        value=value,
        components=components,
        basis=basis,
        is_complex=is_complex,
        frequency_hz=column(frequency),
        amplitude=column(amplitude),
        voltage_kv=column(voltage),
        cycle=column(cycle),
        time_s=column(time),
        support=support or {},
    )


def add_unit_noise(made: FeatureBlock, covariance: Float) -> FeatureBlock:
    """A block with noise (n, n), or (n,) of independent values, beside that of its channels, in the square of its own unit."""
    basis = made.basis
    if basis.ndim == 3 and covariance.ndim == 1:
        covariance = np.diag(covariance)
    elif basis.ndim == 2 and covariance.ndim == 2:
        basis = np.array([np.diag(row) for row in basis])
    return replace(made, components=(*made.components, UNIT_NOISE), basis=np.concatenate([basis, covariance[None]]))


def add_rounding(made: FeatureBlock, variance: float) -> FeatureBlock:
    """A block of mean levels against one rest level with the rounding of its output by the converter, where that hides the noise.

    A level that hardly moves stays on one step of the converter: however long it is averaged, it is wrong by up to half a step.
    """
    return made if variance == 0 else add_unit_noise(made, variance * (np.eye(made.size) + 1))


def operator_support(made: Operator) -> dict[str, Float]:
    """The arrays of an operator, for `FeatureBlock.support`."""
    arrays = {}
    for name, matrix in (("re", made.re), ("im", made.im)):
        arrays[f"{name}_data"] = matrix.data
        arrays[f"{name}_columns"] = matrix.indices.astype(float)
        arrays[f"{name}_rows"] = matrix.indptr.astype(float)
    return arrays


def operator_of(found: FeatureBlock, nodes: int) -> Operator:
    """The operator of a block of functionals."""

    def matrix(name: str) -> scipy.sparse.csr_array:
        columns, rows = found.support[f"{name}_columns"], found.support[f"{name}_rows"]
        return scipy.sparse.csr_array(
            (found.support[f"{name}_data"], columns.astype(np.int64), rows.astype(np.int64)),
            shape=(rows.size - 1, nodes),
        )

    return Operator(matrix("re"), matrix("im"))


def drift_support(kernels: Float, first: int, interval_s: float) -> dict[str, Float]:
    """How features see a slow drift of the output: its values at `drift_s` (q,) s times `drift_weight` (n, q)."""
    stop = first + kernels.shape[1]
    edges = np.concatenate([np.linspace(first, stop, 33), np.geomspace(1, max(stop, 2), 33)])
    edges = np.unique(np.rint(edges).astype(int))
    edges = edges[(edges >= first) & (edges <= stop)]
    weight = np.add.reduceat(kernels, edges[:-1] - first, axis=1)
    return {"drift_s": (edges[:-1] + edges[1:] - 1) / 2 * interval_s, "drift_weight": weight.ravel()}


def window_means(edges: Sequence[tuple[int, int]], first: int, count: int, lost: Bool | None = None) -> Float:
    """(windows, count) kernels of the means over samples a…b−1 that are not `lost` (n,), relative to sample `first`."""
    rows = np.zeros((len(edges), count))
    for row, (a, b) in zip(rows, edges, strict=True):
        kept = np.ones(b - a) if lost is None else (~lost[a:b]).astype(float)
        row[a - first : b - first] = kept / kept.sum()
    return rows


def log_windows(start: int, stop: int, per_decade: int, shortest: int = 1) -> list[tuple[int, int]]:
    """Windows [a, b) from `start` to `stop` samples (both > 0 after an edge), equally wide in log time."""
    if stop <= start:
        return []
    count = max(1, int(np.ceil(np.log10(stop / start) * per_decade)))
    edges = np.unique(np.rint(np.geomspace(start, stop, count + 1)).astype(int))
    merged = [int(edges[0])]
    for edge in edges[1:]:
        if edge - merged[-1] >= shortest:
            merged.append(int(edge))
    return list(itertools.pairwise(merged))


def cycle_groups(count: int) -> GroupEdges:
    """Groups of cycles 1, 2–3, 4–6, 7–last as half-open ranges from 0; what is not there is left out."""
    edges = [0, 1, 3, 6, count]
    return tuple((a, min(b, count)) for a, b in itertools.pairwise(edges) if a < min(b, count))
