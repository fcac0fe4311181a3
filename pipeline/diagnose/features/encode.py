"""Features of a recording as one text and back: what the recording stage leaves for the diagnosis.

Numbers come back bit for bit, but for what fills the space: weights of operators, sums of thousands, and the input of sweeps
are kept in single precision (relative 6e-8, a hundredth of the least noise), covariances as the triangle of their correlations in steps of
1.5e-11, below the share that a session adds to their diagonals. Columns of sparse rows are kept as differences. Bytes of
equal rank stand together before they are compressed, then base64. Never pickle: what comes from a disk must not be able to
run.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from datetime import datetime
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from pipeline.diagnose.features.kinds import FeatureBlock, NoiseSample, RecordingFeatures
from schemas.arrays import Float
from schemas.metadata import RigConstants

Array = NDArray[Any]

_VERSION = 6
"""Of the format; features of another version are made again."""
_LEVEL = 9
"""Of the compression: 9 is the densest that is quick."""
_MOST_BYTES = 1 << 30
"""Size of unpacked features beyond which a file is damaged."""
_SINGLES = "re_data", "im_data", "piece_mm"
_COLUMNS = ("re_columns", "im_columns")
_COVARIATES = ("value", "frequency_hz", "amplitude", "voltage_kv", "cycle", "time_s")
_EXACT, _SINGLE, _STEPS, _CORRELATIONS = "exact", "single", "steps", "correlations"
_UNIT = 2.0**36
"""Steps of a covariance that is kept, over the product of the two standard deviations."""


def pack(features: RecordingFeatures) -> str:
    """The features as text."""
    writer = _Writer()
    head = {
        "version": _VERSION,
        "recording_id": features.recording_id,
        "specimen_id": features.specimen_id,
        "protocol": features.protocol,
        "loading": features.loading,
        "started_at": features.started_at.isoformat(),
        "duration_s": features.duration_s,
        "rig": features.rig.to_text(),
        "blocks": [_block_head(b, writer) for b in features.blocks],
        "noise": [_noise_head(n, writer) for n in features.noise],
        "nodes": writer.array(features.nodes),
        "values": dict(features.values),
        "settings": dict(features.settings),
        "warnings": list(features.warnings),
    }
    text = json.dumps(head, separators=(",", ":")).encode()
    content = len(text).to_bytes(4, "little") + text + b"".join(writer.parts)
    return base64.b64encode(zstandard.ZstdCompressor(level=_LEVEL).compress(content)).decode("ascii")


def unpack(text: str) -> RecordingFeatures:
    """The features that `pack` made the text from. `ValueError` for any other text."""
    try:
        packed = base64.b64decode(text, validate=True)
        content = zstandard.ZstdDecompressor().decompress(packed, max_output_size=_MOST_BYTES)
        size = int.from_bytes(content[:4], "little")
        head = json.loads(content[4 : 4 + size])
        if head["version"] != _VERSION:
            raise ValueError(f"features of version {head['version']}, this is {_VERSION}")
        reader = _Reader(content, 4 + size)
        return RecordingFeatures(
            recording_id=head["recording_id"],
            specimen_id=head["specimen_id"],
            protocol=head["protocol"],
            loading=head["loading"],
            started_at=datetime.fromisoformat(head["started_at"]),
            duration_s=head["duration_s"],
            rig=RigConstants.parse(head["rig"]),
            blocks=tuple(_block(b, reader) for b in head["blocks"]),
            noise=tuple(_noise(n, reader) for n in head["noise"]),
            nodes=reader.array(head["nodes"]),
            values=head["values"],
            settings=head["settings"],
            warnings=tuple(head["warnings"]),
        )
    except (KeyError, TypeError, IndexError, zstandard.ZstdError) as error:
        raise ValueError(f"not the features of a recording: {error}") from error


def _block_head(block: FeatureBlock, writer: _Writer) -> dict[str, Any]:
    return {
        "kind": block.kind,
        "label": block.label,
        "components": list(block.components),
        "is_complex": block.is_complex,
        "basis": writer.covariances(block.basis) if _covariances(block.basis) else [writer.array(block.basis)],
        **{name: writer.array(getattr(block, name)) for name in _COVARIATES},
        "support": {name: writer.array(value, _form(name, value)) for name, value in block.support.items()},
    }


def _block(head: Mapping[str, Any], reader: _Reader) -> FeatureBlock:
    return FeatureBlock(
        kind=head["kind"],
        label=head["label"],
        components=tuple(head["components"]),
        is_complex=head["is_complex"],
        basis=reader.covariances(head["basis"]),
        support={name: reader.array(place) for name, place in head["support"].items()},
        **{name: reader.array(head[name]) for name in _COVARIATES},
    )


def _noise_head(sample: NoiseSample, writer: _Writer) -> dict[str, Any]:
    return {
        "quantity": sample.quantity,
        "interval_s": sample.interval_s,
        "setting": sample.setting,
        **{name: writer.array(getattr(sample, name)) for name in ("frequency_hz", "power", "weight")},
    }


def _noise(head: Mapping[str, Any], reader: _Reader) -> NoiseSample:
    arrays = {name: reader.array(head[name]) for name in ("frequency_hz", "power", "weight")}
    setting = tuple(head["setting"])
    return NoiseSample(quantity=head["quantity"], interval_s=head["interval_s"], setting=setting, **arrays)


def _covariances(basis: Float) -> bool:
    """Whether (c, n, n) are covariances to the last bit: symmetric, with positive diagonals and correlations up to 1."""
    if basis.ndim != 3 or not np.array_equal(basis, basis.transpose(0, 2, 1)):
        return False
    scale = np.sqrt(np.maximum(np.einsum("cii->ci", basis), 0.0))
    largest = scale[:, :, None] * scale[:, None, :]
    return bool(np.all(scale > 0) and np.all(largest > 0) and np.all(np.abs(basis) <= 1.001 * largest))


def _form(name: str, value: Array) -> str:
    """How an array of a block's support is kept."""
    if name in _SINGLES and bool(np.all(np.abs(value) < np.finfo(np.float32).max)):
        return _SINGLE
    whole = value.ndim == 1 and bool(np.all((value == np.rint(value)) & (np.abs(value) < 2**30)))
    return _STEPS if name in _COLUMNS and whole else _EXACT


