"""The part of a specimen's page about its response: measured against the models, residual below."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from reports.blocks import Figure, Pair, Section, Text, bold, flow
from reports.csvfile import Column
from reports.evidence import Measured, beyond_noise, curve, drawable, no_relaxation, siblings, times_noise
from reports.figures import responses as figures
from reports.figures.responses import Curve, Lines
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Row as Record
from schemas.numbers import NBSP, capital, compact, ordinal, percent, significant, word

_NOISE = 1.25
"""Root mean square residual up to which it is called noise, SD."""
_DRAWN = 3
"""Orders always drawn; higher ones only where they are chosen."""


def response(
    draft: Draft,
    fits: Sequence[Record],
    chosen: Record | None,
    found: Measured,
    stated: Mapping[str, Any],
    *,
    alarm: bool,
) -> Section | None:
    """Measured response against the models, residual below."""
    lines = found.film
    if lines is None or lines.size == 0:
        return None
    curves = [curve(f, found, lines, stated) for f in _drawn(fits, chosen)] if chosen and lines.size > 1 else []
    recorded = found.recorded
    href = draft.data("response", _data(lines, curves))
    left = (href, draft.data("residual", _residual_data(curves))) if curves else (href,)
    who = short(draft.item, 40)
    span = over(lines)
    magnitude, phase = np.abs(lines.value[lines.usable]), np.degrees(np.angle(lines.value[lines.usable]))
    misfits = _misfits(curves)
    if magnitude.size:
        rise = f"{significant(magnitude[0], 2)} to {significant(magnitude[-1], 2)}{NBSP}N/mm"
        low, high = f"{significant(phase.min(), 2)}°", f"{significant(phase.max(), 2)}°"
        turn = low if low == high else f"From {low} to {high}"
    else:
        rise, turn = "no usable line", "No usable line"

    def drawn(*, phase: bool, alt: str) -> Markup:
        return figures.response(lines, recorded, curves, phase=phase, alarm=alarm, alt=f"{alt} {misfits}")

    first = Figure(
        drawn(phase=False, alt=f"Dynamic stiffness of {who} goes from {rise} {span}."),
        flow(
            bold("Magnitude."),
            " ",
            " ".join(filter(None, (misfits, _over_all(chosen, curves), _legend(draft, curves, found)))),
        ),
        left,
    )
    second = Figure(
        drawn(phase=True, alt=f"Phase of the stiffness of {who} {span}. {turn}."),
        flow(bold("Phase."), f" {turn}. ", _grey(lines)),
        left,
    )
    elsewhere = misfit_elsewhere(chosen, curves)
    blocks = (Pair((first, second)), Text(elsewhere)) if elsewhere else (Pair((first, second)),)
    return Section("response", _response_heading(chosen, span, curves), "Response and model", blocks)


def over(lines: Lines) -> str:
    """The frequencies of lines, as in "from 1 to 100 Hz" and "at 1 Hz"."""
    low, high = (compact(f, 2) for f in (lines.frequency.min(), lines.frequency.max()))
    return f"at {low}{NBSP}Hz" if low == high else f"from {low} to {high}{NBSP}Hz"


def misfit_elsewhere(chosen: Record | None, curves: Sequence[Curve]) -> str:
    """Where the misfit of a fit lies whose frequency responses show none: in other data, or in constants it had to move."""
    if chosen is None or not (beyond_noise(chosen) or no_relaxation(chosen)):
        return ""
    left = next((c.residual.rms for c in curves if c.selected and c.residual.in_sd), float("nan"))
    if not left <= _NOISE:
        return ""
    return (
        f"The frequency responses are met to {significant(left, 2)} times their noise, but over all data the model leaves"
        f" {significant(times_noise(chosen), 2)} times the noise: the misfit lies in the stress relaxation, or in constants of the rig that"
        " the fit had to move."
    )


def _drawn(fits: Sequence[Record], chosen: Record) -> list[Record]:
    return [f for f in siblings(fits, chosen) if drawable(f) and (f["model_order"] <= _DRAWN or f["selected"])]


def _data(lines: Lines, curves: Sequence[Curve]) -> dict[str, Column]:
    columns: dict[str, Column] = {
        "frequency_hz": lines.frequency,
        "real_n_per_mm": lines.value.real,
        "imag_n_per_mm": lines.value.imag,
        "standard_error_n_per_mm": lines.error,
        "amplification": lines.amplification,
        "usable": lines.usable,
    }
    for c in curves:
        columns[f"order_{c.order}_real"] = c.at_lines.real
        columns[f"order_{c.order}_imag"] = c.at_lines.imag
    return columns


def _residual_data(curves: Sequence[Curve]) -> dict[str, Column]:
    parts = [c.residual for c in curves]
    return {
        "order": [c.order for c in curves for _ in c.residual.frequency],
        "frequency_hz": np.concatenate([r.frequency for r in parts]),
        "magnitude_residual_sd": np.concatenate([r.magnitude for r in parts]),
        "phase_residual_sd": np.concatenate([r.phase for r in parts]),
    }


def _misfits(curves: Sequence[Curve]) -> str:
    parts = [f"{ordinal(c.order)} order {significant(c.residual.rms, 2)}" for c in curves]
    if not parts:
        return "No model is drawn."
    if not curves[0].residual.in_sd:
        left = [float(np.sqrt(np.nanmean(c.residual.magnitude**2))) for c in curves]
        texts = (f"{ordinal(c.order)} order {percent(v / 100)}" for c, v in zip(curves, left, strict=True))
        return f"No noise is stated; root mean square residual of the magnitude: {', '.join(texts)}."
    where = " of the recorded response, rig in the model," if curves[0].residual.recorded else ""
    return f"Root mean square residual{where} in times the noise: {', '.join(parts)}."


def _over_all(chosen: Record | None, curves: Sequence[Curve]) -> str:
    """What the chosen model leaves over all that it was fitted to, where that is another number than the response alone gives."""
    drawn = next((c for c in curves if c.selected and c.residual.in_sd and c.times_noise is not None), None)
    if chosen is None or drawn is None or drawn.times_noise is None:
        return ""
    every, here = significant(drawn.times_noise, 2), significant(drawn.residual.rms, 2)
    if every == here:
        return ""
    scatter = "with what recordings differ by counted as noise, " if _has_scatter(chosen) else ""
    return f"Over all data that it was fitted to, {scatter}the {ordinal(drawn.order)} order leaves {every} times the noise."


def _has_scatter(fit: Record) -> bool:
    """Whether the fit counted differences between recordings among its errors."""
    try:
        return float(json.loads(fit["spread"] or "{}").get("relative_sd") or 0.0) > 0
    except (ValueError, TypeError, AttributeError):
        return False


def _legend(draft: Draft, curves: Sequence[Curve], found: Measured) -> str:
    texts = []
    if any(c.selected and c.sd is not None for c in curves):
        texts.append(f"Blue band: 95{NBSP}% of the model.")
    if found.averaged is not None:
        joined = draft.results.has("master_curves", "specimen_id", draft.item)
        texts.append(f"Points: {'the master curve' if joined else 'averaged over the recordings'}.")
    return " ".join(texts)


def _grey(lines: Lines) -> str:
    if not np.any(np.nan_to_num(lines.amplification) > figures.LIMIT):
        return ""
    return "Grey column: there the film is hardly deformed, so the correction carries no information and is not used."


def _response_heading(chosen: Record | None, span: str, curves: Sequence[Curve]) -> str:
    if chosen is None:
        return f"Response {span}, without a model"
    arms_ = chosen["model_order"]
    subject = f"{capital(word(arms_))} relaxation{'s' if arms_ != 1 else ''}"
    left = next((c.residual.rms for c in curves if c.selected and c.residual.in_sd), float("nan"))
    if misfit_elsewhere(chosen, curves):
        return f"{subject} follow{'s' if arms_ == 1 else ''} the responses {span}; the misfit lies elsewhere"
    if left > _NOISE or (np.isnan(left) and beyond_noise(chosen)):
        return f"{subject} leave{'s' if arms_ == 1 else ''} more than noise {span}"
    return f"{subject} describe{'s' if arms_ == 1 else ''} the film {span}"
