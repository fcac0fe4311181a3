"""The kinds of results that go from one stage to the next in full, and their way into the table `carried`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pipeline.analyse.carry import Codec
from pipeline.analyse.session_features import Alone, SessionFeatures
from pipeline.fit.relaxation.time_domain import CycleFit, CycleFits
from pipeline.transform.breakdown_life import Lifetime
from pipeline.transform.calibration import TapCalibration, WeightCalibration
from pipeline.transform.coats import Coat
from pipeline.transform.force_map import ForceMapReadings, ForceReading
from pipeline.transform.loop import LoopResponse
from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import Distortion, FrequencyResponse
from pipeline.transform.step import StepAnalysis, StepResponse
from pipeline.transform.step_levels import SlowChange
from schemas.lifetimes import LifetimeRow
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

KINDS: tuple[type, ...] = (
    FrequencyResponse,
    Distortion,
    RelaxationCurve,
    StepAnalysis,
    StepResponse,
    SlowChange,
    Coat,
    LoopResponse,
    LifetimeRow,
    Lifetime,
    TapCalibration,
    WeightCalibration,
    CycleFits,
    CycleFit,
    ForceMapReadings,
    ForceReading,
    SessionFeatures,
    Alone,
)
_CODEC = Codec(KINDS)


def carried_table(recording_id: str, results: Sequence[Any]) -> pa.Table:
    """Rows of `carried` for one recording's results."""
    return TABLES["carried"].rows(
        {
            "recording_id": recording_id,
            "kind": type(result).__name__,
            "position": position,
            "payload": _CODEC.pack(result),
        }
        for position, result in enumerate(results)
    )


def results_of(rows: Iterable[Mapping[str, Any]]) -> tuple[Any, ...]:
    """The results that rows of `carried` hold, in their order."""
    return tuple(_CODEC.unpack(row["payload"]) for row in sorted(rows, key=lambda row: int(row["position"])))
