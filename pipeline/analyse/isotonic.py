"""A film that moves a constant load under voltage, as rows: the test, its strokes by level, and the curve."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import stdtrit

from pipeline.analyse.creep import spread
from pipeline.fit.retardation.isotonic import Isotonic, Stroke, measure_isotonic
from pipeline.transform.slow_voltage import SlowVoltage, measure_slow_voltage
from schemas.errors import NotIdentifiableError
from schemas.numbers import finite_or_none
from schemas.recording import Recording
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

NOT_ASKED = "the diagnosis does not simulate strokes at constant load: it does not ask this recording"


def analyse_isotonic(recording: Recording) -> tuple[tuple[str, ...], dict[str, pa.Table]]:
    """What limits a test at constant load, and its rows: levels of the voltage, or one that goes up and down slowly."""
    about = recording.metadata
    try:
        found = measure_isotonic(recording)
    except NotIdentifiableError:
        try:
            slow = measure_slow_voltage(recording, "displacement")
        except NotIdentifiableError:
            slow = None
        if slow is None:
            raise
        return slow.warnings, slow_tables(about.recording_id, about.specimen_id, slow)
    return found.warnings, isotonic_tables(about.recording_id, about.specimen_id, found)


def slow_tables(recording_id: str, specimen_id: str, found: SlowVoltage) -> dict[str, pa.Table]:
    """Tables `isotonic_tests` and `isotonic_strokes` of a record whose voltage goes up and down slowly; extension positive."""
    about = {"recording_id": recording_id, "specimen_id": specimen_id}
    bounded = math.isfinite(found.lower)
    test = {
        "mm_per_kv2": -found.drop_n_per_kv2,
        "mm_per_kv2_lower": -found.upper if bounded else None,
        "mm_per_kv2_upper": -found.lower if bounded else None,
        "mm_per_kv2_rising": finite_or_none(-found.rising),
        "mm_per_kv2_falling": finite_or_none(-found.falling),
        "exponent": finite_or_none(found.exponent),
        "drift_mm_per_h": 60 * found.drift_n_per_min,
        "warnings": "; ".join(found.warnings) or None,
    }
    half = found.peak_drop_sd * float(stdtrit(found.cycles - 1, 0.975)) if found.cycles > 1 else math.nan
    stroke = {
        "voltage_kv": found.top_kv,
        "repeats": found.cycles,
        "stroke_mm": -found.peak_drop,
        "stroke_mm_lower": finite_or_none(-found.peak_drop - half),
        "stroke_mm_upper": finite_or_none(-found.peak_drop + half),
    }
    return {
        "isotonic_tests": TABLES["isotonic_tests"].rows([about | test]),
        "isotonic_strokes": TABLES["isotonic_strokes"].rows([about | stroke]),
    }


def isotonic_tables(recording_id: str, specimen_id: str, found: Isotonic) -> dict[str, pa.Table]:
    """Tables `isotonic_tests`, `isotonic_strokes` and `isotonic_curves` of one recording."""
    about = {"recording_id": recording_id, "specimen_id": specimen_id}
    return {
        "isotonic_tests": TABLES["isotonic_tests"].rows([{**about, **_test(found)}]),
        "isotonic_strokes": TABLES["isotonic_strokes"].rows({**about, **_stroke(one)} for one in found.strokes),
        "isotonic_curves": _curve(recording_id, found),
    }


def _test(found: Isotonic) -> dict[str, Any]:
    return {
        "load_n": found.load_n,
        "load_change_n": found.load_change_n,
        **spread("mm_per_kv2", found.mm_per_kv2),
        **spread("exponent", found.exponent),
        "p_value": found.p_value,
        **spread("free_strain", found.free_strain),
        **spread("strain_per_field_squared_m2_per_mv2", found.strain_per_field_squared),
        "instant_within_s": found.instant_within_s,
        **spread("drift_mm_per_h", found.drift_mm_per_h),
        "model_order": found.retardation.selected_order,
        "warnings": "; ".join(found.warnings) or None,
    }


def _stroke(one: Stroke) -> dict[str, Any]:
    return {
        "voltage_kv": one.voltage_kv,
        "repeats": one.repeats,
        "on_s": one.on_s,
        **spread("stroke_mm", one.stroke_mm),
        **spread("instant_mm", one.instant_mm),
        **spread("slow_mm", one.slow_mm),
    }


def _curve(recording_id: str, found: Isotonic) -> pa.Table:
    record = found.retardation.record
    begins = np.array([hold.begins_s for hold in record.holds])
    return TABLES["isotonic_curves"].arrays(
        record.time_s.size,
        recording_id=recording_id,
        hold=record.hold,
        time_s=record.time_s,
        since_s=record.time_s - begins[record.hold],
        voltage_squared_kv2=record.mean @ record.drive,
        displacement_mm=record.displacement,
        modelled_mm=found.modelled,
        usable=record.usable,
    )
