"""Findings in words: who, what, by how much, what mending it gains. No hedging, no exclamation, no colour without a word.

From diagnoses where they were made; else from what the fits and the lifetimes show.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from reports.blocks import Next, Piece, code, flow, listed, name, sub, tag
from reports.evidence import Standing, beyond_noise, less_than_noise, no_relaxation, times_noise
from reports.names import short
from reports.results import Row
from schemas import numbers
from schemas.explanations import (
    REMOVABLE,
    STAGES,
    Explanation,
    call_cause,
    cause,
    has_unnamed_beside,
    list_explanations,
    tell_doubt,
    tell_no_gain,
    tell_where_to_begin,
)
from schemas.mechanisms import (
    FOREIGN,
    MECHANISMS,
    RECORD,
    RIG,
    UNLISTED,
    list_actions,
    list_sure,
    model_name,
    nested,
    plain_name,
    quote_name,
)
from schemas.numbers import NBSP, capital, compact, p_equals, pm, removed, seconds, significant, symbols, whole, word
from schemas.rig_constants import RIG_CONSTANTS, RigConstant

_CLEARLY_LONGER = 1.2
"""Ratio of two lives from which a heading says it."""
LISTED_CAUSES = len(MECHANISMS)
LESS_THAN_NOISE = "the model leaves less than the errors that the fit reckons with"


def gain(diagnosis: Row) -> str:
    """What the extension removes of the squared held-out error beyond the noise, with its 95 % limits where they are known."""
    if diagnosis["gain"] is None:
        return ""
    return removed(diagnosis["gain"], diagnosis["gain_lower"], diagnosis["gain_upper"])


def what_is_wrong(standing: Standing) -> str:
    """The cause in words; of what is no film, for it has no model of one, in those of a system."""
    text = cause(standing.diagnosis or {})
    return (
        text if standing.fit is not None else text.replace("the film ", "the system ").replace(" strain", " amplitude")
    )


def headline(standing: Standing) -> Markup:
    """The finding of a specimen, its `h1`."""
    who = flow("Specimen ", name(standing.specimen_id))
    d, fit = standing.diagnosis, standing.fit
    if standing.negative:
        return flow(who, ": ", short(standing.negative.partition(":")[0], 120), ", as of no film")
    if d and d["verdict"] == "named":
        removes = (
            ""
            if d["gain"] is None or tell_no_gain(d)
            else f" Correcting it removes {removed(d['gain'], d['gain_lower'])} of the squared held-out error beyond the noise."
        )
        return flow(who, f": {what_is_wrong(standing)}.{removes}")
    if d and has_unnamed_beside(d):
        return flow(who, f": {what_is_wrong(standing)}")
    if d and d["verdict"] == "ambiguous":
        return flow(who, f": {what_is_wrong(standing)}. The recordings {tell_doubt(d)}.")
    if d and d["verdict"] == "unknown":
        return flow(who, f": {tell_unnamed(d)}; none of the {LISTED_CAUSES} listed causes explains it")
    if fit is None:
        return flow(who, "")
    if no_relaxation(fit) and not d:
        return flow(who, ": no relaxation of any order describes the response")
    film = f"{model_name(fit['model_order'])} model of {short(standing.material or 'the film', 30)}"
    if d:
        return flow(who, f": the simulation is right within the noise; a {film}")
    ending = _residual_words(fit)
    if not ending:
        return flow(who, f": a {film}, ", _tell_stiffness(fit))
    return flow(who, f": a {film}, ", _tell_stiffness(fit), f"; {ending}")


def tell_unnamed(d: Row) -> str:
    """Where an effect without a name acts, and on what it depends, as far as that is known."""
    if not d["stage"]:
        return "the simulation is wrong"
    where = f"an effect without a name acts in the {STAGES.get(d['stage'], d['stage'])}"
    on = [str(name).replace("_", " ") for name in d["depends_on"] or ()]
    return f"{where} and depends on the {listed(on)}" if on else where


def _tell_stiffness(fit: Row) -> Markup:
    """The static stiffness, as far as it is known: a number that the recordings do not resolve stands in no heading."""
    value, sd = fit["k0_n_per_mm"], fit["k0_n_per_mm_sd"]
    if not numbers.is_usable(sd):
        return Markup("{} not resolved").format(sub("k", 0))
    return flow(sub("k", 0), f"{NBSP}={NBSP}{numbers.headline(value, sd, 'N/mm')}")


def _tell_beside(standing: Standing) -> str:
    """What has to stand beside the stiffness of a plain model that a diagnosis finds wanting: that with the cause in it, or that its ± does not hold."""
    if standing.verdict in ("", "none"):
        return ""
    fit, with_cause = standing.fit, standing.extension
    if with_cause is None or not numbers.is_usable(with_cause["k0_n_per_mm_sd"]):
        return " as far as the plain model goes"
    what = call_cause(standing.diagnosis or {"verdict": ""})
    value = numbers.headline(with_cause["k0_n_per_mm"], with_cause["k0_n_per_mm_sd"], "N/mm")
    if fit is not None and numbers.headline(fit["k0_n_per_mm"], fit["k0_n_per_mm_sd"], "N/mm") == value:
        return f" with {what} and without it"
    return f" without {what} and {value} with it"


def _residual_words(fit: Row) -> str:
    if fit["reduced_chi2"] is None:
        return ""
    if beyond_noise(fit):
        return f"the model leaves {significant(times_noise(fit), 2)} times the noise"
    if less_than_noise(fit):
        return LESS_THAN_NOISE
    return "what the model leaves is noise"


def lede(standing: Standing) -> Piece:
    """What the specimen's material is, below a finding about something else."""
    fit, d = standing.fit, standing.diagnosis
    if standing.negative:
        return f"{capital(short(standing.negative, 300))}. Nothing fitted to these recordings means anything before that is right."
    if fit is None:
        return ""
    if d and d["stage"] == RECORD:
        return (
            "Put that right first. All that follows is computed from the recordings as they are: what is fitted to them is no"
            " property of the film before."
        )
    if d:
        return Markup("{} {} model, {}{}; reduced χ² {}.").format(
            "The film itself: a" if d["verdict"] == "named" else "A", model_name(fit["model_order"]), _tell_stiffness(fit),
            _tell_beside(standing), significant(fit["reduced_chi2"]),
        )  # fmt: skip
    if no_relaxation(fit):
        return (
            f"Even the best relaxation of any order leaves {significant(fit['positivity_chi2'])} times the variance of the"
            " noise. Look at rig, sensor and nonlinearity before adding arms."
        )
    if fit["reduced_chi2"] is None:
        samples = f"{whole(fit['frequency_lines'])} samples" if fit["method"] == "time_domain" else "its recordings"
        return f"Fitted to {samples}; the noise is not known, so neither is whether the misfit is noise."
    return Markup("Reduced χ² {} over {} lines from {} to {}{}Hz.").format(
        significant(fit["reduced_chi2"]), fit["frequency_lines"] or "–", compact(fit["frequency_low_hz"]),
        compact(fit["frequency_high_hz"]), NBSP,
    )  # fmt: skip


