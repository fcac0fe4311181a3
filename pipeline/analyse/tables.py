"""Tables that stand instead of recordings, as the results that a recording would have given."""

from __future__ import annotations

import numpy as np

from ingest.tables import RelaxationTable, ResponseTable
from pipeline.transform.correction import judged_machine
from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import STIFFNESS, FrequencyResponse
from schemas.protocols import MECHANICAL


def response_of(table: ResponseTable) -> FrequencyResponse:
    """The response of a film that a machine computed: clamp and load cell are not in it (no rig goes with it)."""
    usable = np.isfinite(table.value) & (table.frequency_hz > 0)
    response = FrequencyResponse(
        frequency_hz=table.frequency_hz,
        value=table.value,
        variance=table.standard_error**2,
        usable=usable,
        unusable_because=tuple("" if good else "no value" for good in usable),
        quantity=STIFFNESS,
        loading=MECHANICAL,
        amplitude=table.metadata.strain_pp,
        recording_id=table.metadata.recording_id,
        specimen_id=table.metadata.specimen_id,
        details={"measured_as": table.measured_as, "scale": table.scale},
    )
    return judged_machine(response, table.own_deformation)


def relaxation_of(table: RelaxationTable) -> RelaxationCurve:
    """The relaxation that a machine computed: the step is a jump, the values belong to instants."""
    usable = np.isfinite(table.value) & (table.time_s > 0)
    return RelaxationCurve(
        time_s=table.time_s,
        window_s=np.column_stack([table.time_s, table.time_s]),
        stiffness=table.value,
        variance=table.standard_error**2,
        usable=usable,
        ramp_s=0.0,
        step=1.0,
        rest_variance=0.0,
        step_sd=0.0,
        unusable_because=tuple("" if good else "no value" for good in usable),
        quantity=STIFFNESS,
        recording_id=table.metadata.recording_id,
        specimen_id=table.metadata.specimen_id,
        details={"measured_as": table.measured_as, "scale": table.scale},
    )
