"""The published diagnoses, for reading and for programs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pipeline.lab.lab import Lab
from pipeline.lab.reader import Reader
from schemas.alike import ask_meant
from schemas.corrections import write_corrections
from schemas.errors import UsageError
from schemas.explanations import (
    REMOVABLE,
    cause,
    has_unnamed_beside,
    list_explanations,
    tell_doubt,
    tell_no_gain,
)
from schemas.mechanisms import (
    UNLISTED,
    amount,
    candidate,
    main,
    nested,
    parameter_words,
    plain_name,
    severity,
)
from schemas.numbers import ABSENT, NBSP, THIN, capital, digits, p_equals, percent, pm, removed, significant
from schemas.places import list_negative, list_wrong
from schemas.visible import make_safe

_JSON_COLUMNS = ("severity", "smallest_detectable", "held_out_parts", "next_design")
_DETAILS = {
    "candidates": "diagnosis_candidates",
    "discrepancies": "discrepancies",
    "corrections": "corrections",
    "parameters": "diagnosis_parameters",
}
_SHOWN = 6
"""Discrepancies and causes that are printed, the strongest first."""
_MOVED = 2.0
_SIGNS = {"named": "●", "ambiguous": "◐", "unknown": "◇", "none": "○"}

Row = Mapping[str, Any]


def describe_diagnoses(lab: Lab, specimens: Sequence[str], *, as_json: bool) -> str:
    """The diagnoses of the given specimens, or of all, from the published database.

    Raises `LabError` without a database, `UsageError` for a specimen that the lab does not know.
    """
    lab.require_database()
    with Reader(lab.database) as reader:
        found = reader.rows("diagnoses")
        known = {row["specimen_id"] for row in reader.rows("recordings", ("specimen_id",))}
        for name in specimens:
            if name not in known:
                raise UsageError(
                    f'there is no specimen "{name[:80]}" in this lab{ask_meant(name, sorted(filter(None, known)))}',
                    remedy=lab.spell_command('sql "FROM specimens"') + " lists them",
                )
        names = [row["specimen_id"] for row in found if not specimens or row["specimen_id"] in specimens]
        details = {key: reader.rows(table, None, "specimen_id", names) for key, table in _DETAILS.items()}
    chosen = [
        {**row, **{key: _pick_specimen(rows, row["specimen_id"]) for key, rows in details.items()}}
        for row in found
        if row["specimen_id"] in names
    ]
    if as_json:
        return json.dumps([_parse_objects(row) for row in chosen], ensure_ascii=False, indent=1, default=str)
    missing = [name for name in specimens if name not in names]
    following = _list_next(lab, chosen)
    parts = ["\n".join(_describe_diagnosis(row, following[row["specimen_id"]])) for row in chosen]
    if missing or not chosen:
        parts.append("No diagnoses are published for " + (", ".join(missing) if missing else "this lab") + ".")
    return make_safe("\n\n".join(parts).replace(NBSP, " ").replace(THIN, " "))


def _list_next(lab: Lab, rows: Sequence[Row]) -> dict[str, tuple[str, list[str]]]:
    """What to do next about each specimen, as its page says it: a heading and sentences."""
    # Pages take long to import, and programs that ask for JSON need none of their words.
    from reports.evidence import Standing
    from reports.findings import list_next
    from reports.results import Results
    from reports.standings import of_lab

    with Results(lab.folder) as results:
        standings = {s.specimen_id: s for s in of_lab(results, [row["specimen_id"] for row in rows])}
    bare = {row["specimen_id"]: Standing(row["specimen_id"], None, None, None, dict(row)) for row in rows}
    return {name: list_next(standing) for name, standing in (bare | standings).items()}


def _pick_specimen(rows: Sequence[Row], specimen_id: str) -> list[dict[str, Any]]:
    return [{k: v for k, v in row.items() if k != "specimen_id"} for row in rows if row["specimen_id"] == specimen_id]


def _parse_objects(row: Row) -> dict[str, Any]:
    return {
        key: json.loads(value) if key in _JSON_COLUMNS and value is not None else value for key, value in row.items()
    }


def _describe_diagnosis(row: Row, following: tuple[str, list[str]]) -> Iterator[str]:
    """The finding first, then what carries it, then what to do, then what would have been seen.

    Parameters
    ----------
    row : of `diagnoses`, with what other tables say of it
    following : heading and sentences of what to do next
    """
    yield f"{_SIGNS.get(row['verdict'], '–')} {row['specimen_id']}: {describe_verdict(row)}"
    yield from _list_corrections(row)
    yield from _describe_gain(row)
    yield from _list_discrepancies(row)
    yield from _tabulate_causes(row)
    yield from _describe_film(row)
    if row["unexplained"]:
        yield from _list_under("What no cause explains", row["unexplained"])
    title, sentences = following
    if sentences:
        yield from _list_under(title, [str(sentence) for sentence in sentences])
    yield from _describe_visibility(row)
    if row["verdict"] is not None and row["could_not_ask"]:
        yield from _list_under("What could not be asked", row["could_not_ask"])


def _list_corrections(row: Row) -> Iterator[str]:
    """What would put the recordings right, as it would be written."""
    text = write_corrections(row["corrections"])
    if text:
        yield from _list_under("What would put it right, to be checked and accepted", text.splitlines())


def describe_verdict(row: Row) -> str:
    """What a diagnosis found, in a sentence."""
    verdict = row["verdict"]
    if verdict is None:
        reasons = "; ".join(row["could_not_ask"] or ("no reason given",))
        return f"could not be asked. {capital(reasons)}."
    text = cause(row)
    if verdict == "named":
        return f"{text} (named)."
    if verdict == "ambiguous":
        doubt = tell_doubt(row)
        return f"{text}{f'; these recordings {doubt}' if doubt else ''} (ambiguous)."
    if verdict == "unknown":
        return f"the simulation is wrong, {p_equals(row['p_value'])}, and no listed cause explains all of it (unknown)."
    return f"the simulation is right within the noise, {p_equals(row['p_value'])} (none)."


def _describe_gain(row: Row) -> Iterator[str]:
    before, after = row["held_out_error_before"], row["held_out_error_after"]
    if row["gain"] is None or before is None or after is None:
        return
    share = removed(row["gain"], row["gain_lower"], row["gain_upper"])
    if tell_no_gain(row):
        yield f"  {tell_no_gain(row)} Gain: {share} {REMOVABLE}."
        return
    yield f"  Mending it removes {share} {REMOVABLE} on data that the fit has not seen:"
    yield f"  {significant(before)} → {significant(after)} times the noise."
    parts = sorted(json.loads(row["held_out_parts"] or "{}").items(), key=lambda part: -part[1]["before"])
    if len(parts) > 1:
        shown = [f"{name} {significant(p['before'], 2)} → {significant(p['after'], 2)}" for name, p in parts[:_SHOWN]]
        more = [f"{len(parts) - _SHOWN} more"] if len(parts) > _SHOWN else []
        yield "  Left out and predicted: " + ", ".join(shown + more)


def _list_discrepancies(row: Row) -> Iterator[str]:
    negative = list_negative(row["discrepancies"])
    if negative:
        yield from _list_under(
            "What came out negative, as of no film",
            [f"{d['recording_id'] or 'all recordings'}: {d['statement']}" for d in negative],
        )
    clear = list_wrong(row["discrepancies"], row["verdict"])
    if not clear:
        return
    clear.sort(key=lambda d: (d["p_value"], -(d["chi2"] or 0.0) / (d["degrees_of_freedom"] or 1.0)))
    more = f"; {len(clear) - _SHOWN} more in the table discrepancies" if len(clear) > _SHOWN else ""
    yield from _list_under(
        f"What the simulation gets wrong ({digits(row['recordings'] or 0, 'recording')}{more})",
        [f"{d['recording_id'] or 'all recordings'}: {d['statement']}" for d in clear[:_SHOWN]],
    )


def _tabulate_causes(row: Row) -> Iterator[str]:
    if row["verdict"] in (None, "none") or not row["candidates"]:
        return
    alone = all(c["likelihood_ratio"] is None for c in row["candidates"])
    cells = _compare_predictions(row) if alone else _compare_explanations(row)
    widths = [max(len(line[i]) for line in cells) for i in range(4)]
    yield "  Causes, each alone in the model, refitted together with the rest of it"
    for name, *numbers, size in cells:
        columns = "  ".join(text.rjust(width) for text, width in zip(numbers, widths[1:], strict=True))
        yield f"    {name.ljust(widths[0])}  {columns}  {size}"
    for mechanism, parameters in nested(row["severity"]).items():
        yield f"  {plain_name(mechanism)} ({mechanism}): {severity(mechanism, parameters)}"
    if row["verdict"] == "ambiguous" and not has_unnamed_beside(row):
        possible = (
            " + ".join(plain_name(m) if m == UNLISTED else m for m in one) or "nothing but noise"
            for one in list_explanations(row)
        )
        yield f"  Cannot be told apart: {'; '.join(possible)}"
    if row["supported_by"]:
        yield f"  Shown by: {', '.join(row['supported_by'])}"


_Cells = list[tuple[str, str, str, str, str]]


def _compare_explanations(row: Row) -> _Cells:
    """The causes of a session, likeliest first."""
    ranked = sorted(row["candidates"], key=lambda c: (-(c["probability"] or 0.0), -(c["likelihood_ratio"] or 0.0)))
    return [
        ("", "2Δ ln L", "probability", "explains", "severity"),
        *(
            (
                f"{_mark(row, c)} {c['mechanism']}", significant(c["likelihood_ratio"]), percent(c["probability"]),
                percent(c["explained"]), candidate(c["mechanism"], c["severity"], c["severity_sd"], c["parameter"]),
            )
            for c in ranked[:_SHOWN]
        ),
    ]  # fmt: skip


def _compare_predictions(row: Row) -> _Cells:
    """The causes of a record that was asked alone, by their error on the part left out."""
    ranked = sorted(row["candidates"], key=lambda c: c["held_out_error"])
    return [
        ("", "gain", "95 % interval", "explains", "severity"),
        *(
            (
                f"{_mark(row, c)} {c['mechanism']}" + (f", {c['form']}" if c["form"] else ""), percent(c["gain"]),
                f"{percent(c['gain_lower'])} to {percent(c['gain_upper'])}",
                percent(c["explained"]), candidate(c["mechanism"], c["severity"], c["severity_sd"], c["parameter"]),
            )
            for c in ranked
        ),
    ]  # fmt: skip


def _mark(row: Row, cause: Row) -> str:
    return "●" if cause["mechanism"] in (row["mechanisms"] or ()) else " "


def _describe_film(row: Row) -> Iterator[str]:
    moved = [p for p in row["parameters"] if p["moved_sd"] is not None]
    if not moved:
        return
    most = max(p["moved_sd"] for p in moved)
    if most < _MOVED:
        yield f"  The film's parameters stay where they were, within {significant(most, 2)} SD."
        return
    yield from _list_under(
        "What ignoring it did to the film: plain → extended model",
        [
            f"{p['parameter']}: {pm(p['plain'], p['plain_sd'])} → {pm(p['extended'], p['extended_sd'], p['unit'])}, "
            f"moved by {significant(p['moved_sd'], 2)} SD"
            for p in moved
            if p["extended_sd"] < abs(p["extended"])
        ],
    )


def _describe_visibility(row: Row) -> Iterator[str]:
    smallest = nested(row["smallest_detectable"])
    if smallest:
        yield from _list_under(
            "Smallest that these recordings would have shown, with 80 % probability",
            [
                f"{mechanism}: "
                + ", ".join(
                    f"{amount(mechanism, k, v)} {parameter_words(mechanism, k)}"
                    for k, v in main(mechanism, own).items()
                )
                for mechanism, own in smallest.items()
                if own
            ],
        )
    if row["invisible"]:
        yield from _list_under("Cannot be seen in these recordings", [", ".join(row["invisible"])])


def _list_under(title: str, lines: Sequence[str]) -> list[str]:
    return [f"  {title}", *(f"    {line or ABSENT}" for line in lines)]
