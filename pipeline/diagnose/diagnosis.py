"""The diagnosis of a specimen: what the simulation gets wrong, why, and what fixing it gains. The one door.

features of its recordings → session → plain fit → is there anything? → causes → held-out gain → what to measure next
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.diagnose.features import kinds as kinds
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.mechanisms import MECHANISMS, Context, list_invisible
from pipeline.diagnose.proposals.next_recording import propose_separating
from pipeline.diagnose.proposals.proving import propose_proving
from pipeline.diagnose.results import (
    AMBIGUOUS,
    NAMED,
    UNKNOWN,
    Candidate,
    Diagnosis,
    Estimate,
    Extension,
    HeldOut,
    NextRecording,
    Residuals,
)
from pipeline.diagnose.search.decide import Outcome, decide
from pipeline.diagnose.search.detectable import discount_further_arms, find_smallest, report_smallest
from pipeline.diagnose.search.discrepancies import describe_what_stays, list_discrepancies, name_kind
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import settle_outliers
from pipeline.diagnose.search.held_out import list_supporting_protocols, predict_left_out
from pipeline.diagnose.search.intervals import NORMAL_90, find_interval_ends, make_linear_ends
from pipeline.diagnose.search.patterns import Patterns, name_variable
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.search.tempering import measure_explained_share
from pipeline.diagnose.simulation.hum import with_hum
from pipeline.diagnose.simulation.session import Session, make_session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.film import RelaxationModel
from schemas.arrays import Float
from schemas.mechanisms import UNLISTED

_SMALL = 1e-3
_LEFT = 1e-3
"""Probability below which a pattern that stays is mentioned."""
_GAIN_WITH_PATTERN = 0.4
"""Held-out gain that a cause which leaves a pattern has to be able to have: the upper end of its interval."""
_OF_FEATURES = 0.2
"""Share of what the causes explain that is in the features, below which they need not predict any better: a rig that fits with other
constants than its file's predicts as well with them."""
_STRONG, _GAIN_OF_STRONG = 9.0, 0.1
"""Λ over its threshold from which a cause has to predict what it was not fitted to, and the held-out gain that it has to have, if
it does not predict most parts better. A cause that strong which does not carry over at all is another's look; weaker evidence is
too noisy to ask, and a course that is nearly all in one recording cannot be predicted there."""


def diagnose(recordings: Sequence[RecordingFeatures]) -> Diagnosis:
    """Diagnosis of the recordings of one specimen, whatever their order.

    Raises `NotIdentifiableError` where they cannot be asked at all: none of them, several specimens, no response of the film.
    """
    session = with_hum(make_session(recordings))
    simulation = Simulation(session)
    fitted = fit_plain(session, simulation)
    outcome = decide(session, simulation, fitted)
    context = make_context(session, simulation, outcome.untempered)
    final = outcome.final
    smallest = find_smallest(discount_further_arms(outcome.untempered, outcome.looked), outcome.threshold)
    gain = None if final is None else predict_left_out(outcome.plain, final)
    verdict = _checked(outcome, gain)
    named = () if final is None else tuple(c.id for c in final.of.chosen)
    extended = None if final is None else settle_outliers(final)
    alternatives = (
        *(fit.of.chosen[0].id for fit in outcome.alternatives),
        *((UNLISTED,) if outcome.doubtful or outcome.instead else ()),
    )
    return Diagnosis(
        specimen_id=session.specimen_id,
        verdict=verdict,
        mechanisms=named,
        also_possible=alternatives if verdict == AMBIGUOUS else (),
        p_value=outcome.p_value,
        supported_by=() if final is None else list_supporting_protocols(outcome.plain, final),
        held_out=gain,
        extension=None if extended is None else describe_extension(outcome, extended, context, gain),
        candidates=list_candidates(outcome, context, gain),
        discrepancies=list_discrepancies(outcome.untempered),
        next_recording=_next(outcome) if verdict == AMBIGUOUS else None,
        smallest_detectable=report_smallest(smallest, context),
        invisible=list_invisible(session.kinds),
        could_not_ask=list_unaskable(session),
        unexplained=_told(outcome, verdict, extended),
        plain_film=outcome.untempered.of.model.physical(outcome.untempered.theta).film,
        residuals=list_residuals(session, outcome.untempered, extended),
        smallest_parameters={id: values for id, (_, values) in smallest.items()},
        explained=outcome.explained,
        left_p_value=float("nan") if outcome.after is None else outcome.after.p_value,
    )


