"""A recording's page: what is in it, what became of it, and where it came from."""

from __future__ import annotations

import numpy as np

from reports.blocks import (
    Block,
    Facts,
    Figure,
    Fold,
    Head,
    Link,
    Page,
    Piece,
    Section,
    Table,
    Text,
    bold,
    code,
    filled,
    flow,
    name,
    separated,
)
from reports.blocks import Row as TableRow
from reports.csvfile import Column
from reports.figures.recording import COLUMNS, Envelope, channels
from reports.figures.responses import Lines, spectrum
from reports.names import short, visible
from reports.pages import assumed, listing
from reports.pages.draft import Draft
from reports.pages.recording import calibrating
from reports.pages.specimen import distorted, relaxing
from reports.pages.specimen.film import over
from reports.results import Query, Row, moment
from reports.site import RECORDINGS, Site, flat_metadata
from reports.words import plain, protocol, remark
from schemas.numbers import ABSENT, NBSP, capital, compact, digits, seconds, significant, span, whole, with_unit
from schemas.quantities import QUANTITIES

_LONG = 300
"""Longer texts of the metadata are folded."""


def page(site: Site, recording: str) -> Page:
    """The page of one recording that was used at least in part, or taken out by somebody."""
    draft = Draft(site, "recording", recording)
    query = Query(
        "SELECT *\nFROM recordings\nWHERE recording_id = $recording AND status IN ('ok', 'damaged', 'excluded')",
        {"recording": recording},
    )
    row = site.results.rows(query)[0]
    lives = (
        []
        if not _has(draft, "lifetimes")
        else site.results.rows(
            Query(
                "SELECT * FROM lifetimes WHERE recording_id = $recording ORDER BY lifetime_s, specimen_id",
                {"recording": recording},
            )
        )
    )
    parts = [
        _samples(draft, row, lives),
        _life(draft, row, lives),
        _response(draft) if _has(draft, "frequency_responses") else None,
        relaxing.of_recording(draft, row),
        distorted.of_recording(draft) if _has(draft, "distortions") else None,
        _steps(draft) if _has(draft, "step_responses") else None,
        calibrating.of_recording(draft) if _has(draft, "calibrations") else None,
        _metadata(row),
    ]
    notes: list[Block | Fold] = [*assumed.blocks(site, "recording_id", recording)]
    excluded = listing.taken_out(site, "a.recording_id = $item", recording) if _has(draft, "annotations") else None
    if excluded:
        notes.append(excluded)
    return Page(
        title=short(recording, 60),
        heading=_heading(row, lives),
        bar=site.bar("../", f"Recording {short(recording, 24)}"),
        when=site.when(row["run_id"]),
        crumbs=_crumbs(site, row),
        lede=_lede(row, _missing(draft)),
        sub=_sub(site, row),
        opening=tuple(notes),
        sections=tuple(p for p in parts if p is not None),
        provenance=(
            Facts(
                (
                    ("File", code(row["source_path"] or ABSENT)),
                    ("SHA-256", code(row["source_sha256"] or ABSENT)),
                    ("Samples", code(row["samples_path"] or ABSENT)),
                    ("Source still there", ABSENT if row["source_present"] is None else "yes" if row["source_present"] else "no, its results are kept"),
                    ("Read by", f"dealab {row['software_version'] or 'of unknown version'}"),
                )
            ),
            *site.provenance(row["run_id"]),
            Text(flow("In SQL: ", code(f"SELECT * FROM recordings WHERE recording_id = '{recording}'")), "sub"),
        ),
        files=draft.files,
    )  # fmt: skip


def _has(draft: Draft, table: str) -> bool:
    return draft.results.has(table, "recording_id", draft.item)


def _crumbs(site: Site, row: Row) -> tuple[Link, ...]:
    crumbs = [Link("Last night", "../index.html")]
    if site.has_specimen(row["specimen_id"]):
        crumbs.append(Link(f"Specimen {short(row['specimen_id'], 40)}", "../" + site.specimen_path(row["specimen_id"])))
    else:
        crumbs.append(Link("Recordings", "../" + RECORDINGS))
    return (*crumbs, Link("Recording"))


