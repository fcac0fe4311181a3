"""A session's fits in numbers and words: severities, film, candidates, residuals, and what stays unexplained.

Does not belong here: what is concluded from them (`pipeline.diagnose.judge`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.diagnose.features import kinds
from pipeline.diagnose.mechanisms import MECHANISMS, Context, list_invisible
from pipeline.diagnose.results import (
    AMBIGUOUS,
    UNKNOWN,
    Candidate,
    Diagnosis,
    Estimate,
    Extension,
    HeldOut,
    NextRecording,
    Residuals,
    Term,
)
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.detectable import discount_further_arms, find_smallest, report_smallest
from pipeline.diagnose.search.discrepancies import describe_what_stays, list_discrepancies, name_kind
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.held_out import list_supporting_protocols
from pipeline.diagnose.search.intervals import NORMAL_90, find_interval_ends, make_linear_ends
from pipeline.diagnose.search.patterns import name_variable
from pipeline.diagnose.search.posterior import Hypothesis, Posterior, RegionFit, refit_under
from pipeline.diagnose.search.tempering import measure_explained_share
from pipeline.diagnose.simulation.parameters import ACTUATION
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.film import RelaxationModel
from schemas.arrays import Float
from schemas.mechanisms import UNLISTED, quote_name
from schemas.numbers import capital, percent
from schemas.protocols import ELECTRICAL, MECHANICAL

NO_COMMAND = "The command was not recorded: the amplifier's gain, lag and offset cannot be questioned."
NORMAL_95 = 1.96
"""Half width of a 95 % interval of the normal distribution, in standard deviations."""
_SMALL = 1e-3
"""Part of an interval at which the slope of a reported severity is taken."""


def report_session(
    simulation: Simulation,
    evidence: Evidence,
    verdict: str,
    held_out: HeldOut | None,
    extended: ExtendedFit | None,
    proposal: NextRecording | None,
) -> Diagnosis:
    """The diagnosis of a session.

    Parameters
    ----------
    simulation : of the session, with nodes for any film
    evidence, verdict : what was found, and concluded
    held_out : errors on parts that were left out; None where there are none
    extended : the model with the causes, in which blocks that it does not describe count for less; None without causes, and where
        they have no name
    proposal : the recording to make next
    """
    # What has no name has a function in place of causes, or beside those that are certain.
    final = None if verdict == UNKNOWN else evidence.final
    function = evidence.function if evidence.is_unnamed else None
    session = evidence.noise_fit.of.session
    context = make_context(simulation, evidence.noise_fit)
    smallest = find_smallest(discount_further_arms(evidence.noise_fit, evidence.signatures), evidence.threshold)
    named = () if final is None else final.of.mechanism_ids
    others = list(dict.fromkeys(id for h in evidence.credible for id in h.causes if id not in named))
    unlisted = [UNLISTED] if evidence.may_be_unlisted else []
    extension = None if extended is None else _report_extension(evidence, extended, context, held_out)
    posterior = evidence.posterior
    stages, covariates = (
        ({}, {}) if posterior is None else (posterior.sum_by(stage=True), posterior.sum_by(stage=False))
    )
    return Diagnosis(
        specimen_id=session.specimen_id,
        verdict=verdict,
        mechanisms=named,
        also_possible=(*others, *unlisted) if verdict == AMBIGUOUS else (),
        p_value=evidence.p_value,
        supported_by=() if final is None else list_supporting_protocols(evidence.plain, final),
        held_out=held_out,
        extension=extension,
        candidates=_list_candidates(evidence, final, context, held_out, extension),
        discrepancies=list_discrepancies(evidence.noise_fit, evidence.louder),
        next_recording=proposal,
        smallest_detectable=report_smallest(smallest, context),
        invisible=list_invisible(session.kinds),
        could_not_ask=_list_unaskable(session),
        unexplained=_describe_unexplained(evidence, verdict, extended),
        plain_film=_take_film(evidence.noise_fit),
        residuals=_list_residuals(evidence.noise_fit, _predict_extended(extended, function)),
        smallest_parameters={id: values for id, (_, values) in smallest.items()},
        explained=float("nan") if final is None else measure_explained_share(evidence.plain, final),
        probabilities={} if posterior is None else posterior.probability,
        stage=max(stages, key=lambda name: stages[name], default=None),
        depends_on=tuple(
            sorted((n for n, p in covariates.items() if p >= RULES.verdict.listed), key=lambda n: -covariates[n])
        ),
        terms=() if posterior is None else _list_terms(posterior),
        left_p_value=float("nan") if evidence.patterns_after is None else evidence.patterns_after.p_value,
        would_tell=list_separators(named, others, proposal) if verdict == AMBIGUOUS else (),
    )


def list_separators(named: Sequence[str], others: Sequence[str], proposal: NextRecording | None) -> tuple[str, ...]:
    """What tells named causes from others in words, of the others that the recording to make next does not tell from them.

    Parameters
    ----------
    named, others : ids of listed causes
    proposal : the recording to make next; None: no test of the catalogue tells any of them apart
    """
    left = [id for id in others if proposal is None or id in proposal.leaves]
    pairs = [(a, b, MECHANISMS[a].confusable.get(b) or MECHANISMS[b].confusable.get(a)) for b in left for a in named]
    return tuple(f"{a} from {b}: {text}" for a, b, text in pairs if text)


def make_context(simulation: Simulation, fit: ExtendedFit) -> Context:
    """What the severities of a session are relative to, from its plain fit."""
    session = fit.of.session
    loads = simulation.loads(fit.of.model.physical(fit.theta))
    rest = session.states.rest_force_n
    return Context(session.scale, loads, float(np.nanmean(rest)) if np.isfinite(rest).any() else float("nan"))


def estimate_film_sd(fit: ExtendedFit) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Standard deviations of the film's parameters.

    Parameters
    ----------
    fit : of any model

    Returns
    -------
    Of k0, k…, τ…, and of the dampers c = k τ, whose springs and times err together; in the order of the film's arms
    """
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


