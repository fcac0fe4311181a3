"""Rows of a diagnosis: verdict, discrepancies, causes, the extended model, how far the film moved."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.analyse.diagnosis_residuals import residual_tables
from pipeline.diagnose.faults.state import describe_fault
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.mechanisms import MECHANISMS
from pipeline.diagnose.results import NONE, Diagnosis, Extension
from pipeline.diagnose.single.comparison import Comparison, RankedModel
from pipeline.physics.film import RelaxationModel
from schemas.mechanisms import FINDING
from schemas.numbers import finite_or_none
from schemas.protocols import MECHANICAL
from schemas.tables import ARMS, TABLES

if TYPE_CHECKING:
    import pyarrow as pa


_PARAMETERS = ("k0", *(f"k{i}" for i in range(1, ARMS + 1)), *(f"tau{i}" for i in range(1, ARMS + 1)), "c_inf")


def diagnosis_tables(diagnosis: Diagnosis, features: Sequence[RecordingFeatures]) -> dict[str, pa.Table]:
    """Arrow tables of one specimen's diagnosis. `features` (in any order) are those it was made from."""
    specimen = {"specimen_id": diagnosis.specimen_id}
    tables = {
        "diagnoses": TABLES["diagnoses"].rows([_diagnosis_row(diagnosis)]),
        "discrepancies": TABLES["discrepancies"].from_objects(
            diagnosis.discrepancies, recording_id=lambda found: found.recording_id or None, **specimen
        ),
        "corrections": TABLES["corrections"].rows(_correction_rows(diagnosis)),
        "diagnosis_candidates": TABLES["diagnosis_candidates"].from_objects(
            diagnosis.candidates,
            gain_lower=None,
            gain_upper=None,
            held_out_error=None,
            form=lambda candidate: candidate.variant or None,
            **specimen,
        ),
        "diagnosis_terms": TABLES["diagnosis_terms"].from_objects(diagnosis.terms, **specimen),
        "diagnosis_parameters": TABLES["diagnosis_parameters"].rows(_parameters(diagnosis)),
        **residual_tables(diagnosis, features),
    }
    if diagnosis.extension is not None and diagnosis.extension.severities:
        tables["model_fits"] = TABLES["model_fits"].rows([_fit_row(diagnosis, diagnosis.extension)])
    return tables


def comparison_tables(diagnosis: Diagnosis, comparison: Comparison) -> dict[str, pa.Table]:
    """The same of a record that was asked alone, whose causes have each their own gain."""
    tables = diagnosis_tables(diagnosis, ())
    rows = [_place_row(diagnosis, place) for place in comparison.ranked]
    tables["diagnosis_candidates"] = TABLES["diagnosis_candidates"].rows(rows)
    tables["assumptions"] = TABLES["assumptions"].rows(
        {"recording_id": name, "specimen_id": diagnosis.specimen_id, **asdict(one)}
        for name, assumed in diagnosis.assumed.items()
        for one in assumed
    )
    if not diagnosis.plain_film.k:  # no film
        tables.pop("model_fits", None)
        tables.pop("diagnosis_parameters")
    elif "model_fits" in tables:
        own = {"loading": MECHANICAL, "method": "time_domain"}
        tables["model_fits"] = TABLES["model_fits"].rows([{**row, **own} for row in tables["model_fits"].to_pylist()])
    return tables


def _place_row(d: Diagnosis, place: RankedModel) -> dict[str, Any]:
    model = place.model
    key, main = next(iter(model.severity.items()), (None, None))
    gain = {
        "gain": finite_or_none(place.gain),
        "gain_lower": finite_or_none(place.lower),
        "gain_upper": finite_or_none(place.upper),
        "explained": finite_or_none(place.explained),
    }
    return {
        "specimen_id": d.specimen_id,
        "mechanism": model.mechanism,
        "parameter": key,
        "severity": None if main is None else main.value,
        "severity_sd": None if main is None else finite_or_none(main.sd),
        "held_out_error": place.after,
        **({} if d.verdict == NONE else gain),
        "form": model.variant or None,
        "equation": model.equation,
    }


def undiagnosed_tables(specimen_id: str, reasons: Sequence[str]) -> dict[str, pa.Table]:
    """The row of a specimen whose recordings cannot be asked at all: no verdict, and why."""
    row = {"specimen_id": specimen_id, "could_not_ask": list(reasons)}
    return {"diagnoses": TABLES["diagnoses"].rows([row])}


def _diagnosis_row(d: Diagnosis) -> dict[str, Any]:
    row: dict[str, Any] = {
        "specimen_id": d.specimen_id,
        "verdict": d.verdict,
        "mechanism": d.mechanism,
        "mechanisms": list(d.mechanisms),
        "also_possible": list(d.also_possible),
        "p_value": d.p_value,
        "supported_by": list(d.supported_by),
        "smallest_detectable": json.dumps(_smallest(d)),
        "invisible": list(d.invisible),
        "could_not_ask": list(d.could_not_ask),
        "unexplained": list(d.unexplained),
        "would_tell": list(d.would_tell),
        "recordings": len(d.residuals),
        "probabilities": json.dumps(dict(d.probabilities)) if d.probabilities else None,
        "stage": d.stage,
        "depends_on": list(d.depends_on),
    }
    severity: dict[str, Any] = {f.cause: {FINDING: describe_fault(f)} for f in reversed(d.faults)}
    if d.extension is not None:
        severity |= _severity(d.extension)
    if severity:
        row["severity"] = json.dumps(severity)
    if d.extension is not None:
        row |= {
            "feature_count": d.extension.size,
            "chi2": d.extension.plain_chi2,
            "chi2_extended": d.extension.chi2,
        }
    if d.held_out is not None:
        held = d.held_out
        row |= {
            "held_out_error_before": held.before,
            "held_out_error_after": held.after,
            "gain": held.gain,
            "gain_lower": held.lower,
            "gain_upper": held.upper,
            "held_out_parts": json.dumps({k: {"before": b, "after": a} for k, (b, a) in held.parts.items()}),
        }
    if d.next_recording is not None:
        row |= {
            "next_recording": d.next_recording.text,
            "next_design": json.dumps([dict(design) for design in d.next_recording.designs]),
            "next_separation": d.next_recording.separation,
        }
    return row