def _heading(row: Row, lives: list[Row]) -> Piece:
    who = flow("Recording ", name(row["recording_id"], 60))
    if row["status"] == "excluded":
        return flow(who, ": taken out of the analysis")
    if len(lives) == 1 and lives[0]["lifetime_s"] is not None:
        at = f" at {with_unit(compact(lives[0]['voltage_kv']), 'kV')}" if lives[0]["voltage_kv"] else ""
        end = "breakdown after" if lives[0]["failed"] else "alive after"
        end = f"undecided, counted as {end}" if lives[0]["decided"] is False else end
        return flow(who, f": {end} {seconds(lives[0]['lifetime_s'])}{at}")
    if lives:
        failed = sum(bool(r["failed"]) for r in lives)
        return flow(who, f": {digits(len(lives), 'life', 'lives')}, {failed} of them ended by breakdown")
    state = ", used in part" if row["status"] == "damaged" else ""
    return flow(who, f": {_kind(row)} of {seconds(row['duration_s'])}{state}")


def _kind(row: Row) -> str:
    if row["kind"] and row["kind"] != "recording":
        return f"table of {plain(row['kind'])}"
    return protocol(row["protocol"], row["loading"])


def _missing(draft: Draft) -> str | None:
    """What was missing for any result; None where there is one."""
    query = Query(
        "SELECT what_was_missing FROM without_result WHERE recording_id = $recording AND status <> 'quarantined'",
        {"recording": draft.item},
    )
    found = draft.results.rows(query)
    return found[0]["what_was_missing"] if found else None


def _lede(row: Row, missing: str | None) -> Piece:
    if missing:
        return flow("No result: ", short(missing, 500))
    if row["problem"]:
        return flow(f"{'Damaged' if row['status'] == 'damaged' else 'Problem'}: ", short(row["problem"], 500))
    return flow("Worth knowing: ", short(row["notes"], 500)) if row["notes"] else ""


def _sub(site: Site, row: Row) -> Piece:
    parts: list[Piece] = [listing.status(row)]
    if row["specimen_id"]:
        parts.append(flow("specimen ", site.specimen(row["specimen_id"])))
    if row["campaign"]:
        parts.append(flow("campaign ", site.campaign(row["campaign"])))
    if row["rig_id"]:
        parts.append(flow("rig ", name(row["rig_id"])))
    if row["operator"]:
        parts.append(flow("measured by ", name(row["operator"])))
    parts.append(moment(row["started_at"]))
    if row["sample_count"]:
        parts.append(digits(row["sample_count"], "sample"))
    return separated(parts)


def envelopes(draft: Draft, recording: str, metadata: dict[str, object]) -> list[Envelope]:
    """The preview of each channel; quantities in the order of the protocol's table, unknown ones last."""
    data = draft.results.columns(
        Query(
            "SELECT quantity, time_s, low, high FROM previews WHERE recording_id = $recording ORDER BY quantity, time_s",
            {"recording": recording},
        )
    )
    if not data["time_s"].size:
        return []
    quantities = data["quantity"]
    starts = np.flatnonzero(np.concatenate([[True], quantities[1:] != quantities[:-1]]))
    ends = np.append(starts[1:], quantities.size)
    found = []
    for a, b in zip(starts.tolist(), ends.tolist(), strict=True):
        quantity = str(quantities[a])
        unit = QUANTITIES[quantity].unit if quantity in QUANTITIES else ""
        if unit == "any":
            unit = str(metadata.get(f"{quantity}_unit", ""))
        real = [data[c][a:b].astype(float) for c in ("time_s", "low", "high")]
        found.append(Envelope(quantity, visible(unit), *real))
    order = {name: i for i, name in enumerate(QUANTITIES)}
    return sorted(found, key=lambda e: (order.get(e.name, 99), e.name))