def find_main_key(id: str, estimates: Mapping[str, Estimate]) -> str:
    """Key of the main severity of a mechanism among those that were reported."""
    name = MECHANISMS[id].severities[0].name
    return name if name in estimates else next(iter(estimates))


def choose_film(diagnosis: Diagnosis) -> RelaxationModel:
    """The film as it is best known: that of the extended model where there is one."""
    return diagnosis.plain_film if diagnosis.extension is None else diagnosis.extension.film


def _take_film(fit: ExtendedFit) -> RelaxationModel:
    return fit.of.model.physical(fit.theta).film


def _report_extension(
    evidence: Evidence, extended: ExtendedFit, context: Context, held_out: HeldOut | None
) -> Extension:
    plain = evidence.noise_fit
    without_parts = None if held_out is None else held_out.entries
    interval = find_interval_ends(extended, extended.estimate_spread(without_parts))
    raw = extended.of.compute_data_residual(extended.x)
    film_sd, damper_sd = estimate_film_sd(extended)
    chosen = extended.of.chosen
    return Extension(
        severities={c.id: _estimate_severity(extended, i, interval, context) for i, c in enumerate(chosen)},
        variants={c.id: c.variant for c in chosen},
        film=_take_film(extended),
        film_sd=film_sd,
        damper_sd=damper_sd,
        plain_film=_take_film(plain),
        plain_film_sd=estimate_film_sd(plain)[0],
        chi2=float(raw @ raw),
        plain_chi2=float(plain.misfit @ plain.misfit),
        size=extended.of.session.size,
    )


def _estimate_severity(
    fit: ExtendedFit, number: int, interval: tuple[Float, Float], context: Context
) -> dict[str, Estimate]:
    """Severity of mechanism `number` of a fit, by the contract's keys.

    Standard deviations are by small steps, intervals by whole ones: as lopsided as the parameters are, and what is
    searched in the logarithm is never below 0.

    Parameters
    ----------
    interval : steps of the mechanisms' entries down and up to the ends of their 90 % intervals, (Q,) each
    """
    mechanism, variant = fit.of.chosen[number].mechanism, fit.of.chosen[number].variant

    def report(values: Mapping[str, float]) -> dict[str, float]:
        found = mechanism.report_severity(values, variant, context)
        return {key: float(value) for key, value in found.items() if isinstance(value, int | float)}

    def change(steps: Float) -> dict[str, Float]:
        """Changes of each key by steps of each parameter."""
        reports = [report(values) for values in fit.move_values(number, steps)]
        return {key: np.array([other.get(key, value) - value for other in reports]) for key, value in base.items()}

    base, (lower, upper) = report(fit.values[number]), interval
    slopes, down, up = change(_SMALL * (upper - lower) / (2 * NORMAL_90)), change(lower), change(upper)
    return {
        key: Estimate(
            value,
            math.hypot(*slopes[key]) / _SMALL,
            value - math.hypot(*np.minimum(np.minimum(down[key], up[key]), 0.0)),
            value + math.hypot(*np.maximum(np.maximum(down[key], up[key]), 0.0)),
        )
        for key, value in base.items()
    }


