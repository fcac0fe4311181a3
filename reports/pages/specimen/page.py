"""A specimen's page: finding, response, order, parameters, correction, voltage, steps, diagnosis, recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from reports import findings
from reports.blocks import Block, Link, Page, Piece, Section, Text, flow, name, separated, tag
from reports.evidence import Standing, measured
from reports.figures.curves import Rig, rig
from reports.names import short
from reports.owners import find_owners
from reports.pages import assumed, listing, requirement
from reports.pages.draft import Draft
from reports.pages.found import limits as find_limits
from reports.pages.recording import calibrating
from reports.pages.specimen import (
    controllers,
    correction,
    creeping,
    cycles,
    diagnosis,
    distorted,
    electrical,
    electrodes,
    film,
    force,
    ladder,
    lifting,
    loops,
    models,
    permittivity,
    pulls,
    relaxing,
    slow_voltage,
    stepping,
    strains,
    temperatures,
    unused,
    voltage_orders,
)
from reports.results import Query, Row, days
from reports.site import SPECIMENS, Site, flat_metadata
from reports.standings import find_negative, find_tapped, stand
from schemas.numbers import NBSP, capital, compact, counted, digits, joined, seconds, with_unit
from schemas.views import WHY_NO_MODEL


def page(site: Site, specimen: str) -> Page:
    """The page of one specimen."""
    draft = Draft(site, "specimen", specimen)
    results = site.results
    query = Query(
        "SELECT recording_id, campaign, material, configuration, protocol, loading, rig_id, started_at, duration_s, status,\n"
        "       problem, notes, source_path, source_sha256, metadata, run_id\nFROM recordings\n"
        "WHERE specimen_id = $specimen\nORDER BY started_at, recording_id, source_path",
        {"specimen": specimen},
    )
    recordings = results.rows(query)
    fits, found = [], []
    if results.has("model_fits", "specimen_id", specimen):
        fits = results.rows(
            Query(
                "SELECT * FROM model_fits WHERE specimen_id = $specimen ORDER BY loading, method, extension, model_order",
                {"specimen": specimen},
            )
        )
    if results.has("diagnoses", "specimen_id", specimen):
        found = results.rows(Query("SELECT * FROM diagnoses WHERE specimen_id = $specimen", {"specimen": specimen}))
    used = [r for r in recordings if r["status"] in ("ok", "damaged", "excluded")]
    metadata = flat_metadata(used[-1]["metadata"]) if used else {}
    row = found[0] if found else None
    own = Query("specimen_id = $specimen", {"specimen": specimen})

    def holds(table: str) -> bool:
        """Whether a table has rows of the specimen."""
        return results.has(table, "specimen_id", specimen)

    standing = stand(
        specimen,
        used,
        fits,
        row,
        negative=find_negative(results, own).get(specimen, "") if holds("discrepancies") else "",
        taps=holds("diagnosis_blocks") and specimen in find_tapped(results, own),
        owner=find_owners(results, own).get(specimen, "") if holds("corrections") else "",
    )
    failed = results.rows(
        Query(
            "SELECT split_part(error, chr(10), 1) AS error FROM items WHERE item_id = $item AND outcome = 'failed'",
            {"item": f"specimen:{specimen}"},
        )
    )
    opening: list[Block] = [
        Text(flow(tag("quarantined", "failed"), " ", short(r["error"] or "", 400), ". Shown is what there is."), "")
        for r in failed
    ]
    unchosen = models.without_model(fits) if standing.fit is None else None
    if unchosen is not None:
        opening.append(unchosen)
    elif standing.fit is None and not failed:
        opening += _why_no_model(draft)
    following = findings.what_next(standing)
    if following is not None:
        opening.insert(0, following)
    sections = _sections(draft, standing, fits, recordings)
    shown_list = listing.recordings(
        site, recordings, query, f"Recordings of {short(specimen, 40)}", note=_status_note(recordings)
    )
    blocks = [shown_list]
    annotated = any(results.has("annotations", "recording_id", r["recording_id"]) for r in used)
    excluded = listing.taken_out(site, "r.specimen_id = $item", specimen) if annotated else None
    if excluded:
        blocks.append(excluded)
    sections.append(Section("recordings", _recordings_heading(recordings), "Recordings", tuple(blocks)))
    run_id = _run(site, specimen, used)
    campaigns = list(dict.fromkeys(r["campaign"] for r in used if r["campaign"]))
    crumbs = [Link("Specimens", "../" + SPECIMENS)]
    if campaigns:
        crumbs = [Link(f"Campaign {short(campaigns[0], 40)}", "../" + site.campaign_path(campaigns[0])), *crumbs]
    headline = findings.headline(standing)
    curve = temperatures.headline(draft) if not standing.diagnosis and not standing.negative else ""
    if curve:
        headline = flow("Specimen ", name(specimen), f": {curve}")
    lede = findings.lede(standing)
    if not (standing.fit or standing.diagnosis or standing.negative):
        headline = flow("Specimen ", name(specimen), ": ", _life_or_count(draft, used, sections))
    limits = joined([limit.words for limit in find_limits(results, specimen=specimen)])
    if limits and (standing.alarm or standing.negative):
        lede = flow(lede, " " if lede else "", f"{capital(limits)}.")
    elif limits:  # what bounds the use of a film comes before what it is
        headline, lede = (
            flow("Specimen ", name(specimen), f": {limits}"),
            lede or flow(capital(_life_or_count(draft, used, sections)), "."),
        )
    return Page(
        title=f"{short(specimen, 40)}: {_title(standing, used)}",
        heading=headline,
        bar=site.bar("../", f"Specimen {short(specimen, 24)}"),
        when=site.when(run_id),
        crumbs=(Link("Last night", "../index.html"), *crumbs, Link("Specimen")),
        lede=lede,
        sub=_sub(standing, used, metadata),
        opening=(*(Text(r) for r in findings.remarks(standing) if standing.alarm and not standing.diagnosis), *opening, *assumed.blocks(site, "specimen_id", specimen)),
        sections=tuple(sections),
        provenance=(*site.provenance(run_id), listing.files(used, f"{capital(digits(len(used), 'recording'))}: files and SHA-256")),
        files=draft.files,
    )  # fmt: skip


def _sections(draft: Draft, standing: Standing, fits: list[Row], recordings: list[Row]) -> list[Section]:
    chosen = standing.fit
    names = [r["recording_id"] for r in recordings if r["recording_id"]]

    def has(table: str) -> bool:
        return draft.results.has(table, "specimen_id", draft.item)

    def recorded(table: str) -> bool:
        return any(draft.results.has(table, "recording_id", name) for name in names)

    candidates: list[Section | None] = [temperatures.section(draft)] if has("master_curves") else []
    if has("frequency_responses"):
        constants: Rig | None = rig(chosen or {}, standing.stated)
        damaged = {r["recording_id"] for r in recordings if r["status"] == "damaged"}
        mechanical = measured(draft.results, draft.item, "mechanical")
        if has("master_curves"):  # single temperatures are no record of the curve that the models describe
            mechanical = replace(mechanical, by_recording={})
        candidates.append(film.response(draft, fits, chosen, mechanical, standing.stated, alarm=standing.alarm))
        if chosen:
            candidates += [models.order(draft, fits, chosen), models.parameters(draft, standing, chosen)]
            candidates.append(models.weightings(draft))
        if has("amplitude_fits"):
            candidates.append(strains.section(draft))
        candidates.append(correction.section(draft, chosen, mechanical, constants, damaged))
        candidates.append(relaxing.of_specimen(draft, recordings, chosen))
        voltage = measured(draft.results, draft.item, "electrical")
        candidates.append(electrical.response(draft, fits, chosen, voltage, constants))
        if has("voltage_orders"):
            candidates.append(voltage_orders.section(draft))
        if has("permittivities"):
            candidates.append(permittivity.section(draft))
        candidates.append(unused.section(draft))
    elif not recorded("cycle_fits") or not chosen or chosen["method"] != "time_domain":
        candidates.append(relaxing.of_specimen(draft, recordings, chosen))
        if chosen:
            candidates += [models.order(draft, fits, chosen), models.parameters(draft, standing, chosen)]
    if recorded("cycle_fits"):
        candidates.append(cycles.of_specimen(draft))
    if recorded("cycle_loops"):
        candidates.append(cycles.loops_of_specimen(draft))
    if recorded("creep_tests"):
        candidates.append(creeping.of_specimen(draft))
    if recorded("isotonic_tests"):
        candidates.append(lifting.of_specimen(draft))
    if recorded("voltage_cycles"):
        candidates.append(slow_voltage.of_specimen(draft))
    if recorded("pull_tests"):
        candidates.append(pulls.of_specimen(draft))
    if has("order_ladders"):
        candidates.append(ladder.section(draft))
    if has("predictions"):
        candidates.append(electrical.predictions(draft))
    if recorded("distortions"):
        candidates.append(distorted.of_specimen(draft))
    if recorded("step_responses"):
        candidates += [stepping.steps(draft), stepping.sensing(draft)]
    if recorded("loop_responses"):
        candidates.append(loops.section(draft))
    if has("controller_designs"):
        candidates.append(controllers.section(draft))
    if has("electrode_coats"):
        candidates.append(electrodes.coverage(draft))
    if has("electrode_migrations"):
        candidates.append(electrodes.migration(draft))
    if recorded("calibrations"):
        candidates.append(calibrating.of_specimen(draft))
    if has("specifications"):
        candidates.append(requirement.of_specimen(draft))
    if has("force_maps"):
        candidates.append(force.section(draft, "specimen_id = $item", draft.item))
    if has("lifetimes"):
        candidates.append(_life(draft))
    if standing.diagnosis or standing.unasked:
        candidates.append(diagnosis.section(draft, standing))
    return [s for s in candidates if s is not None]


def _title(standing: Standing, used: list[Row]) -> str:
    if standing.diagnosis and standing.verdict:
        return standing.verdict
    return f"{standing.fit['model_order']} relaxations" if standing.fit else digits(len(used), "recording")


def _why_no_model(draft: Draft) -> list[Text]:
    """What the fits of a specimen without a model lacked; nothing where none was tried."""
    query = f"SELECT {WHY_NO_MODEL} AS reason FROM items WHERE item_id = $item AND {WHY_NO_MODEL} <> ''"
    rows = draft.results.rows(Query(query, {"item": f"specimen:{draft.item}"}))
    return [Text(flow("No model: ", short(row["reason"], 300), "."), "") for row in rows]


_FINDINGS = ("isotonic", "slow-voltage", "creep", "pull", "loops")
"""Sections whose heading is what a specimen without a model shows."""


def _life_or_count(draft: Draft, used: list[Row], sections: Sequence[Section]) -> Piece:
    lives = draft.results.rows(
        Query("SELECT * FROM lifetimes WHERE specimen_id = $item ORDER BY lifetime_s", {"item": draft.item})
    )
    if lives and lives[0]["lifetime_s"] is not None:
        life = lives[0]
        at = f" at {with_unit(compact(life['voltage_kv']), 'kV')}" if life["voltage_kv"] else ""
        end = "broke down after" if life["failed"] else "lived through"
        end = f"undecided, counted as {end}" if life["decided"] is False else end
        return f"{end} {seconds(life['lifetime_s'])}{at}"
    shown = next((s.heading for s in sections if s.id in _FINDINGS), "")
    return _without_model(draft, used) or shown or f"{counted(len(used), 'recording')}, no model fitted"


def _without_model(draft: Draft, used: list[Row]) -> str:
    """What a specimen without a model shows: static force, self-sensing, steps, or the calibration of its rig."""
    item = {"item": draft.item}
    has = draft.results.has
    if has("force_maps", "specimen_id", draft.item):
        rows = draft.results.rows(Query("SELECT * FROM force_maps WHERE specimen_id = $item ORDER BY ALL", item))
        fits = draft.results.rows(Query("SELECT * FROM force_map_fits WHERE specimen_id = $item ORDER BY ALL", item))
        return force.finding(rows, fits)
    if has("sensing_fits", "specimen_id", draft.item):
        return stepping.sensing_finding(draft)
    if any(has("step_responses", "recording_id", r["recording_id"]) for r in used):
        return stepping.steps_finding(draft)
    return calibrating.finding(calibrating.load(draft)) if any(r["loading"] == "calibration" for r in used) else ""


_LIFE_SQL = """SELECT specimen_id, configuration, voltage_kv, lifetime_s, failed, censored_because, failure_site, failure_region,
       breakdown_voltage_kv, decided, probability_failed, warnings, recording_id