def evidence(standing: Standing) -> tuple[Piece, ...]:
    """What supports the finding, in one or two sentences."""
    d, fit = standing.diagnosis, standing.fit
    if standing.negative:
        return (lede(standing),)
    if d is None:
        return (lede(standing), *remarks(standing)) if fit else ()
    sentences: list[Piece] = []
    if d["verdict"] == "named":
        ids = listed([code(m) for m in d["mechanisms"] or [d["mechanism"]] if m])
        shown = f" Shown by {', '.join(d['supported_by'])}." if d["supported_by"] else ""
        sentences.append(flow(tag("named"), " · ", ids, ".", shown))
        if tell_no_gain(d):
            sentences.append(f"{tell_no_gain(d)} Gain: {gain(d)} {REMOVABLE}.")
        elif d["held_out_error_before"] is not None and d["held_out_error_after"] is not None:
            sentences.append(
                f"The error on recordings that the fit has not seen falls from {significant(d['held_out_error_before'], 2)}"
                f" to {significant(d['held_out_error_after'], 2)} times the noise."
                + (f" Gain: {gain(d)} {REMOVABLE}." if d["gain"] is not None else "")
            )
    elif has_unnamed_beside(d):
        ids = listed([code(m) for m in d["mechanisms"]])
        sentences.append(
            flow(tag("ambiguous"), " · ", ids, ", as good as certain, and something beside that is in no list.")
        )
    elif d["verdict"] == "ambiguous":
        explanations = list_explanations(d)
        options = [_by_ids(one, explanations) for one in explanations]
        text = flow("either " if len(options) > 1 else "", Markup(", or ").join(options))
        sentences.append(flow(tag("ambiguous"), " · ", text, ": too close to tell apart with these recordings."))
    elif d["verdict"] == "unknown":
        sentences.append(
            flow(tag("unknown"), f". The discrepancy is real ({p_equals(d['p_value'])}); no listed cause leaves noise.")
        )
    else:
        sentences.append(flow(tag("none"), f". No discrepancy beyond the noise ({p_equals(d['p_value'])})."))
    return tuple(sentences)


