"""Results that a later stage needs in full and no table of the contract holds: their kinds, and their way into the table
`carried` and back, exactly.

JSON for what is plain, base64 for arrays, and the names of known dataclasses. Never pickle: what comes from a disk
must not be able to run.
"""

from __future__ import annotations

import base64
import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.analyse.session_features import SessionFeatures, Single
from pipeline.fit.relaxation.time_domain import CycleFit, CycleFits
from pipeline.transform.breakdown_life import Lifetime
from pipeline.transform.calibration import TapCalibration, WeightCalibration
from pipeline.transform.coats import Coat
from pipeline.transform.force_map import ForceMapReadings, ForceReading
from pipeline.transform.loop import LoopResponse
from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import Distortion, FrequencyResponse
from pipeline.transform.staircase import LaterRamp
from pipeline.transform.step import StepAnalysis, StepResponse
from pipeline.transform.step_levels import SlowChange
from schemas.life_covariates import OwnCovariate
from schemas.lifetimes import LifetimeRow
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


_TYPE, _ARRAY, _COMPLEX, _TIME = "$type", "$array", "$complex", "$time"
_KINDS = "bifcu"
"""Kinds of numpy arrays that may be carried: truth values and numbers."""


class Codec:
    """Packs objects of the given frozen dataclasses, nested as they like, and unpacks them again.

    Lists come back as tuples and mappings as dictionaries; arrays keep their type, shape and every bit.
    """

    def __init__(self, kinds: Iterable[type]) -> None:
        self._kinds = {kind.__name__: kind for kind in kinds}

    def pack(self, value: Any) -> str:
        """Text of an object. `TypeError` for what cannot be carried."""
        return json.dumps(self._encoded(value), separators=(",", ":"))

    def unpack(self, text: str) -> Any:
        """The object that `pack` made the text from. `ValueError` for a kind or field that is not known."""
        try:
            return self._decoded(json.loads(text))
        except (KeyError, TypeError) as error:
            raise ValueError(f"not a carried result: {error}") from error

    def _encoded(self, value: Any) -> Any:
        if value is None or isinstance(value, bool | int | float | str):
            return value.item() if isinstance(value, np.generic) else value
        if isinstance(value, np.generic):
            return self._encoded(value.item())
        if isinstance(value, complex):
            return {_COMPLEX: [value.real, value.imag]}
        if isinstance(value, datetime):
            return {_TIME: value.isoformat()}
        if isinstance(value, np.ndarray):
            if value.dtype.kind not in _KINDS:
                raise TypeError(f"an array of {value.dtype} cannot be carried")
            data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode("ascii")
            return {_ARRAY: [value.dtype.str, list(value.shape), data]}
        if dataclasses.is_dataclass(value) and self._kinds.get(type(value).__name__) is type(value):
            members = {f.name: self._encoded(getattr(value, f.name)) for f in dataclasses.fields(value)}
            return {_TYPE: type(value).__name__, **members}
        if isinstance(value, Mapping):
            if any(not isinstance(key, str) or key.startswith("$") for key in value):
                raise TypeError("a mapping to be carried needs plain text keys")
            return {key: self._encoded(member) for key, member in value.items()}
        if isinstance(value, list | tuple | frozenset | set):
            members_in_order = sorted(value) if isinstance(value, set | frozenset) else value
            return [self._encoded(member) for member in members_in_order]
        raise TypeError(f"{type(value).__name__} cannot be carried")

    def _decoded(self, value: Any) -> Any:
        if isinstance(value, list):
            return tuple(self._decoded(member) for member in value)
        if not isinstance(value, dict):
            return value
        if _ARRAY in value:
            kind, shape, data = value[_ARRAY]
            dtype = np.dtype(kind)
            if dtype.kind not in _KINDS:
                raise ValueError(f"an array of {dtype} is not a carried result")
            return np.frombuffer(base64.b64decode(data), dtype).reshape(shape).copy()
        if _COMPLEX in value:
            return complex(*value[_COMPLEX])
        if _TIME in value:
            return datetime.fromisoformat(value[_TIME])
        members = {
            key: self._decoded(member) if isinstance(member, list | dict) else member
            for key, member in value.items()
            if key != _TYPE
        }
        if _TYPE in value:
            return self._kinds[value[_TYPE]](**members)
        return members


KINDS: tuple[type, ...] = (
    FrequencyResponse,
    Distortion,
    RelaxationCurve,
    LaterRamp,
    StepAnalysis,
    StepResponse,
    SlowChange,
    Coat,
    LoopResponse,
    LifetimeRow,
    OwnCovariate,
    Lifetime,
    TapCalibration,
    WeightCalibration,
    CycleFits,
    CycleFit,
    ForceMapReadings,
    ForceReading,
    SessionFeatures,
    Single,
)
_CODEC = Codec(KINDS)
_LONGEST = 4096
"""Characters of a result in one row."""


def carried_table(recording_id: str, results: Sequence[Any]) -> pa.Table:
    """Rows of `carried` for one recording's results, long ones in several parts: a database holds some thousand rows of it at a time."""
    return TABLES["carried"].rows(
        {
            "recording_id": recording_id,
            "kind": type(result).__name__,
            "position": position,
            "part": part,
            "payload": packed[first : first + _LONGEST],
        }
        for position, result in enumerate(results)
        for packed in [_CODEC.pack(result)]
        for part, first in enumerate(range(0, len(packed), _LONGEST))
    )


def results_of(rows: Iterable[Mapping[str, Any]]) -> tuple[Any, ...]:
    """The results that rows of `carried` hold, in their order."""
    # Labs of before results were dealt into parts have one each.
    ordered = sorted(rows, key=lambda row: (int(row["position"]), int(row.get("part") or 0)))
    payloads = ("".join(row["payload"] for row in own) for _, own in groupby(ordered, key=itemgetter("position")))
    return tuple(map(_CODEC.unpack, payloads))