def make_context(session: Session, simulation: Simulation, fit: ExtendedFit) -> Context:
    """What severities of a session are relative to."""
    loads = simulation.loads(fit.of.model.physical(fit.theta))
    rest = session.states.rest_force_n
    return Context(session.scale, loads, float(np.nanmean(rest)) if np.isfinite(rest).any() else float("nan"))


def list_unaskable(session: Session) -> tuple[str, ...]:
    """Questions that these recordings cannot answer, in words."""
    found = []
    if len(session.recordings) == 1:
        found.append(
            "There is one recording: nothing can be held out but parts of it, and no change from recording to recording shows."
        )
    if any(prior is None for prior in session.priors):
        found.append(
            "The rig's constants (clamp mass, load-cell stiffness) are missing: the clamp cannot be told from the film."
        )
    protocols = set(session.protocols)
    if not protocols & {"sphs", "step"}:
        found.append("No electrical test: causes in drive and actuation leave no trace.")
    elif not session.kinds & {kinds.SPHS_VOLTAGE, kinds.STEP_VOLTAGE}:
        found.append("The command was not recorded: the amplifier's gain, lag and offset cannot be questioned.")
    if protocols & {"sphs", "step"} and not protocols & {"chirp", "cyclic", "relaxation", "cycle"}:
        found.append("No mechanical test: the film's own dynamics rest on the electrical ones.")
    if not np.isfinite(session.states.temperature_k).any():
        found.append(
            "No temperature was recorded: warming is told from other slow changes by its course in time alone."
        )
    return tuple(found)


def _checked(outcome: Outcome, gain: HeldOut | None) -> str:
    """A name needs a held-out gain, and a large one where a pattern stays: else it explains what it was fitted to and no more."""
    if outcome.verdict not in (NAMED, AMBIGUOUS) or gain is None:
        return outcome.verdict
    left = outcome.pattern_stays
    if np.isnan(gain.gain):
        return outcome.verdict if gain.after < gain.before or not left else UNKNOWN
    fall, of_features = _falls(outcome)
    if of_features < _OF_FEATURES * fall:
        return outcome.verdict
    better = sum(after < before for before, after in gain.parts.values())
    if fall > _STRONG * outcome.threshold and gain.gain < _GAIN_OF_STRONG and 2 * better <= len(gain.parts):
        return UNKNOWN
    return UNKNOWN if gain.upper <= (_GAIN_WITH_PATTERN if left else 0.0) else outcome.verdict


def _falls(outcome: Outcome) -> tuple[float, float]:
    """χ² that the causes explain, and how much of it in the features; the rest is what the files say of the rig."""
    if outcome.final is None:
        return 0.0, 0.0
    plain, final = outcome.plain, outcome.final
    return plain.chi2 - final.chi2, float(plain.misfit @ plain.misfit - final.misfit @ final.misfit)


def describe_extension(outcome: Outcome, final: ExtendedFit, context: Context, gain: HeldOut | None) -> Extension:
    model, plain = final.of.model, outcome.untempered
    interval = find_interval_ends(final, final.spread(None if gain is None else gain.entries))
    raw = final.of.data_residual(final.x)
    film_sd, damper_sd = estimate_film_sd(final)
    return Extension(
        severities={c.id: estimate_severity(final, i, interval, context) for i, c in enumerate(final.of.chosen)},
        variants={c.id: c.variant for c in final.of.chosen},
        film=model.physical(final.theta).film,
        film_sd=film_sd,
        damper_sd=damper_sd,
        plain_film=model.physical(plain.theta).film,
        plain_film_sd=estimate_film_sd(plain)[0],
        chi2=float(raw @ raw),
        plain_chi2=float(plain.misfit @ plain.misfit),
        size=final.of.session.size,
    )