def _list_candidates(
    evidence: Evidence,
    final: ExtendedFit | None,
    context: Context,
    held_out: HeldOut | None,
    extension: Extension | None,
) -> tuple[Candidate, ...]:
    """Every mechanism that was fitted alone, or beside the lag of the amplifier where that is given; best evidence first.

    What is told has the severity of the extended model: one number on every page.
    """
    posterior, plain, given = evidence.posterior, evidence.plain, evidence.given
    if posterior is None:
        return ()
    lag = () if given is None else given.of.mechanism_ids
    causes = () if final is None else final.of.mechanism_ids
    size = _estimate_effective_size(plain)
    found = []
    for hypothesis in posterior.listed:
        fit, base = hypothesis.fit, plain
        if fit is None or not {*lag} <= {*hypothesis.causes}:
            continue
        own = [i for i, id in enumerate(hypothesis.causes) if id not in lag] or list(range(len(lag)))
        if len(own) > 1:
            continue
        if given is not None and hypothesis.causes != lag:
            fit, base = refit_under(plain, hypothesis), given
        chosen = fit.of.chosen[own[0]]
        is_the_cause = {*causes} == {*hypothesis.causes}
        estimates = (
            extension.severities[chosen.id]
            if is_the_cause and extension is not None
            else _estimate_severity(fit, own[0], make_linear_ends(fit.estimate_spread()), context)
        )
        key = find_main_key(chosen.id, estimates)
        parameters = len(chosen.mechanism.list_parameters(chosen.variant))
        ratio = max(base.chi2 - fit.chi2, 0.0)  # a model with one cause more is no worse at its optimum
        found.append(
            Candidate(
                mechanism=chosen.id,
                likelihood_ratio=float(ratio),
                bic=float(ratio - parameters * np.log(size)),
                probability=posterior.probability[hypothesis.name],
                severity=estimates[key].value,
                severity_sd=estimates[key].sd,
                explained=measure_explained_share(base, fit),
                gain=held_out.gain if is_the_cause and held_out is not None else float("nan"),
                variant=chosen.variant,
                equation=chosen.mechanism.equation,
                parameter=key,
            )
        )
    return tuple(found)


def _estimate_effective_size(plain: ExtendedFit) -> float:
    """Number of data less what neighbours say twice: from the lag-1 correlation of the residual."""
    r = plain.misfit
    rho = float(np.clip(np.sum(r[1:] * r[:-1]) / max(float(r @ r), 1e-300), 0.0, 0.99))
    return max(r.size * (1 - rho) / (1 + rho), 10.0)


def _predict_extended(extended: ExtendedFit | None, function: RegionFit | None) -> Float | None:
    """(N,) features by the extended model: with the causes, or with the function of what has no name, which has those beside it."""
    if function is not None:
        return function.predict()
    return None if extended is None else extended.of.predict(extended.x)


def _list_residuals(plain_fit: ExtendedFit, predicted: Float | None) -> tuple[Residuals, ...]:
    session = plain_fit.of.session
    plain = plain_fit.of.predict(plain_fit.x)
    extended = plain if predicted is None else predicted
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


def _list_terms(posterior: Posterior) -> tuple[Term, ...]:
    """The function of the most probable region without a name."""
    found = []
    for h in posterior.regions[:1]:
        if h.region is None:
            continue
        region, (values, sd) = h.region.region, h.region.tell()
        for at, value, spread in zip(region.at.tolist(), values.tolist(), sd.tolist(), strict=True):
            half = NORMAL_95 * spread
            found.append(
                Term(h.name, region.stage, region.covariate, at, region.unit, value, value - half, value + half, "1")
            )
    return tuple(found)


def _describe_unexplained(evidence: Evidence, verdict: str, extended: ExtendedFit | None) -> tuple[str, ...]:
    """What speaks against the causes, and where they mend next to nothing."""
    found = _describe_sizes(evidence.noise_fit if extended is None else extended)
    if verdict == UNKNOWN:
        found += _describe_patterns(evidence)
    if verdict == AMBIGUOUS:
        found += _describe_doubt(evidence)
    if extended is not None:
        found += describe_what_stays(evidence.noise_fit, extended)
    return tuple(found)


def _describe_sizes(fit: ExtendedFit) -> list[str]:
    """What the actuation contradicts, where sizes and permittivity are not believed."""
    model = fit.of.model
    place = model.index(ACTUATION)
    if place is None or np.isfinite(model.prior_sd[place]):
        return []
    of_sizes = fit.of.session.base_model(model.arms).entries[place]
    if not np.isfinite(of_sizes.sd):
        return []
    apart = fit.theta[place] - of_sizes.mean
    if abs(apart) < RULES.prior.contradicted * of_sizes.sd:
        return []  # what contradicted them was the cause
    return [
        f"The actuation is {float(np.exp(apart)):.3g} times what sizes and permittivity give, {abs(apart) / of_sizes.sd:.0f} standard "
        "deviations away: thickness, layers, active region or permittivity are wrong."
    ]