class _Writer:
    """Collects arrays; `array` gives the entry by which `_Reader` finds one again."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self._at = 0

    def array(self, value: Array, form: str = _EXACT) -> list[Any]:
        """[form, type, shape, place of the first byte, number of bytes]."""
        kept = np.asarray(value)
        if form == _SINGLE:
            kept = kept.astype(np.float32)
        elif form == _STEPS:
            kept = np.diff(kept.astype(np.int32), prepend=np.int32(0)).astype(np.int32)
        data = _apart(kept)
        self.parts.append(data)
        self._at += len(data)
        return [form, kept.dtype.str, list(np.shape(value)), self._at - len(data), len(data)]

    def covariances(self, value: Float) -> list[list[Any]]:
        """Entries of the diagonals (c, n) and of the correlations below them, zigzag so that small ones have few bytes."""
        rows, columns = np.tril_indices(value.shape[1], -1)
        diagonal = np.einsum("cii->ci", value)
        scale = np.sqrt(diagonal)
        steps = np.rint(value[:, rows, columns] / (scale[:, rows] * scale[:, columns]) * _UNIT).astype(np.int64)
        return [self.array(diagonal), self.array((steps << 1) ^ (steps >> 63), _CORRELATIONS)]


class _Reader:
    """Finds arrays again by their entries, the first of them from byte `start` on."""

    def __init__(self, content: bytes, start: int) -> None:
        self._content = content
        self._start = start

    def array(self, entry: list[Any]) -> Float:
        form, kind, shape, at, size = entry
        dtype = np.dtype(kind)
        if dtype.kind not in "biuf":
            raise ValueError(f"an array of {dtype} is no feature")
        first = self._start + at
        kept = _together(self._content[first : first + size], dtype)
        if form == _SINGLE:
            kept = kept.astype(np.float64)
        elif form == _STEPS:
            kept = np.cumsum(kept).astype(np.float64)
        elif form == _CORRELATIONS:
            kept = ((kept >> 1) ^ -(kept & 1)) / _UNIT
        return kept.reshape(shape)

    def covariances(self, entries: list[list[Any]]) -> Float:
        """What `_Writer.covariances`, or `array` alone, wrote."""
        first = self.array(entries[0])
        if len(entries) == 1:
            return first
        c, n = first.shape
        rows, columns = np.tril_indices(n, -1)
        scale = np.sqrt(first)
        whole = np.zeros((c, n, n))
        below = self.array(entries[1]) * (scale[:, rows] * scale[:, columns])
        whole[:, rows, columns] = whole[:, columns, rows] = below
        whole[:, np.arange(n), np.arange(n)] = first
        return whole


def _apart(values: Array) -> bytes:
    """Bytes of equal rank together: those of exponents compress, which they do not among mantissas."""
    flat = np.ascontiguousarray(values).reshape(-1)
    return flat.view(np.uint8).reshape(flat.size, flat.itemsize).T.tobytes()


def _together(data: bytes, dtype: np.dtype[Any]) -> Array:
    ranks = np.frombuffer(data, np.uint8).reshape(dtype.itemsize, -1)
    return ranks.T.copy(order="C").reshape(-1).view(dtype)
