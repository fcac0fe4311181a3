"""What the tables of a diagnosis say against each other: verdict, p-value, blocks, causes, sizes, headline.

Written from the contract's columns, for studies and tests; knows nothing of how a verdict is found.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa

from pipeline.diagnose.rules import RULES
from schemas.explanations import cause
from schemas.mechanisms import UNLISTED, candidate, nested
from schemas.places import SIGN, WITHIN, list_wrong

TABLES = ("diagnoses", "discrepancies", "diagnosis_candidates", "diagnosis_terms")
FAR = 1e-6
"""Probability of a place, by chance in any of them, from which `none` contradicts it."""
RESOLVED = 1e-12
"""Smallest share of anything that 64-bit numbers resolve after a computation."""


def read_specimen(database: Path, specimen: str) -> dict[str, pa.Table]:
    """The tables of one specimen's diagnosis from a published lab."""
    with duckdb.connect(str(database), read_only=True) as connection:
        asked = ((name, f"SELECT * FROM {name} WHERE specimen_id = ?") for name in TABLES)
        return {name: connection.execute(query, [specimen]).to_arrow_table() for name, query in asked}


def list_specimens(database: Path) -> list[str]:
    """Specimens of a published lab that have a verdict."""
    with duckdb.connect(str(database), read_only=True) as connection:
        query = "SELECT specimen_id FROM diagnoses WHERE verdict IS NOT NULL ORDER BY 1"
        return [str(row[0]) for row in connection.execute(query).fetchall()]


def find_contradictions(tables: Mapping[str, pa.Table], *, alone: bool) -> list[str]:
    """Contradictions in the tables that the diagnosis of one specimen is published as.

    Parameters
    ----------
    tables : by name, as `diagnosis_tables` and `comparison_tables` give them
    alone : whether the records were asked without a session

    Returns
    -------
    One sentence each
    """
    rows = {name: table.to_pylist() for name, table in tables.items()}
    (d,) = rows["diagnoses"]
    return [
        *_compare_verdict(d, alone=alone),
        *_compare_places(d, rows.get("discrepancies", [])),
        *(_compare_predictions(d, rows.get("diagnosis_candidates", [])) if alone else ()),
        *_compare_shares(d, rows.get("diagnosis_candidates", [])),
        *_compare_sizes(d, rows.get("diagnosis_candidates", [])),
        *_compare_terms(rows.get("diagnosis_terms", [])),
    ]


def _compare_verdict(d: Mapping[str, Any], *, alone: bool) -> Iterator[str]:
    verdict, named = d["verdict"], d["mechanisms"] or []
    level = RULES.adequacy.level if alone else RULES.alarm.mechanism_level
    found = verdict in ("named", "ambiguous")
    if found != (d["mechanism"] is not None) or (found and named[0] != d["mechanism"]):
        yield f"verdict {verdict} with mechanism {d['mechanism']} of {named}"
    if verdict in ("none", "unknown") and (named or d["also_possible"] or d["supported_by"]):
        yield f"verdict {verdict} beside {named}, {d['also_possible']}, {d['supported_by']}"
    if found and not cause(d):
        yield "a cause without words for the headline"
    if verdict == "none" and (nested(d["severity"]) or d["gain"] is not None or d["chi2_extended"] is not None):
        yield "verdict none with a severity, a gain or an extended model"
    if verdict == "ambiguous" and not d["also_possible"] and len(named) < 2:
        yield "ambiguous between one cause"
    if (verdict == "none") != (d["p_value"] >= level):
        yield f"verdict {verdict} with p = {d['p_value']:.2g} at a level of {level:g}"
    probabilities = json.loads(d["probabilities"] or "{}")
    if probabilities and abs(sum(probabilities.values()) - 1) > 1e-6:
        yield f"probabilities sum to {sum(probabilities.values())}"
    if verdict == "named" and probabilities and max(probabilities, key=probabilities.__getitem__) in ("plain",):
        yield "a cause is named and nothing is most probable"
    unseen = set(d["invisible"] or []) & ({*named, *(d["also_possible"] or [])} | set(nested(d["smallest_detectable"])))
    if unseen:
        yield f"invisible and yet asked for: {sorted(unseen)}"