def _samples(draft: Draft, row: Row, lives: list[Row]) -> Section | None:
    shown = envelopes(draft, draft.item, flat_metadata(row["metadata"]))
    if not shown:
        return None
    thin = [e.merged() for e in shown]
    columns: dict[str, Column] = {
        "quantity": [e.name for e in thin for _ in e.time],
        "time_s": np.concatenate([e.time for e in thin]),
        "low": np.concatenate([e.low for e in thin]),
        "high": np.concatenate([e.high for e in thin]),
    }
    texts = []
    for e in shown:
        low, high = float(np.nanmin(e.low)), float(np.nanmax(e.high))
        texts.append(f"{plain(e.name)} {with_unit(span(low, high), e.unit if e.unit != '1' else '')}")
    marks = []
    if len(lives) == 1 and lives[0]["failed"] and lives[0]["lifetime_s"] is not None:
        marks = _breakdown_mark(shown, lives[0])
    figure = Figure(
        channels(shown, marks, alt=f"Channels of {short(draft.item, 60)} over {seconds(row['duration_s'])}: {'; '.join(texts)}."),
        flow(bold("Samples."), f" {capital('; '.join(texts))}. Shade: from the smallest to the largest value in each of up to {COLUMNS} intervals; a break is a gap in the data."),
        draft.data("samples", columns),
        wide="samples",
    )  # fmt: skip
    return Section("samples", f"{digits(len(shown), 'channel')}, {seconds(row['duration_s'])}", "Samples", (figure,))


def _breakdown_mark(shown: list[Envelope], life: Row) -> list[tuple[float, str]]:
    """The instant of breakdown: the life, counted from where the voltage first reaches 95 % of its level."""
    voltage = next((e for e in shown if e.name == "voltage"), None)
    level = life["voltage_kv"]
    if voltage is None or not level:
        return []
    reached = np.flatnonzero(voltage.high >= 0.95 * level)
    if not reached.size:
        return []
    time = float(voltage.time[reached[0]]) + float(life["lifetime_s"])
    return [(time, "breakdown")] if time <= float(voltage.time[-1]) * 1.02 else []


_LIFE_SQL = """SELECT specimen_id, configuration, voltage_kv, lifetime_s, failed, censored_because, failure_site, failure_region,
       breakdown_voltage_kv, decided, probability_failed, probability_switched_off, probability_supply, probability_monitor,
       evidence, warnings, recording_id
FROM lifetimes
WHERE recording_id = $recording
ORDER BY lifetime_s, specimen_id"""


def _life(draft: Draft, row: Row, lives: list[Row]) -> Section | None:
    if not lives:
        return None
    query = Query(_LIFE_SQL, {"recording": draft.item})
    table = listing.lifetimes(
        draft.site, lives, query, "Life" if len(lives) == 1 else f"The {len(lives)} lives of this table"
    )
    glitches = sum(r["glitches"] or 0 for r in lives)
    blocks: list[Block] = [table]
    blocks += [_causes(life) for life in lives if life["probability_failed"] is not None]
    if glitches:
        blocks.append(
            Text(
                f"{digits(glitches, 'collapse')} of the voltage recovered within 0.5{NBSP}s: no failure, but worth a look.",
                "sub",
            )
        )
    return Section("life", "Life under voltage", "Life", tuple(blocks))


def _causes(life: Row) -> Text:
    """Why the voltage fell in the end, and from what that is known."""
    causes = (("failed", "breakdown"), ("switched_off", "switched off"), ("supply", "supply"), ("monitor", "monitor"))
    shares = ", ".join(f"{words} {life[f'probability_{name}']:.2f}" for name, words in causes)
    return Text(f"Why the voltage fell: {shares}. {capital(life['evidence'])} (log odds for a breakdown).", "sub")


_RESPONSE_SQL = """SELECT stage, quantity, frequency_hz, "real", imag, magnitude, phase_deg, standard_error, coherence, amplification, usable
FROM frequency_responses
WHERE recording_id = $recording
ORDER BY stage, frequency_hz"""