def _correction_rows(d: Diagnosis) -> Iterator[dict[str, Any]]:
    """Every correction of every fault; a fault that nothing written would put right has a row without a key."""
    for fault in d.faults:
        row = {
            "specimen_id": d.specimen_id,
            "cause": fault.cause,
            "finding": fault.finding,
            "treatment": "left out" if fault.sets_aside else "put right",
            "left_per_value": finite_or_none(fault.left_per_value),
        }
        for recording_id in fault.recordings:
            own = [c for c in fault.corrections if c.recording_id == recording_id]
            for c in own:
                yield row | {
                    "recording_id": recording_id,
                    "cause": c.cause,
                    "key": c.key,
                    "value_now": c.value_now or None,
                    "value_proposed": c.value_proposed or None,
                    "probability": c.probability,
                }
            if not own:
                yield row | {"recording_id": recording_id, "probability": fault.probability}


def _smallest(d: Diagnosis) -> dict[str, dict[str, float]]:
    return {m: {k: float(v) for k, v in own.items() if np.isfinite(v)} for m, own in d.smallest_detectable.items()}


def _severity(extension: Extension) -> dict[str, dict[str, Any]]:
    """Mechanism → key → {value, sd}; with the channel where it is a sensor's, with the form where there are several."""
    found: dict[str, dict[str, Any]] = {}
    for mechanism, estimates in extension.severities.items():
        own: dict[str, Any] = {
            key: {k: finite_or_none(v) for k, v in asdict(e).items()} for key, e in estimates.items()
        }
        form = extension.variants.get(mechanism, "")
        listed = MECHANISMS[mechanism]
        if form and listed.stage == "sensor":
            own["channel"] = form.partition(",")[0]
        elif form and len(listed.variants) > 1:
            own["form"] = form
        found[mechanism] = own
    return found


def _fit_row(d: Diagnosis, extension: Extension) -> dict[str, Any]:
    """The extended model as a row of `model_fits`."""
    film, sd = extension.film, _named(extension.film, extension.film_sd)
    fitted = len(_film(film)) + sum(len(s) for s in extension.severities.values())
    row: dict[str, Any] = {
        "specimen_id": d.specimen_id,
        "loading": "joint",
        "method": "forward",
        "weighting": "noise",
        "model_order": film.order,
        "k0_n_per_mm": film.k0,
        "k0_n_per_mm_sd": sd.get("k0"),
        "extension": ",".join(extension.severities),
        "reduced_chi2": extension.chi2 / max(1, extension.size - fitted),
        "held_out_error": None if d.held_out is None else d.held_out.after,
        "selected": False,
        "warnings": "",
    }
    for i, (k, c, c_sd) in enumerate(zip(film.k, film.c, extension.damper_sd, strict=True), 1):
        row |= {
            f"k{i}_n_per_mm": k,
            f"k{i}_n_per_mm_sd": sd.get(f"k{i}"),
            f"c{i}_n_s_per_mm": c,
            f"c{i}_n_s_per_mm_sd": c_sd,
        }
    if film.c_inf > 0:
        row[f"c{film.order}_n_s_per_mm"] = film.c_inf
        row[f"c{film.order}_n_s_per_mm_sd"] = sd.get("c_inf")
    return row


def _named(film: RelaxationModel, values: Sequence[float]) -> dict[str, float]:
    """Values in the order k0, k…, tau…, c_inf by name."""
    n = len(film.k)
    names = ["k0", *(f"k{i}" for i in range(1, n + 1)), *(f"tau{i}" for i in range(1, n + 1)), "c_inf"]
    return dict(zip(names, values, strict=False))


def _parameters(d: Diagnosis) -> Iterator[dict[str, Any]]:
    """Each parameter of the film in the plain and in the extended model, and how far it moved."""
    extension = d.extension
    if extension is None:
        return
    plain, plain_sd = _film(extension.plain_film), _named(extension.plain_film, extension.plain_film_sd)
    film, film_sd = _film(extension.film), _named(extension.film, extension.film_sd)
    for name in _PARAMETERS:
        before, after, sd = plain.get(name), film.get(name), film_sd.get(name)
        if before is None and after is None:
            continue
        moved = None if before is None or after is None or not sd else abs(after - before) / sd
        yield {
            "specimen_id": d.specimen_id,
            "parameter": name,
            "unit": "s" if name.startswith("tau") else "N s/mm" if name == "c_inf" else "N/mm",
            "plain": before,
            "plain_sd": plain_sd.get(name),
            "extended": after,
            "extended_sd": sd,
            "moved_sd": moved,
        }


def _film(film: RelaxationModel) -> dict[str, float]:
    values = _named(film, (film.k0, *film.k, *film.tau, film.c_inf))
    if film.c_inf <= 0:
        values.pop("c_inf", None)
    return values