def _describe_patterns(evidence: Evidence) -> list[str]:
    """Patterns that stay, quantities that surely differ beside the causes, and what both depend on."""
    left = evidence.patterns_after or evidence.patterns_before
    told = RULES.verdict.told_pattern
    by_kind = sorted(left.kind_p.items(), key=lambda item: item[1])
    found = [f"A pattern stays in {name_kind(kind)}." for kind, p in by_kind if p < told]
    found += [
        f"Most probable without a name: {_tell_region(h)}." for h in evidence.credible[:1] if h.region is not None
    ]
    found += _describe_useless(evidence) if evidence.explains_nothing else _describe_closest(evidence)
    by_variable = sorted(left.variable_p.items(), key=lambda item: item[1])
    depends = [name_variable(name) for name, p in by_variable if p < told]
    if depends:
        found.append(f"What stays depends on {', '.join(depends)}.")
    return found


def _tell_region(hypothesis: Hypothesis) -> str:
    """A region in words, with the causes that it is beside."""
    if hypothesis.region is None:
        return hypothesis.name
    beside = " and ".join(quote_name(id) for id in hypothesis.beside)
    return hypothesis.region.region.text + (f", beside {beside}" if beside else "")


def _describe_useless(evidence: Evidence) -> list[str]:
    """The listed causes that fit best and predict nothing."""
    listed = () if evidence.posterior is None else evidence.posterior.listed
    names = " with ".join(quote_name(id) for id in listed[0].causes) if listed else "a listed cause"
    return [
        f"{capital(names)} fits best of the listed causes and is told as none: of the error in what was left out it removes"
        f" {percent(max(evidence.gain, 0.0), 3)}."
    ]


def _describe_closest(evidence: Evidence) -> list[str]:
    """The listed cause that takes most of the misfit away, where that is most of it: its form may be another than the formula's."""
    listed = () if evidence.posterior is None else evidence.posterior.listed
    if not listed:
        return []
    best, of = listed[0], evidence.noise_fit.of
    before, after = (fit.of.compute_data_residual(fit.x) for fit in (evidence.noise_fit, best.model))
    beyond = float(before @ before) - of.session.size
    share = 1 - max(float(after @ after) - of.session.size, 0.0) / max(beyond, 1.0)
    if share < RULES.verdict.closest:
        return []
    names = " with ".join(quote_name(id) for id in best.causes)
    return [
        f"Of the listed causes {names} comes closest: it takes {percent(share, 4)} of the misfit away, in another form perhaps all."
    ]


def _describe_doubt(evidence: Evidence) -> list[str]:
    """What speaks for a cause that is in no list: the most probable region among the credible hypotheses."""
    found = [_tell_region(h) for h in evidence.credible if h.region is not None]
    if found and evidence.is_unnamed:
        return [
            f"Something in no list is there as well: {found[0]}. The gain is what its function removes of the error that these causes leave."
        ]
    told = [f"It may be a cause that is in no list: that {found[0]} would explain it as well."] if found else []
    best = evidence.best
    if best is not None and not best.shortfall.is_adequate:
        names = " with ".join(quote_name(id) for id in best.causes)
        told.append(f"{capital(names)} {best.shortfall.describe()}.")
    if best is not None and not evidence.predicts:
        told.append(
            f"What is told explains the recordings it was fitted to, and predicts little of those that were left out: it removes"
            f" {percent(max(evidence.gain, 0.0), 3)} of their error."
        )
    return told


def _list_unaskable(session: Session) -> tuple[str, ...]:
    """Questions that these recordings cannot answer, in words."""
    found = list(session.unasked)
    if len(session.recordings) == 1:
        found.append(
            "There is one recording: nothing can be held out but parts of it, and no change from recording to recording shows."
        )
    if any(prior is None for prior in session.priors):
        found.append(
            "The rig's constants (clamp mass, load-cell stiffness) are missing: the clamp cannot be told from the film."
        )
    loadings = {r.loading for r in session.recordings}
    if ELECTRICAL not in loadings:
        found.append("No electrical test: causes in drive and actuation leave no trace.")
    elif not session.kinds & kinds.AMPLIFIER and not session.unasked:
        found.append(NO_COMMAND)
    if ELECTRICAL in loadings and MECHANICAL not in loadings:
        found.append("No mechanical test: the film's own dynamics rest on the electrical ones.")
    if not np.isfinite(session.states.temperature_k).any():
        found.append(
            "No temperature was recorded: warming is told from other slow changes by its course in time alone."
        )
    return tuple(found)