def estimate_film_sd(fit: ExtendedFit) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Standard deviations of k0, k…, tau…, and of the dampers c = k tau, in the order of the film's arms."""
    model = fit.of.model
    n, values = model.arms, np.exp(fit.theta[model.film])
    order = np.argsort(-values[1 + n : 1 + 2 * n])
    springs, times = 1 + order, 1 + n + order
    covariance = fit.covariance[model.film, model.film]
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    places = np.concatenate([[0], springs, times, np.arange(1 + 2 * n, values.size)])
    log_c = spread[springs] ** 2 + spread[times] ** 2 + 2 * covariance[springs, times]
    dampers = values[springs] * values[times] * np.sqrt(np.maximum(log_c, 0.0))
    return tuple(float(v) for v in (values * spread)[places]), tuple(float(v) for v in dampers)


def estimate_severity(
    fit: ExtendedFit, number: int, interval: tuple[Float, Float], context: Context
) -> dict[str, Estimate]:
    """Severity by the contract's keys. `interval`: steps of the entries down and up to the ends of theirs, (Q,) each.

    Standard deviations are by small steps, intervals by whole ones: as lopsided as the parameters are, and what is searched in the
    logarithm is never below 0.
    """
    mechanism, variant = fit.of.chosen[number].mechanism, fit.of.chosen[number].variant

    def report(values: Mapping[str, float]) -> dict[str, float]:
        return _keep_numbers(mechanism.reported(values, variant, context))

    def away(steps: Float) -> dict[str, Float]:
        """Changes of each key by steps of each parameter."""
        reports = [report(values) for values in fit.moved(number, steps)]
        return {key: np.array([other.get(key, value) - value for other in reports]) for key, value in base.items()}

    base, (lower, upper) = report(fit.values[number]), interval
    slopes, down, up = away(_SMALL * (upper - lower) / (2 * NORMAL_90)), away(lower), away(upper)
    return {
        key: Estimate(
            value,
            math.hypot(*slopes[key]) / _SMALL,
            value - math.hypot(*np.minimum(np.minimum(down[key], up[key]), 0.0)),
            value + math.hypot(*np.maximum(np.maximum(down[key], up[key]), 0.0)),
        )
        for key, value in base.items()
    }


def _keep_numbers(report: Mapping[str, float | str]) -> dict[str, float]:
    return {key: float(value) for key, value in report.items() if isinstance(value, int | float)}


def list_candidates(outcome: Outcome, context: Context, gain: HeldOut | None) -> tuple[Candidate, ...]:
    if not outcome.singles:
        return ()
    evidence = np.array([f.log_evidence for f in outcome.singles])
    probability = np.exp(evidence - evidence.max())
    probability /= probability.sum()
    size = _estimate_effective_size(outcome.plain)
    found = []
    for fit, share in zip(outcome.singles, probability, strict=True):
        chosen = fit.of.chosen[0]
        estimates = estimate_severity(fit, 0, make_linear_ends(fit.spread()), context)
        key = find_main_key(chosen.id, estimates)
        ratio = outcome.plain.chi2 - fit.chi2
        alone = outcome.final is not None and len(outcome.final.of.chosen) == 1
        believed = alone and outcome.final is not None and outcome.final.of.chosen[0].id == chosen.id
        found.append(
            Candidate(
                mechanism=chosen.id,
                likelihood_ratio=float(ratio),
                bic=float(ratio - len(chosen.mechanism.parameters) * np.log(size)),
                probability=float(share),
                severity=estimates[key].value,
                severity_sd=estimates[key].sd,
                explained=measure_explained_share(outcome.plain, fit),
                gain=gain.gain if believed and gain is not None else float("nan"),
                variant=chosen.variant,
                equation=chosen.mechanism.equation,
            )
        )
    return tuple(found)