def _by_ids(explanation: Explanation, of: Sequence[Explanation]) -> Piece:
    """Causes that are there together, by their ids; alone where others hold them with more."""
    if not explanation:
        return "nothing but noise"
    ids = Markup(" with ").join(plain_name(m) if m == UNLISTED else code(m) for m in explanation)
    return flow(ids, " alone") if any({*explanation} < {*other} for other in of) else ids


def what_next(standing: Standing) -> Next | None:
    """What `list_next` says, as a part of a page."""
    title, sentences = list_next(standing)
    return Next(title, " ".join(sentences)) if sentences else None


def list_next(standing: Standing) -> tuple[str, list[str]]:
    """What to do about the causes that are named, or the recording that would decide, or where to begin where none would: its heading, and
    sentences; none where there is nothing to do."""
    diagnosis = standing.diagnosis
    if not diagnosis:
        return "", []
    words = [diagnosis["next_recording"]] if diagnosis["next_recording"] else []
    telling = [_as_sentence(text) for text in (*words, *(diagnosis["would_tell"] or ()))]
    if diagnosis["verdict"] == "named":
        return "What to do", [*_list_named_actions(standing, list(diagnosis["mechanisms"] or ())), *telling]
    if telling:
        return "Next recording to make" if words else "What would tell them apart", telling
    return "What to do", tell_where_to_begin(diagnosis)


def _as_sentence(text: object) -> str:
    return f"{capital(name_causes(str(text))).rstrip('.')}."


def _list_named_actions(standing: Standing, mechanisms: list[str]) -> list[str]:
    """What to do about causes that are named, with the constants to write into the rig's file, and whose a foreign recording is."""
    constants = find_constants(standing)
    written = [tell_constants(standing, constants)] if constants else []
    if written and standing.taps:
        mechanisms.remove(RIG)
        return [*written, *list_actions(mechanisms)]
    whose = [standing.owner] if FOREIGN in mechanisms and standing.owner else []
    return [*list_actions(mechanisms), *whose, *written]


@dataclass(frozen=True)
class FoundConstant:
    """A constant of the rig as its file states it, and as a diagnosis finds it."""

    constant: RigConstant
    filed: float
    value: float
    sd: float


def find_constants(standing: Standing) -> list[FoundConstant]:
    """The constants of the rig that the diagnosis finds off, by how much; empty where they are not what is wrong, or their file is silent."""
    diagnosis = standing.diagnosis
    if diagnosis is None or diagnosis["verdict"] != "named" or RIG not in (diagnosis["mechanisms"] or ()):
        return []
    severity = nested(diagnosis["severity"]).get(RIG, {})
    sure = list_sure(RIG, severity)
    found = []
    for constant in RIG_CONSTANTS:
        filed, off = _number(standing.stated.get(constant.key)), severity.get(constant.error)
        if filed and constant.error in sure and isinstance(off, dict) and off.get("sd"):
            found.append(FoundConstant(constant, filed, filed * (1 + off["value"]), filed * off["sd"]))
    return found


def tell_constants(standing: Standing, found: Sequence[FoundConstant]) -> str:
    """What to write into the rig's file by a diagnosis. Without taps it says no more than what these recordings make of it."""
    if not standing.taps:
        told = [
            f"{f.constant.name} {pm(f.value, f.sd, f.constant.unit)} in place of {significant(f.filed)}" for f in found
        ]
        return f"By these recordings: {listed(told)}."
    rig_id = standing.stated.get("rig_id")
    file = f"rigs/{short(str(rig_id), 80)}.toml" if rig_id else "the rig's file"
    keys = listed([f"{f.constant.key} = {pm(f.value, f.sd)} (now {significant(f.filed)})" for f in found])
    sds = listed([f"{f.constant.key}_sd" for f in found])
    return (
        f"Write {keys} into {file}, the ± as {sds}, and run the night again: taps of the clamp are among what says so."
    )


_CAUSES = re.compile(r"\b(?:" + "|".join(sorted((m for m in MECHANISMS if "_" in m), key=len, reverse=True)) + r")\b")


def name_causes(text: str) -> str:
    """The text with causes by their everyday names in place of their ids."""
    return _CAUSES.sub(lambda found: quote_name(found[0]), text)