def _compare_places(d: Mapping[str, Any], places: list[dict[str, Any]]) -> Iterator[str]:
    asked = [place for place in places if place["where_found"] != SIGN]
    wrong = list_wrong(places, d["verdict"])
    for place in wrong:
        if WITHIN in place["statement"]:
            yield f"listed as wrong: {place['statement']}"
    if d["verdict"] == "none" and wrong:
        yield f"verdict none beside {wrong[0]['statement']}"
    if d["verdict"] != "none":
        for place in asked:
            if place not in wrong and place["p_value"] * len(asked) < FAR:
                yield f"p = {place['p_value']:.1g} and not listed: {place['statement']}"
        return
    for place in places:
        if place["p_value"] is not None and place["p_value"] * len(places) < FAR:
            yield f"verdict none, and p = {place['p_value']:.1g} of {place['recording_id']}, {place['where_found']}"


def _compare_predictions(d: Mapping[str, Any], candidates: list[dict[str, Any]]) -> Iterator[str]:
    """What is told of a record that is asked alone has to gain for certain, and to leave little or noise, or else something in no list is
    possible too."""
    if d["verdict"] not in ("named", "ambiguous"):
        return
    possible = [d["mechanism"], *(d["also_possible"] or [])]
    for mechanism in possible:
        if mechanism == UNLISTED:
            continue
        own = [c for c in candidates if c["mechanism"] == mechanism]
        if not any((c["gain_lower"] or 0.0) > 0 for c in own):
            yield f"{mechanism} is possible, and gains nothing for certain"
    told = [c for c in candidates if c["mechanism"] == d["mechanism"] and (c["gain_lower"] or 0.0) > 0]
    enough = 1 - RULES.adequacy.left
    if d["gain_lower"] is not None and d["gain_lower"] <= 0:
        yield f"{d['mechanism']} is told with a gain from {d['gain_lower']:.3g}"
    if (
        told
        and UNLISTED not in possible
        and not any(c["explained"] is None or c["explained"] >= enough - 1e-9 for c in told)
    ):
        size, left = d["feature_count"], d["chi2_extended"]
        if left > size + RULES.gain.removable * math.sqrt(2 * size):
            yield f"{d['mechanism']} is told and leaves {1 - max(c['explained'] for c in told):.2f} of the misfit"


def _compare_shares(d: Mapping[str, Any], candidates: list[dict[str, Any]]) -> Iterator[str]:
    for what, row in (("diagnosis", d), *((c["mechanism"], c) for c in candidates)):
        gain, lower, upper = row["gain"], row["gain_lower"], row["gain_upper"]
        if gain is not None and lower is not None and not -1 <= lower <= gain <= upper <= 1:
            yield f"{what}: gain {gain:.4g} in {lower:.4g} to {upper:.4g}"
    for c in candidates:
        for name in ("explained", "probability"):
            if c[name] is not None and not -1e-9 <= c[name] <= 1 + 1e-9:
                yield f"{c['mechanism']}: {name} {c[name]:.4g}"
    before, after = d["held_out_error_before"], d["held_out_error_after"]
    if d["gain"] is not None and d["gain"] > 0 and after >= before:
        yield f"gain {d['gain']:.3g} with errors {before:.3g} and {after:.3g}"


def _compare_sizes(d: Mapping[str, Any], candidates: list[dict[str, Any]]) -> Iterator[str]:
    for mechanism, parameters in nested(d["severity"]).items():
        for key, size in parameters.items():
            if isinstance(size, dict) and None not in (size.get("lower"), size.get("upper"), size.get("value")):
                lower, value, upper = size["lower"], size["value"], size["upper"]
                slack = 1e-9 * max(abs(lower), abs(upper))
                if not lower - slack <= value <= upper + slack:
                    yield f"{mechanism}, {key}: {value:.4g} outside {lower:.4g} to {upper:.4g}"
    for c in candidates:
        words = candidate(c["mechanism"], c["severity"], c["severity_sd"], c.get("parameter"))
        spread = c["severity_sd"]
        if spread is not None and "±" in words and "%" in words and spread > max(abs(c["severity"]), 1.0):
            yield f"{c['mechanism']}: {words}"
    for mechanism, parameters in nested(d["smallest_detectable"]).items():
        for key, value in parameters.items():
            if not (math.isfinite(value) and abs(value) > RESOLVED):
                yield f"smallest detectable {mechanism}, {key}: {value}"


def _compare_terms(terms: list[dict[str, Any]]) -> Iterator[str]:
    for t in terms:
        if not t["lower_95"] <= t["term"] <= t["upper_95"]:
            yield f"{t['hypothesis']}: {t['term']:.4g} outside {t['lower_95']:.4g} to {t['upper_95']:.4g}"