FROM lifetimes
WHERE specimen_id = $specimen
ORDER BY lifetime_s, recording_id"""


def _life(draft: Draft) -> Section | None:
    query = Query(_LIFE_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    return Section("life", "Life under voltage", "Life", (listing.lifetimes(draft.site, found, query, "Lifetimes"),))


def _sub(standing: Standing, used: list[Row], metadata: dict[str, object]) -> Piece:
    parts: list[Piece] = []
    if standing.verdict:
        parts.append(tag(standing.verdict))
    if standing.material:
        parts.append(name(standing.material))
    if standing.configuration:
        parts.append(name(standing.configuration))
    size = [metadata.get(f"film_{d}_mm") for d in ("length", "width", "thickness")]
    if all(size):
        parts.append(f"{NBSP}×{NBSP}".join(short(str(s), 10) for s in size) + f"{NBSP}mm undeformed")
    if metadata.get("stretch_1"):
        across = f" × {short(str(metadata['stretch_2']), 10)}" if metadata.get("stretch_2") else ", uniaxial"
        parts.append(f"stretch {short(str(metadata['stretch_1']), 10)}{across}")
    rigs = sorted({r["rig_id"] for r in used if r["rig_id"]})
    if rigs:
        parts.append(flow("rig ", Text(short(", ".join(rigs), 40)).body))
    times = [r["started_at"] for r in used if r["started_at"]]
    if times:
        parts.append(f"{digits(len(used), 'recording')}, {days(min(times), max(times))}")
    return separated(parts)


def _status_note(recordings: list[Row]) -> str:
    counts = {
        s: sum(r["status"] == s for r in recordings)
        for s in ("ok", "damaged", "quarantined", "excluded", "duplicate", "pending")
    }
    words = {"quarantined": "refused", "ok": "whole"}
    return ", ".join(f"{n} {words.get(s, s)}" for s, n in counts.items() if n)


def _recordings_heading(recordings: list[Row]) -> str:
    bad = sum(r["status"] in ("quarantined", "damaged") for r in recordings)
    heading = f"{digits(len(recordings), 'recording')}"
    return (
        heading
        + (f", {bad} of them refused or damaged" if bad else ", all whole" if len(recordings) > 1 else ", whole")
        if recordings
        else "No recordings"
    )


def _run(site: Site, specimen: str, used: list[Row]) -> str | None:
    """The run that made the specimen's results; where that is not kept, the last in which a recording of it came in."""
    made = site.results.rows(Query("SELECT run_id FROM items WHERE item_id = $item", {"item": f"specimen:{specimen}"}))
    if made and made[0]["run_id"]:
        return str(made[0]["run_id"])
    runs = [r["run_id"] for r in used if r["run_id"]]
    order = {r["run_id"]: i for i, r in enumerate(site.runs)}
    return max(runs, key=lambda r: order.get(r, -1), default=None)
