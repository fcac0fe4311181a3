"""The part of a campaign's page about published models of the same films: beside ours, recomputed, and what does not agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from reports.blocks import (
    Block,
    Figure,
    Fold,
    Head,
    Heading,
    Pair,
    Piece,
    Row,
    Section,
    Table,
    Text,
    bold,
    filled,
    flow,
    sub,
)
from reports.evidence import Standing, drawable, siblings
from reports.figures.curves import arms, stiffness
from reports.figures.curves import rig as rig_of
from reports.figures.relaxation import Variant, study
from reports.names import Verbatim
from reports.pages.campaign import thesis_checks as thesis
from reports.pages.campaign.reference import ReferenceFilm, ReferenceModel, reference
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from reports.site import flat_metadata
from schemas.numbers import ABSENT, NBSP, capital, compact, counted, percent, pm, significant

_SQL = """SELECT *
FROM model_fits
WHERE coalesce(extension, '') = ''
  AND specimen_id IN (SELECT specimen_id FROM recordings WHERE campaign = $item)
ORDER BY specimen_id, model_order"""


def sections(draft: Draft, fitted: Sequence[Standing], recordings: Sequence[Record]) -> list[Section]:
    """Our models beside the published ones of the same kind of film; none where no specimen is such a film."""
    metadata = {r["specimen_id"]: flat_metadata(r["metadata"]) for r in recordings if r["specimen_id"]}
    pairs = [(s, film) for s in fitted if (film := _film(s, metadata)) is not None]
    if not pairs:
        return []
    fits = {s.specimen_id: _fits(draft, s) for s, _ in pairs}
    films = list(dict.fromkeys(film for _, film in pairs))
    blocks: list[Block | Fold] = [_errors(draft, pairs, fits), Heading("Tables 4.2 and 4.3 recomputed")]
    blocks += [_parameters(draft, film, pairs, fits) for film in films]
    blocks.append(Text(_PARAMETERS_NOTE, "sub"))
    found = thesis.checks(_clamp(pairs))
    wrong = sum(not c.agrees for c in found)
    implied = [_implied(film, at) for film, at in thesis.bands() if film in films]
    checks: list[Block | Fold] = [_checks(found), Heading("What the printed models give"), *implied]
    return [
        Section("literature", "Beside the literature", "Literature", tuple(blocks)),
        Section("printed", f"{capital(counted(wrong, 'printed statement'))} of the thesis do not follow from its tables", "Printed tables", tuple(checks)),
        Section("springs", "A spring sets how much the stiffness rises, a damper where", "Springs and dampers", tuple(_studies(draft))),
    ]  # fmt: skip


def _film(standing: Standing, metadata: Mapping[str, Mapping[str, Any]]) -> ReferenceFilm | None:
    if standing.fit is None or standing.fit["loading"] == "electrical" or standing.fit["method"] == "time_domain":
        return None
    return reference(standing.material, metadata.get(standing.specimen_id, {}))


def _fits(draft: Draft, standing: Standing) -> list[Record]:
    """The specimen's plain fits of the kind that is in use, by order."""
    rows = draft.results.rows(
        Query("SELECT * FROM model_fits WHERE specimen_id = $item ORDER BY model_order", {"item": standing.specimen_id})
    )
    assert standing.fit is not None
    return [f for f in siblings(rows, standing.fit) if drawable(f)]


def _clamp(pairs: Sequence[tuple[Standing, ReferenceFilm]]) -> float | None:
    """Frequency of the clamp alone on the load cell of the first rig on which it lies in the band of the sweeps."""
    for standing, film in pairs:
        constants = rig_of(standing.fit or {}, standing.stated)
        if constants is not None and film.low_hz < constants.resonance_hz < film.high_hz:
            return constants.resonance_hz
    return None


def _errors(
    draft: Draft, pairs: Sequence[tuple[Standing, ReferenceFilm]], fits: Mapping[str, Sequence[Record]]
) -> Table:
    rows = []
    for standing, film in pairs:
        for fit in fits[standing.specimen_id]:
            published = next((m for m in film.models if m.order == fit["model_order"]), None)
            if published is not None:
                rows.append(_beside(draft, standing.specimen_id, fit, film, published))
    heads = (
        Head("Specimen"), Head("Order", "n"), Head("Published film"), Head("Magnitude, off by", "n"), Head("Phase, off by, °", "n"),
        Head("Its magnitude error, N/mm", "n"), Head("published", "n"), Head("Its phase error, °", "n"), Head("published", "n"),
    )  # fmt: skip
    sources = "; ".join(f"{f.name}: {f.source}" for f in dict.fromkeys(film for _, film in pairs))
    below = (
        "Off by: mean over 60 frequencies spaced by equal ratios, in the band of the publication. Errors are those of each fit"
        f" against its own measurement; the published ones do not state their frequencies. {sources}."
    )
    query = Query(_SQL, {"item": draft.item})
    return Table("Errors of fitted models beside published ones", heads, tuple(rows), query.shown(), below=below, kind="wide")  # fmt: skip


