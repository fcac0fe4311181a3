"""The part of a specimen's page that says what the simulation gets wrong, why, and what mending it gains."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from reports.blocks import (
    Block,
    Figure,
    Fold,
    Head,
    Heading,
    Pair,
    Piece,
    Pre,
    Row,
    Section,
    Table,
    Text,
    bar,
    bold,
    code,
    equation,
    flow,
    sub,
)
from reports.evidence import Standing, plain_beyond_noise
from reports.features import COLUMNS, kind_of
from reports.figures import diagnosis as figures
from reports.findings import LISTED_CAUSES, evidence, gain, what_is_wrong
from reports.names import Verbatim, short, visible
from reports.pages.draft import Draft
from reports.pages.specimen import comparing_models, explanations, shifts, unnamed
from reports.results import Query
from reports.results import Row as Record
from reports.words import remark
from schemas.corrections import write_corrections
from schemas.explanations import REMOVABLE, tell_doubt
from schemas.mechanisms import amount, candidate, main, nested, parameter_words, plain_name
from schemas.mechanisms import severity as severity_words
from schemas.numbers import (
    ABSENT,
    capital,
    compact,
    digits,
    gained,
    never_negative,
    p_value,
    probability,
    significant,
    whole,
)
from schemas.places import list_negative, list_wrong

_WORST, _ROWS = 6, 40
_MAPPED = 32
_OPEN_ROWS = 8
"""Rows up to which what would have been seen stands open below a finding about something else."""
_PARTS = 13
"""Parts left out that are drawn, all of them together first; the others are in the figure's data."""


def section(draft: Draft, standing: Standing) -> Section | None:
    """The whole diagnosis; the reasons where none could be made; None where none was asked for."""
    d = standing.diagnosis
    if d is None:
        if not standing.unasked:
            return None
        reasons = tuple(Text(_sentence(capital(reason))) for reason in standing.unasked)
        return Section("diagnosis", "Diagnosis: these recordings could not be asked", "Diagnosis", reasons)
    blocks: list[Block | Fold] = [Text(piece) for piece in evidence(standing)]
    blocks += _faults(draft)
    blocks += _wrong(draft, d)
    blocks += comparing_models.blocks(draft, d)
    blocks += explanations.blocks(draft, d)
    blocks += unnamed.blocks(draft, d)
    blocks += _candidates(draft, d)
    blocks += _gain(draft, d)
    blocks += _film(draft, standing, d)
    blocks += _visible(draft, d)
    return Section("diagnosis", _heading(d, standing), "Diagnosis", tuple(blocks))


def _heading(d: Record, standing: Standing) -> str:
    if d["verdict"] in ("named", "ambiguous") and tell_doubt(d) != "cannot tell which":
        return f"Diagnosis: {what_is_wrong(standing)}"
    return {
        "ambiguous": "Diagnosis: more than one explanation fits",
        "unknown": "Diagnosis: the simulation is wrong, and no listed cause explains all of it",
    }.get(d["verdict"], "Diagnosis: the simulation is right within the noise")


_CORRECTIONS_SQL = """SELECT recording_id, cause, key, value_now, value_proposed, probability, finding, treatment, left_per_value
FROM corrections
WHERE specimen_id = $specimen
ORDER BY recording_id, probability DESC, cause, key"""