def remarks(standing: Standing) -> tuple[str, ...]:
    """Constants of the rig that the fit moved away from their file by more than two SD, and what the fit warns of."""
    fit = standing.fit
    if fit is None:
        return ()
    texts = []
    for constant in RIG_CONSTANTS:
        column, unit = constant.key, constant.unit
        value, sd = fit[column], fit[f"{column}_sd"]
        filed, filed_sd = (_number(standing.stated.get(key)) for key in (column, f"{column}_sd"))
        if None in (value, sd, filed) or not filed_sd:
            continue
        z = abs(value - filed) / float((sd**2 + filed_sd**2) ** 0.5)
        if z > _CLEAR:
            texts.append(
                f"The fit finds {constant.part} at {pm(value, sd, unit)} where its file says {pm(filed, filed_sd, unit)}:"
                f" {significant(z, 2)} SD apart."
            )
    texts += tell_negative(fit)
    known = no_relaxation(fit)
    said = [w for w in (fit["warnings"] or "").split("; ") if w and not (known and w.startswith(_SAID))]
    if any(w.startswith("the fit puts") for w in said):
        texts = []
    if said:
        texts.append(sentences("; ".join(said)))
    return tuple(texts)


def tell_negative(fit: Row) -> list[str]:
    """What it means that a constant of the rig, which cannot be negative, was fitted as one beyond its standard deviation."""
    texts = []
    for constant in RIG_CONSTANTS:
        value, sd = fit[constant.key], fit[f"{constant.key}_sd"]
        if value is None or not sd or sd >= -value:
            continue
        far = f"{significant(-value / sd, 2)} SD below 0"
        meaning = (
            "no rig has that, so it makes up for something else that is wrong, such as another constant of the rig or a delay"
            " between channels, and is no property of the rig"
            if value < -_CLEAR * sd
            else "as good as none"
        )
        texts.append(f"The fit puts {constant.part} {far}: {meaning}.")
    return texts


_CLEAR = 2.0
"""Standard deviations from which on a number is not what it differs from."""
_SAID = ("no relaxation of any order", "more arms cannot help")
"""Beginnings of warnings that the headline of a specimen with the positivity alarm has said already."""


def sentences(warnings: str) -> str:
    """Warnings of a fit, stored with semicolons between, as sentences."""
    parts = [symbols(part.strip().rstrip(".")) for part in short(warnings, 600).split("; ")]
    return " ".join(f"{capital(part)}." for part in parts if part)


def _number(value: object) -> float | None:
    try:
        return float(str(value))
    except ValueError:
        return None


def kind(standing: Standing) -> str:
    """Class of the finding: its colour, always with the sign and word in the text."""
    if standing.verdict == "named" and not standing.negative:
        return "named"
    return "open" if standing.alarm else "fine"


def survival_title(comparison: Row, summaries: Sequence[Row]) -> str:
    """Which of two groups lives longer, by their restricted means or by who failed at all."""
    voltage = comparison["voltage_kv"]

    def of(configuration: str) -> Row | None:
        return next((s for s in summaries if s["configuration"] == configuration and s["voltage_kv"] == voltage), None)

    a, b = of(comparison["configuration_a"]), of(comparison["configuration_b"])
    if a is None or b is None:
        first, second = (f"“{short(comparison[f'configuration_{x}'] or '')}”" for x in "ab")
        return f"{first} and {second} live differently"
    longer, other = (a, b) if (a["restricted_mean_s"] or 0) >= (b["restricted_mean_s"] or 0) else (b, a)
    who, than = (f"“{short(s['configuration'] or '')}”" for s in (longer, other))
    if longer["failures"] == 0:
        return f"{who}: none of {word(longer['specimens'])} failed; {than}: {word(other['failures'])} of {word(other['specimens'])}"
    # Over the time in which both groups were watched most of the longer lives have not ended: that ratio is one of means up to then.
    watched = (
        f"mean life, up to {seconds(longer['restricted_to_s'])}," if longer.get("restricted_to_s") else "mean life"
    )
    for quantity, called in (("median_s", "median life"), ("restricted_mean_s", watched)):
        if longer.get(quantity) and other.get(quantity):
            ratio = longer[quantity] / other[quantity]
            if ratio >= _CLEARLY_LONGER:
                return f"{who}: {significant(ratio, 2)} times the {called} of {than}"
    return f"{who}: longer lives than {than}"


def causes_named(standings: Sequence[Standing]) -> str:
    """`constants of the rig`, for the list of specimens."""
    names = {plain_name(m) for s in standings if s.diagnosis for m in s.diagnosis["mechanisms"] or []}
    return ", ".join(sorted(names))