def _beside(draft: Draft, specimen: str, fit: Record, film: ReferenceFilm, published: ReferenceModel) -> Row:
    f = np.geomspace(film.low_hz, film.high_hz, 60)
    ours, theirs = stiffness(fit, f), thesis.of(published, f)
    off = float(np.mean(np.abs(np.abs(ours) / np.abs(theirs) - 1)))
    turned = float(np.mean(np.abs(np.degrees(np.angle(ours / theirs)))))
    return Row(
        (
            draft.site.specimen(specimen), str(fit["model_order"]), film.name, percent(off), significant(turned, 2) if turned >= 0.01 else f"<{NBSP}0.01",
            significant(fit["magnitude_error_n_per_mm"], 2), significant(published.magnitude_error, 3),
            significant(fit["phase_error_deg"], 2), significant(published.phase_error, 3),
        ),
        "sel" if fit["selected"] else "",
    )  # fmt: skip


def _parameters(
    draft: Draft,
    film: ReferenceFilm,
    pairs: Sequence[tuple[Standing, ReferenceFilm]],
    fits: Mapping[str, Sequence[Record]],
) -> Table:
    """Printed parameters of a film, and under each order those of our specimens of that film."""
    rows = []
    for model in film.models:
        printed = [*model.k, *[None] * (4 - len(model.k)), *model.c, *[None] * (3 - len(model.c))]
        values = (ABSENT if v is None else compact(v) for v in printed)
        rows.append(Row(("printed", str(model.order), *values), "dim"))
        for standing in (s for s, own in pairs if own is film):
            rows += [_ours(draft, standing, f) for f in fits[standing.specimen_id] if f["model_order"] == model.order]
    heads = (
        Head("Model"), Head("Order", "n"), *(Head(sub("k", i), "n") for i in range(4)), *(Head(sub("c", i), "n") for i in range(1, 4)),
    )  # fmt: skip
    kept, shown = filled(heads, rows)
    query = Query(_SQL, {"item": draft.item})
    return Table(f"{capital(film.name)} ({film.source}): printed and fitted parameters", kept, shown, query.shown(), kind="wide")  # fmt: skip


_PARAMETERS_NOTE = (
    "Springs k in N/mm, dampers c in N s/mm, arms by falling relaxation time; a rigid spring is a pure dashpot. What a first or a"
    " second order comes to where it leaves more than noise depends on the frequencies and their weights: here the noise, in the"
    " thesis eq 4.14 on a grid that is not stated."
)


def _ours(draft: Draft, standing: Standing, fit: Record) -> Row:
    springs = [pm(fit["k0_n_per_mm"], fit["k0_n_per_mm_sd"])]
    dampers = []
    for i, arm in enumerate(arms(fit), 1):
        springs.append("rigid" if arm.k is None else pm(arm.k, fit[f"k{i}_n_per_mm_sd"]))
        dampers.append(pm(arm.c, fit[f"c{i}_n_s_per_mm_sd"]))
    springs += [ABSENT] * (4 - len(springs))
    dampers += [ABSENT] * (3 - len(dampers))
    cells: tuple[Piece, ...] = (
        draft.site.specimen(standing.specimen_id), str(fit["model_order"]), *springs[:4], *dampers[:3],
    )  # fmt: skip
    return Row(cells, "sel" if fit["selected"] else "")


def _checks(found: Sequence[thesis.Check]) -> Table:
    rows = tuple(
        Row((c.where, c.printed, c.recomputed, c.reading), "dim" if c.agrees else "")
        for c in sorted(found, key=lambda c: c.agrees)
    )
    heads = (Head("Where"), Head("Printed"), Head("Recomputed from the printed parameters"), Head("Reading"))
    below = "Nothing measured here enters: each number follows from what is printed. Grey: it agrees."
    return Table(
        "Printed statements and what the printed tables give", heads, rows, Verbatim(), below=below, kind="wide"
    )