def _faults(draft: Draft) -> list[Block | Fold]:
    """Faults of recordings, what would put them right, and that as it would be written."""
    query = Query(_CORRECTIONS_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return []
    heads = (
        Head("Recording"), Head("Fault"), Head("What shows it", "text"), Head("Key"), Head("Now", "n"), Head("Proposed", "n"),
        Head("Probability", "n"), Head("χ² per value, put right", "n"), Head("Here"),
    )  # fmt: skip
    rows = [
        Row(
            (
                draft.site.recording(r["recording_id"]), flow(plain_name(r["cause"]), Markup("<br>"), code(r["cause"])),
                remark(r["finding"]), ABSENT if r["key"] is None else code(r["key"]), visible(r["value_now"] or ABSENT),
                visible(r["value_proposed"] or ABSENT), probability(r["probability"]),
                ABSENT if r["left_per_value"] is None else significant(r["left_per_value"], 3), r["treatment"],
            )
        )
        for r in found
    ]  # fmt: skip
    note = "each recording against the others and against its own metadata, before any mechanism is asked"
    blocks: list[Block | Fold] = [
        Heading("Recordings first: what is wrong with them"),
        Table("Faults, and what would put them right", heads, tuple(rows[:_ROWS]), query.shown(), note),
    ]
    text = write_corrections(found)
    if text:
        blocks.append(Fold("The most probable corrections as TOML, to be checked and accepted", (Pre(Verbatim(text)),)))
    return blocks


_DISCREPANCY_SQL = """SELECT recording_id, where_found, chi2, degrees_of_freedom, p_value, statement
FROM discrepancies
WHERE specimen_id = $specimen
ORDER BY p_value, chi2 / degrees_of_freedom DESC, recording_id, where_found, statement"""
_BLOCK_SQL = """SELECT recording_id, kind, block, feature_count, plain_rms, extended_rms
FROM diagnosis_blocks
WHERE specimen_id = $specimen
ORDER BY recording_id, position"""


def _wrong(draft: Draft, d: Record) -> list[Block | Fold]:
    """Residuals by recording and kind, before and after; the worst places in words."""
    maps = [*_maps(draft, d), *_frequency_maps(draft)]
    query = Query(_DISCREPANCY_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    worst = [*list_negative(found), *list_wrong(found, d["verdict"])]
    if not maps and not worst:
        return []
    blocks: list[Block | Fold] = [Heading("What the simulation gets wrong"), *maps]
    if worst:
        heads = (Head("Recording"), Head("What", "text"), Head("χ²", "n"), Head("d.f.", "n"), Head("p", "n"))
        rows = [
            Row(
                (
                    draft.site.recording(r["recording_id"]), remark(r["statement"] or r["where_found"]),
                    significant(r["chi2"]), compact(r["degrees_of_freedom"]), p_value(r["p_value"]),
                )
            )
            for r in worst[:_ROWS]
        ]  # fmt: skip
        note = f"{len(worst)} of {digits(len(found), 'place')} beyond what the noise makes of one of them in a hundred, the worst first"
        blocks.append(Table("Where it is wrong", heads, tuple(rows[:_WORST]), query.shown(), note))
        if len(rows) > _WORST:
            more = Table("Where else", heads, tuple(rows[_WORST:]))
            left = len(worst) - len(rows)
            cut = f"; {whole(left)} more in the table discrepancies" if left else ""
            blocks.append(Fold(f"The next {digits(len(rows) - _WORST, 'place')}{cut}", (more,)))
    return blocks


_COLUMN_WORDS = {"rest": "the levels at rest", "left out": "what the fit left out"}
"""Columns of the map whose names are no nouns within a sentence."""


def _maps(draft: Draft, d: Record) -> list[Block]:
    query = Query(_BLOCK_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return []
    after = all(r["extended_rms"] is not None for r in found)
    recordings = list(dict.fromkeys(r["recording_id"] for r in found))
    present = {kind_of(r["kind"]).column for r in found}
    columns = [c for c in COLUMNS if c in present] + sorted(present - set(COLUMNS))
    maps = {name: _rms(found, recordings, columns, name) for name in ("plain_rms", "extended_rms")}
    if len(recordings) > _MAPPED:
        worst = np.sort(np.argsort(-np.nanmax(maps["plain_rms"], axis=1), kind="stable")[:_MAPPED])
        recordings = [recordings[i] for i in worst]
        maps = {name: values[worst] for name, values in maps.items()}
    common = _common_start(recordings)
    names = [r.removeprefix(common) or r for r in recordings]
    data = draft.data("diagnosis_blocks", {n: [r[n] for r in found] for n in found[0]})
    count = sum(r["feature_count"] for r in found)
    pictures = []
    for column, title, chi2 in (
        ("plain_rms", "Plain model", d["chi2"]),
        ("extended_rms", "Extended model", d["chi2_extended"]),
    ):
        if column == "extended_rms" and not after:
            continue
        total = f" χ² {significant(chi2)} for {whole(count)} values." if chi2 is not None else ""
        i, j = np.unravel_index(int(np.nanargmax(maps[column])), maps[column].shape)
        peak = (
            f"The {title.lower()} is farthest off in {_COLUMN_WORDS.get(columns[j], f'the {columns[j]}')} of"
            f" {short(names[i], 40)}, by"
            f" {significant(float(maps[column][i, j]), 2)} times the noise."
        )
        image = figures.residual_map(
            maps[column], names, columns, f"{title}: residual, SD of the noise",
            alt=f"{title}: root mean square residual by recording and quantity. {peak}",
        )  # fmt: skip
        pictures.append(
            Figure(image, flow(bold(f"{title}."), f"{total} {peak} 1 is noise alone; dot: not measured."), data)
        )
    return [Pair(tuple(pictures))] if len(pictures) > 1 else list(pictures)


_FREQUENCY_SQL = """SELECT recording_id, frequency_hz, measured, plain, extended, sd
FROM diagnosis_curves
WHERE specimen_id = $specimen AND frequency_hz > 0 AND sd > 0 AND measured IS NOT NULL AND plain IS NOT NULL
ORDER BY recording_id, frequency_hz"""
_BANDS = tuple(m * 10.0**e for e in range(-3, 5) for m in (1, 2, 5))
"""Edges of the bands of frequency in which residuals are gathered, Hz."""
_FEWEST_BANDS = 3


def _frequency_maps(draft: Draft) -> list[Block]:
    """Residuals by recording and band of frequency: where on the axis that the resonance lies on the simulation is wrong."""
    data = draft.results.columns(Query(_FREQUENCY_SQL, {"specimen": draft.item}))
    if not data["frequency_hz"].size:
        return []
    edges = np.array(_BANDS)
    place = np.clip(np.searchsorted(edges, data["frequency_hz"].astype(float), side="right") - 1, 0, edges.size - 2)
    bands = np.unique(place)
    recordings = list(dict.fromkeys(str(r) for r in data["recording_id"]))
    if bands.size < _FEWEST_BANDS:
        return []
    row = np.array([recordings.index(str(r)) for r in data["recording_id"]])
    column = np.searchsorted(bands, place)
    names = [f"{compact(float(edges[b]))}–{compact(float(edges[b + 1]))}" for b in bands]
    common = _common_start(recordings)
    pictures, kept = [], {}
    for model, title in (("plain", "Plain model"), ("extended", "Extended model")):
        off = (data["measured"].astype(float) - data[model].astype(float)) / data["sd"].astype(float)
        if not np.isfinite(off).all():
            continue
        total, count = np.zeros((2, len(recordings), bands.size))
        np.add.at(total, (row, column), off**2)
        np.add.at(count, (row, column), 1)
        rms = np.sqrt(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))
        worst = np.sort(np.argsort(-np.nanmax(rms, axis=1), kind="stable")[:_MAPPED])
        i, j = np.unravel_index(int(np.nanargmax(rms)), rms.shape)
        peak = (
            f"The {title.lower()} is farthest off from {names[j]} Hz in {short(recordings[i], 40)}, by"
            f" {significant(float(rms[i, j]), 2)} times the noise."
        )
        shown = [recordings[k].removeprefix(common) or recordings[k] for k in worst]
        kept[model] = rms
        image = figures.residual_map(
            rms[worst], shown, names, f"{title} over frequency, Hz: residual, SD",
            alt=f"{title}: root mean square residual by recording and band of frequency. {peak}",
        )  # fmt: skip
        pictures.append((image, title, peak))
    grid = [(r, n) for r in recordings for n in names]
    columns = {"recording_id": [r for r, _ in grid], "band_hz": [n for _, n in grid]}
    href = draft.data("diagnosis_bands", columns | {f"{m}_rms": v.ravel() for m, v in kept.items()})
    drawn = tuple(
        Figure(image, flow(bold(f"{title} over frequency."), f" {peak} Of the {whole(row.size)} values kept."), href)
        for image, title, peak in pictures
    )
    return [Pair(drawn)] if len(drawn) > 1 else list(drawn)


def _rms(found: list[Record], recordings: list[str], columns: list[str], name: str) -> np.ndarray:
    """(recordings, columns) root mean square residual, pooled over the blocks of a recording."""
    total, count = np.zeros((2, len(recordings), len(columns)))
    row, column = ({n: i for i, n in enumerate(names)} for names in (recordings, columns))
    for r in found:
        if r[name] is not None:
            at = row[r["recording_id"]], column[kind_of(r["kind"]).column]
            total[at] += r["feature_count"] * r[name] ** 2
            count[at] += r["feature_count"]
    return np.asarray(np.sqrt(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)))


def _common_start(names: list[str]) -> str:
    """What all recordings of the specimen begin with, up to a separator."""
    if len(names) < 2:
        return ""
    first, last = min(names), max(names)
    n = next((i for i, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), min(len(first), len(last)))
    cut = max(first[:n].rfind(c) for c in "_-. ")
    return first[: cut + 1]


_CANDIDATES_SQL = """SELECT mechanism, gain_lower, gain_upper, held_out_error, likelihood_ratio, probability, explained,
       parameter, severity, severity_sd, gain, form, equation
FROM diagnosis_candidates
WHERE specimen_id = $specimen
ORDER BY probability DESC, likelihood_ratio DESC, held_out_error, mechanism, form"""


def _candidates(draft: Draft, d: Record) -> list[Block]:
    query = Query(_CANDIDATES_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found or d["verdict"] == "none":
        return []
    if all(r["likelihood_ratio"] is None for r in found):
        return _places(d, found, query)
    rows = []
    for r in found:
        chosen = r["mechanism"] in (d["mechanisms"] or [])
        silent = chosen and not r["likelihood_ratio"]
        share: Piece = ABSENT if r["explained"] is None or silent else bar(r["explained"], chosen=chosen)
        rows.append(
            Row(
                (
                    flow(plain_name(r["mechanism"]), Markup("<br>"), code(r["mechanism"])),
                    probability(r["probability"]), ABSENT if silent else significant(r["likelihood_ratio"]), share, candidate(r["mechanism"], r["severity"], r["severity_sd"], r["parameter"]),
                ),
                "sel" if chosen else "dim",
            )
        )  # fmt: skip
    heads = (
        Head("Cause"), Head("Probability", "n"), Head("Fall of χ²", "n"),
        Head("Share of the misfit explained", "barcell"), Head("Severity"),
    )  # fmt: skip
    note = f"the {len(found)} of {LISTED_CAUSES} that {'was' if len(found) == 1 else 'were'} fitted"
    below = (
        "Probability: of this cause alone, among all explanations. Fall of χ²: in the search, under weights that allow every form a"
        " share of what is missed; it does not decide. Severity: of what is told, that of the extended model, whose ± also holds how far its form"
        " may be wrong; of the others alone, with the ± of the noise."
    )
    if any(r["mechanism"] in (d["mechanisms"] or []) and not r["likelihood_ratio"] for r in found):
        below += " –: under those weights the cause alone does not fall below the plain model, and shows nothing of its share."
    blocks: list[Block] = [
        Heading("The listed causes, one by one"),
        Table("Each cause alone, refitted together with the film", heads, tuple(rows), query.shown(), note, below),
    ]
    by_id = {r["mechanism"]: r for r in found}
    for mechanism, parameters in nested(d["severity"]).items():
        written = by_id.get(mechanism, {}).get("equation")
        words = [plain_name(mechanism), " (", code(mechanism), "): ", severity_words(mechanism, parameters), "."]
        blocks.append(Text(flow(*words, *((" Equation: ", equation(written), ".") if written else ()))))
    for text in d["unexplained"] or ():
        blocks.append(Text(flow(bold("Not explained: "), visible(text))))
    return blocks


def _between(lower: float | None, upper: float | None) -> str:
    """Limits of a gain; one where both read alike."""
    return " to ".join(dict.fromkeys((gained(lower), gained(upper))))


def _places(d: Record, found: Sequence[Record], query: Query) -> list[Block]:
    """Causes that were judged by what they predict of a part that they were not fitted to, best first."""
    possible = {d["mechanism"], *(d["also_possible"] or ())}
    rows = []
    for r in found:
        chosen = r["mechanism"] in possible and r["gain_lower"] is not None and r["gain_lower"] > 0
        rows.append(
            Row(
                (
                    flow(plain_name(r["mechanism"]), Markup("<br>"), visible(r["form"]) if r["form"] else code(r["mechanism"])),
                    significant(r["held_out_error"], 3), gained(r["gain"], r["gain_lower"]),
                    _between(r["gain_lower"], r["gain_upper"]),
                    ABSENT if r["explained"] is None else bar(r["explained"], chosen=chosen),
                    candidate(r["mechanism"], r["severity"], r["severity_sd"], r["parameter"]),
                ),
                "sel" if chosen else "dim",
            )
        )  # fmt: skip
    heads = (
        Head("Cause"), Head("Held-out error, SD", "n"), Head("Gain", "n"), Head("95 % interval", "n"),
        Head("Share of the misfit explained", "barcell"), Head("Severity"),
    )  # fmt: skip
    below = (
        "Each cause was fitted to a part of the record and had to predict the rest; the gain is the share of the squared error"
        " beyond the noise there. The last two columns are of fits to everything: what follows what it has seen explains nothing yet."
    )
    note = f"the plain model errs by {significant(d['held_out_error_before'], 3)} times the noise"
    return [
        Heading("Why: the causes, by what they predict"),
        Table(
            "Each cause alone, refitted together with the rest of the model",
            heads,
            tuple(rows),
            query.shown(),
            note,
            below,
        ),
        *(Text(flow(bold("Left: "), visible(_sentence(capital(text))))) for text in d["unexplained"] or ()),
    ]


def _gain(draft: Draft, d: Record) -> list[Block]:
    before, after = d["held_out_error_before"], d["held_out_error_after"]
    if before is None:
        return []
    parts = sorted(json.loads(d["held_out_parts"] or "{}").items(), key=lambda part: -part[1]["before"])
    common = _common_start([name for name, _ in parts])
    names = ["all together", *(name.removeprefix(common) or name for name, _ in parts)]
    first = [before, *(p["before"] for _, p in parts)]
    second = [after, *(p["after"] for _, p in parts)]
    words = f"{significant(before, 2)} times the noise with the plain model"
    if after is not None:
        words += f", {significant(after, 2)} with the extended one"
    address = draft.data("diagnosis_held_out", {"left_out": names, "plain": first, "extended": second})
    caption = flow(
        bold(
            f"Gain: {gain(d)} {REMOVABLE}."
            if d["gain"] is not None
            else "No gain is stated: on these data the plain model errs by little more than the noise."
        ),
        " Each part was left out of the fit and predicted; grey band: what noise alone gives.",
    )
    alt = f"Error of predicting held-out data: {words}."
    return [
        Heading("What the extension gains"),
        Figure(figures.held_out(names[:_PARTS], first[:_PARTS], second[:_PARTS], alt=alt), caption, address),
    ]


def _film(draft: Draft, standing: Standing, d: Record) -> list[Block]:
    """How far the film's parameters move when the cause is in the model."""
    query = Query(shifts.FILM_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found or d["verdict"] == "none":
        return []
    wrong = plain_beyond_noise(d)
    rows = tuple(
        Row(
            (
                _symbol(r["parameter"]), r["unit"],
                significant(r["plain"]) if wrong else never_negative(r["plain"], r["plain_sd"]),
                never_negative(r["extended"], r["extended_sd"]), significant(r["moved_sd"], 2),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (Head("Parameter"), Head("Unit"), Head("Plain", "n"), Head("Extended", "n"), Head("Moved by, SD", "n"))
    moved = shifts.load(draft.results, standing)
    note = shifts.tell(moved)
    below = (
        f"Plain: fitted without {moved.cause} to all that the diagnosis simulates, mean forces, harmonics and rests too. The model that"
        " is fitted to the responses alone is another one; its parameters stand above."
    )
    if wrong:
        below += (
            f" The plain one has no ±: it misses by {significant((d['chi2'] / d['feature_count']) ** 0.5, 2)} times the noise, and a ± would hold for"
            " noise alone. Extended: what that model does not describe counts for less in its ±."
        )
    table = Table("The film in the plain and in the extended model", heads, rows, query.shown(), note, below, "narrow")
    return [table]


def _symbol(parameter: str) -> Piece:
    name = parameter.rstrip("0123456789")
    symbol = {"tau": "τ", "c_inf": "c"}.get(name, name)
    index = parameter.removeprefix(name) if name != "c_inf" else "∞"
    return sub(symbol, index)


def _visible(draft: Draft, d: Record) -> list[Block | Fold]:
    """What would have been seen, what these recordings cannot show, and what could not be asked."""
    smallest = nested(d["smallest_detectable"])
    invisible = list(d["invisible"] or [])
    query = Query(
        "SELECT smallest_detectable, invisible\nFROM diagnoses\nWHERE specimen_id = $specimen", {"specimen": draft.item}
    )
    rows = [
        Row((flow(plain_name(m), Markup("<br>"), code(m)), amount(m, p, value), parameter_words(m, p)))
        for m, parameters in smallest.items()
        for p, value in main(m, parameters).items()
    ]
    rows += [Row((flow(plain_name(m), Markup("<br>"), code(m)), "cannot be seen", ABSENT), "dim") for m in invisible]
    blocks: list[Block | Fold] = []
    if rows:
        heads = (Head("Cause"), Head("Severity"), Head("Of"))
        table = Table(
            "Smallest effects that these recordings would have shown", heads, tuple(rows), query.shown(),
            "with 80 % probability at the false-alarm level in use", kind="narrow",
        )  # fmt: skip
        blocks += [Heading("What would have been seen, and what could not"), _told_by(table, d["verdict"])]
    if d["could_not_ask"]:
        blocks.append(Text(flow(bold("Not asked. "), " ".join(_sentence(text) for text in d["could_not_ask"]))))
    return blocks


def _told_by(table: Table, verdict: str) -> Table | Fold:
    """The smallest effects: the evidence of a verdict that nothing is wrong, else what one may open."""
    if verdict == "none" or len(table.rows) <= _OPEN_ROWS:
        return table
    return Fold(f"{table.caption}: {whole(len(table.rows))} causes", (table,))


def _sentence(text: str) -> str:
    return visible(text).rstrip(".") + "."