def find_main_key(id: str, estimates: Mapping[str, Estimate]) -> str:
    """Key of the main severity among the reported ones."""
    name = MECHANISMS[id].severities[0].name
    return name if name in estimates else next(iter(estimates))


def _estimate_effective_size(plain: ExtendedFit) -> float:
    """Number of data less what neighbours say twice: from the lag-1 correlation of the residual."""
    r = plain.misfit
    rho = float(np.clip(np.sum(r[1:] * r[:-1]) / max(float(r @ r), 1e-300), 0.0, 0.99))
    return max(r.size * (1 - rho) / (1 + rho), 10.0)


def _told(outcome: Outcome, verdict: str, extended: ExtendedFit | None) -> tuple[str, ...]:
    """What speaks against the verdict, or is beside it."""
    against = _unexplained(outcome) if verdict == UNKNOWN else _doubted(outcome) if verdict == AMBIGUOUS else ()
    return against if extended is None else (*against, *describe_what_stays(outcome.untempered, extended))


def _unexplained(outcome: Outcome) -> tuple[str, ...]:
    left: Patterns = outcome.after or outcome.before
    found = []
    for kind, p in sorted(left.kind_p.items(), key=lambda item: item[1]):
        if p < _LEFT:
            found.append(f"A pattern stays in {name_kind(kind)}.")
    found += [f"Beside the causes named, {d.text}." for d in outcome.departed]
    depends = [
        name_variable(name) for name, p in sorted(left.variable_p.items(), key=lambda item: item[1]) if p < _LEFT
    ]
    if depends:
        found.append(f"What stays depends on {', '.join(depends)}.")
    return tuple(found)


def _next(outcome: Outcome) -> NextRecording | None:
    """What to measure: to tell the causes apart, or, where one stands alone that may be none of the list, to see it again."""
    if outcome.final is None:
        return None
    if outcome.alternatives:
        return propose_separating(outcome.final, outcome.alternatives)
    return propose_proving(outcome.plain, outcome.final, outcome.doubtful, outcome.instead)


def _doubted(outcome: Outcome) -> tuple[str, ...]:
    """What speaks for a cause that is in no list: the most telling of what differs beside those named, or alone explains more."""
    if outcome.doubtful:
        return (f"It may be a cause that is in no list: beside the one named, {outcome.doubtful[0].text}.",)
    best = max(outcome.instead, key=lambda d: d.evidence, default=None)
    if best is None:
        return ()
    return (f"It may be a cause that is in no list: that {best.text} would explain all of it as well.",)


def list_residuals(session: Session, fitted: ExtendedFit, believed: ExtendedFit | None) -> tuple[Residuals, ...]:
    plain = fitted.of.predict(fitted.x)
    extended = plain if believed is None else believed.of.predict(believed.x)
    kind, frequency, time = session.kind, session.covariate("frequency_hz"), session.covariate("time_s")
    label = np.concatenate([np.full(p.block.size, p.block.label) for p in session.places])
    found = []
    for number, recording in enumerate(session.recordings):
        own = np.flatnonzero(session.recording_of == number)
        if own.size:
            found.append(
                Residuals(
                    recording.recording_id,
                    kind[own],
                    label[own],
                    frequency[own],
                    time[own],
                    session.value[own],
                    plain[own],
                    extended[own],
                    session.sd[own],
                )
            )
    return tuple(found)


def choose_film(diagnosis: Diagnosis) -> RelaxationModel:
    """The film as it is best known: of the extended model where there is one."""
    return diagnosis.plain_film if diagnosis.extension is None else diagnosis.extension.film