def _implied(film: ReferenceFilm, at: tuple[float, ...]) -> Table:
    """Relaxation times, stiffness and phase of a film's printed models, and how far each is from the highest order."""
    f, best = np.array(at), film.models[-1]
    rows = []
    for model in film.models:
        k = thesis.of(model, f)
        apart = ["", ""]
        if model is not best:
            for i, spacing in enumerate((thesis.LOGARITHMIC, thesis.LINEAR)):
                off, turned = thesis.difference(model, best, thesis.grid(film.low_hz, film.high_hz, spacing))
                apart[i] = f"{significant(off, 2)}; {turned:.1f}°"
        rows.append(
            Row(
                (
                    str(model.order),
                    ", ".join(compact(t) for t in thesis.relaxation_times(model)),
                    *(f"{significant(abs(v))}∠{np.degrees(np.angle(v)):.1f}°" for v in k),
                    f"{significant(model.magnitude_error)}; {model.phase_error:g}°",
                    *apart,
                )
            )
        )
    heads = (
        Head("Order"), Head("τ, s", "n"), *(Head(f"k at {compact(x)}{NBSP}Hz", "n") for x in at), Head("Printed errors", "n"),
        Head(f"Off order {best.order}, equal ratios", "n"), Head("equal steps", "n"),
    )  # fmt: skip
    kept = len(heads) if len(film.models) > 1 else len(heads) - 2
    shown = tuple(Row(r.cells[:kept], r.kind) for r in rows)
    below = "k in N/mm; errors and differences by eq 4.14, in N/mm and degrees, over frequencies in equal ratios or equal steps."
    caption = f"{capital(film.name)} ({film.source})"
    return Table(caption, heads[:kept], shown, Verbatim(), below=below if kept > 7 else "", kind="narrow")


def _studies(draft: Draft) -> list[Block]:
    f = np.geomspace(1e-2, 1e2, 240)
    return [_pair(draft, f, thesis.EXAMPLE_FIRST, "4-2"), _pair(draft, f, thesis.EXAMPLE_SECOND, "4-3")]


def _pair(draft: Draft, f: np.ndarray, model: ReferenceModel, figure: str) -> Pair:
    """The example of a figure of the thesis, its springs and its dampers halved and doubled, one at a time."""
    base = thesis.of(model, f)
    count = len(model.c)
    values = ", ".join(f"k{_SUB[i]} = {compact(k)}" for i, k in enumerate(model.k))
    values += (
        f"{NBSP}N/mm, "
        + ", ".join(f"c{_SUB[i]} = {compact(c)}" for i, c in enumerate(model.c, 1))
        + f"{NBSP}N{NBSP}s/mm"
    )
    made = []
    for letter, words in (("k", "Springs"), ("c", "Dampers")):
        variants = []
        for i in range(1, count + 1):
            for factor, sign in ((2.0, "2 "), (0.5, "½ ")):
                variants.append(Variant(f"{sign}{letter}{_SUB[i]}", thesis.of(_changed(model, letter, i, factor), f)))
        columns: dict[str, Any] = {"frequency_hz": f, "real": base.real, "imag": base.imag}
        for v in variants:
            label = v.name.replace("½ ", "half_").replace("2 ", "twice_").translate(_PLAIN)
            columns |= {f"{label}_real": v.value.real, f"{label}_imag": v.value.imag}
        effect = (
            "k(∞) = k₀ + Σkᵢ moves with each spring; an arm turns at kᵢ/cᵢ, which moves with it"
            if letter == "k"
            else "Neither the static nor the high-frequency stiffness moves; the arm turns earlier with a larger damper"
        )
        made.append(
            Figure(
                study(
                    f, base, variants, alt=f"{words} of the example of figure {figure} halved and doubled: {effect}."
                ),
                flow(bold(f"{words}, example of the thesis' figure {figure}."), f" {values}. {effect}."),
                draft.data(f"springs_{figure}_{letter}", columns),
            )
        )
    return Pair(tuple(made))


_SUB = "₀₁₂₃"
_PLAIN = str.maketrans(_SUB, "0123")


def _changed(model: ReferenceModel, letter: str, arm: int, factor: float) -> ReferenceModel:
    if letter == "k":
        return replace(model, k=tuple(k * factor if i == arm else k for i, k in enumerate(model.k)))
    return replace(model, c=tuple(c * factor if i == arm else c for i, c in enumerate(model.c, 1)))