def _response(draft: Draft) -> Section | None:
    query = Query(_RESPONSE_SQL, {"recording": draft.item})
    data = draft.results.columns(query)
    if not data["frequency_hz"].size:
        return None
    parts: dict[str, Lines] = {}
    for stage in dict.fromkeys(str(s) for s in data["stage"]):
        m = np.array([str(s) == stage for s in data["stage"]])
        value = data["real"][m].astype(float) + 1j * data["imag"][m].astype(float)
        usable = np.array([bool(u) for u in data["usable"][m]])
        parts[stage] = Lines(
            data["frequency_hz"][m].astype(float), value, data["standard_error"][m].astype(float), usable,
            data["amplification"][m].astype(float),
        )  # fmt: skip
    first = next(iter(parts.values()))
    unit = {"stiffness_n_per_mm": "N/mm", "force_per_voltage_squared_n_per_kv2": "N/kV²"}.get(
        str(data["quantity"][0]), "output per input"
    )
    counts = ", ".join(f"{stage}: {int(p.usable.sum())} of {p.size} lines usable" for stage, p in parts.items())
    blocks: list[Block | Fold] = []
    if first.size > 1:
        href = draft.data("response", data)
        image = spectrum(parts, unit, alt=f"Response of {short(draft.item, 60)} {over(first)}. {counts}.")
        blocks.append(Figure(image, flow(bold("Response."), f" {counts}. Bars: ±2 SD."), href))
        return Section("response", f"Response {over(first)}", "Response", tuple(blocks))
    rows = tuple(
        TableRow((stage, significant(p.frequency[0]), significant(abs(p.value[0])), significant(float(np.degrees(np.angle(p.value[0])))), significant(p.error[0], 2)))
        for stage, p in parts.items()
    )  # fmt: skip
    heads = (
        Head("Stage"),
        Head("Frequency, Hz", "n"),
        Head(f"Magnitude, {unit}", "n"),
        Head("Phase, °", "n"),
        Head("Standard error", "n"),
    )
    blocks.append(Table("Response at the frequency of the test", heads, rows, query.shown(), kind="narrow"))
    return Section("response", f"Response at {compact(first.frequency[0])}{NBSP}Hz", "Response", tuple(blocks))


_STEPS_SQL = """SELECT cycle, voltage_kv, force_step_n, capacitance_step_pf, capacitive_strain, force_instant_fraction,
       capacitance_instant_fraction, rise_time_s, overshoot_percent, settling_time_s, recovery_time_s, wrinkled, warnings
FROM step_responses
WHERE recording_id = $recording
ORDER BY cycle"""


def _steps(draft: Draft) -> Section | None:
    query = Query(_STEPS_SQL, {"recording": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    rows = tuple(
        TableRow(
            (
                str(r["cycle"]), compact(r["voltage_kv"]), significant(None if r["force_step_n"] is None else 1e3 * r["force_step_n"]),
                significant(r["capacitance_step_pf"]), significant(None if r["capacitive_strain"] is None else 100 * r["capacitive_strain"]),
                significant(r["rise_time_s"], 2), significant(r["settling_time_s"], 2), significant(r["recovery_time_s"], 2),
                "wrinkled" if r["wrinkled"] else "", remark(r["warnings"]),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Step"), Head("Voltage, kV", "n"), Head("Force, mN", "n"), Head("Capacitance, pF", "n"), Head("Strain, %", "n"), Head("Rise, s", "n"),
        Head("Settling, s", "n"), Head("Recovery, s", "n"), Head("Film"), Head("Worth knowing"),
    )  # fmt: skip
    return Section(
        "steps", digits(len(rows), "step"), "Steps", (Table("Each step", *filled(heads, rows), query.shown()),)
    )


def _metadata(row: Row) -> Section | None:
    found = flat_metadata(row["metadata"])
    if not found:
        return None
    pairs: list[tuple[Piece, Piece]] = []
    folded: list[Block | Fold] = []
    for key, value in sorted(found.items()):
        text = visible(", ".join(str(v) for v in value) if isinstance(value, list) else str(value))
        label = code(short(key, 60))
        if len(text) > _LONG:
            pairs.append((label, f"{text[:120].rstrip()}… ({whole(len(text))} characters, below)"))
            folded.append(Fold(flow("The whole text of ", label), (Text(text),)))
        else:
            pairs.append((label, text))
    return Section("metadata", "Metadata", "Metadata", (Facts(tuple(pairs)), *folded))
