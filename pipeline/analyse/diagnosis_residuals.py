"""Residuals of a diagnosis, block by block, and the most telling blocks, measured and simulated, for figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.diagnose.features.kinds import FeatureBlock, RecordingFeatures
from pipeline.diagnose.results import Diagnosis, Residuals
from schemas.arrays import Float
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

_SHOWN_BLOCKS, _SHOWN_PER_KIND, _SHOWN_VALUES = 24, 4, 3000
"""Blocks that are kept for figures: the most telling, some of each kind, and not more values than this."""
_LEAST_SHOWN = 1e-12


def residual_tables(diagnosis: Diagnosis, features: Sequence[RecordingFeatures]) -> dict[str, pa.Table]:
    """Tables `diagnosis_blocks` and `diagnosis_curves`; `features` (in any order) are what the diagnosis was made from."""
    blocks = list(_blocks(diagnosis, features))
    extended = diagnosis.is_extended
    curves = TABLES["diagnosis_curves"]
    return {
        "diagnosis_blocks": TABLES["diagnosis_blocks"].from_objects(
            blocks,
            specimen_id=diagnosis.specimen_id,
            block=lambda one: one.label,
            feature_count=lambda one: one.size,
            plain_rms=lambda one: one.rms(one.plain),
            extended_rms=lambda one: one.rms(one.extended) if extended else None,
        ),
        "diagnosis_curves": curves.stack(
            _curve(diagnosis.specimen_id, block, extended=extended) for block in _chosen(blocks)
        ),
    }


@dataclass(frozen=True)
class _Block:
    """A block of features with what both models say of it; (n,) each. `source` has its covariates, where known."""

    recording_id: str
    kind: str
    label: str
    position: int
    measured: Float
    plain: Float
    extended: Float
    sd: Float
    frequency_hz: Float
    time_s: Float
    source: FeatureBlock | None

    @property
    def size(self) -> int:
        return self.measured.size

    def rms(self, simulated: Float) -> float:
        """Root mean square residual in SD of the noise."""
        return float(np.sqrt(np.mean(((self.measured - simulated) / np.maximum(self.sd, _LEAST_SHOWN)) ** 2)))

    @property
    def gain(self) -> float:
        """What the extension takes off χ²."""
        return self.size * (self.rms(self.plain) ** 2 - self.rms(self.extended) ** 2)

    @property
    def telling(self) -> float:
        """χ² of the plain model beyond the noise, and what the extension takes off it."""
        return self.size * max(self.rms(self.plain) ** 2 - 1, 0.0) + max(self.gain, 0.0)


def _blocks(d: Diagnosis, features: Sequence[RecordingFeatures]) -> Iterator[_Block]:
    known = {r.recording_id: r for r in features}
    for residuals in d.residuals:
        source = known.get(residuals.recording_id)
        yield from _blocks_of(residuals, source.blocks if source is not None else ())


def _blocks_of(r: Residuals, sources: Sequence[FeatureBlock]) -> Iterator[_Block]:
    pairs = list(zip(r.kind.tolist(), r.label.tolist(), strict=True))
    by_name = {(b.kind, b.label): b for b in sources}
    for position, (kind, label) in enumerate(dict.fromkeys(pairs)):
        rows = np.array([pair == (kind, label) for pair in pairs])
        source = by_name.get((kind, label))
        yield _Block(
            r.recording_id, kind, label, position, r.measured[rows], r.plain[rows], r.extended[rows], r.sd[rows],
            r.frequency_hz[rows], r.time_s[rows], source if source is not None and source.size == rows.sum() else None,
        )  # fmt: skip


def _chosen(blocks: Sequence[_Block]) -> list[_Block]:
    """The blocks to keep for figures, in their own order: the one in which the cause explains most, the most telling, and of each kind
    some.
    """
    ranked = sorted(range(len(blocks)), key=lambda i: (-blocks[i].telling, i))
    if ranked:
        most = max(ranked, key=lambda i: blocks[i].gain)
        ranked = [most, *(i for i in ranked if i != most)]
    wanted = set(ranked[:_SHOWN_BLOCKS])
    of_kind: dict[str, int] = {}
    for i in ranked:
        of_kind[blocks[i].kind] = of_kind.get(blocks[i].kind, 0) + 1
        if of_kind[blocks[i].kind] <= _SHOWN_PER_KIND or blocks[i].size <= _SHOWN_PER_KIND:
            wanted.add(i)
    kept, values = set(), 0
    for i in ranked:
        if i in wanted and values + blocks[i].size <= _SHOWN_VALUES:
            kept.add(i)
            values += blocks[i].size
    return [b for i, b in enumerate(blocks) if i in kept]


def _curve(specimen_id: str, block: _Block, *, extended: bool) -> pa.Table:
    """The values of a block."""
    source, position = block.source, np.arange(block.size)
    is_complex = source is not None and source.is_complex
    return TABLES["diagnosis_curves"].arrays(
        block.size,
        specimen_id=specimen_id,
        recording_id=block.recording_id,
        kind=block.kind,
        block=block.label,
        position=position,
        component=np.where(position < block.size // 2, "real", "imaginary") if is_complex else "",
        frequency_hz=block.frequency_hz,
        amplitude=None if source is None else source.amplitude,
        voltage_kv=None if source is None else source.voltage_kv,
        cycle=None if source is None else source.cycle,
        time_s=block.time_s,
        measured=block.measured,
        plain=block.plain,
        extended=block.extended if extended else None,
        sd=block.sd,
    )
