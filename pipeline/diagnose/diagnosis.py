"""The diagnosis of a specimen, from the features of its recordings to a verdict: the algorithm, step by step.

The README of this package tells the method with its equations; every step below is one module, which it names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.diagnose.faults.another_film import Change, Doubt, list_unexplained, weigh_change, weigh_doubts
from pipeline.diagnose.faults.find import Checked, check_recordings
from pipeline.diagnose.faults.fitted import fit_session
from pipeline.diagnose.faults.sized import believe_sizes, find_doubt, replace_doubt, weigh_sizes
from pipeline.diagnose.faults.state import state_faults
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.judge import judge_session
from pipeline.diagnose.proposals.next_recording import Rival, propose_separating
from pipeline.diagnose.report import NO_COMMAND, report_session
from pipeline.diagnose.results import AMBIGUOUS, UNKNOWN, Diagnosis, NextRecording
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.amplifier import drop_filed_lag, find_amplifier_lag, fit_further_lag
from pipeline.diagnose.search.consensus import find_consensus, search_from_consensus
from pipeline.diagnose.search.discrepancies import compute_least_p
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.extended_model import Extended, ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import (
    confirm_best,
    fit_each_mechanism,
    order_causes,
    settle_outliers,
    temper_fit,
)
from pipeline.diagnose.search.form_functions import allow_form_errors, differentiate_regions, weigh_regions
from pipeline.diagnose.search.found_elsewhere import try_found_elsewhere
from pipeline.diagnose.search.held_out import predict_by_function, predict_left_out
from pipeline.diagnose.search.likelihood import measure_quiet
from pipeline.diagnose.search.named_regions import name_regions
from pipeline.diagnose.search.order import take_up_arm
from pipeline.diagnose.search.patterns import test_patterns
from pipeline.diagnose.search.plain_fit import PlainFit
from pipeline.diagnose.search.posterior import (
    Hypothesis,
    Posterior,
    rank_hypotheses,
    refit_under,
    settle_hypotheses,
    settle_hypothesis,
    weigh_fit,
)
from pipeline.diagnose.search.region_optima import settle_regions
from pipeline.diagnose.search.screen import (
    Secants,
    compute_secants,
    compute_signatures,
    find_best_scores,
    renew_secants,
)
from pipeline.diagnose.search.several_causes import add_causes, try_causes_of_form
from pipeline.diagnose.search.tempering import temper_weights
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError

_LAG_IS_FILED = "The amplifier lags as its rig's file states: that is no finding, and what it makes of its command was not asked further."
_FEW_STEPS = 3
"""Steps that bring a plain fit under the simulation of another film to its optimum."""


def diagnose(recordings: Sequence[RecordingFeatures]) -> Diagnosis:
    """What the simulation of a specimen's recordings gets wrong, why, and what mending it gains.

    Parameters
    ----------
    recordings : features of the recordings of one specimen, in any order

    Returns
    -------
    Verdict, causes with severities, held-out gain, and what to measure next

    Raises
    ------
    NotIdentifiableError
        where they cannot be asked at all: none of them, several specimens, no response of the film
    """
    # 0. and 1. Recordings first: one session of those that agree with each other and their own metadata, with its noise,
    # simulated with a film and the rig as its file has it.
    as_recorded = check_recordings(recordings)
    checked = _drop_filed_lag(as_recorded)
    lag_is_filed = checked is not as_recorded
    # 2. to 6. What is left, and which mechanisms explain it.
    evidence = _ask(checked)
    # What misses the others and no cause explains may be of another film.
    unexplained = list_unexplained(checked.doubts, checked.session, evidence)
    if unexplained:
        checked, evidence = _ask_without(unexplained, checked, evidence)
    # So may a film that seems another from one recording on.
    if checked.change is not None:
        checked, evidence = _ask_unchanged(checked.change, checked, evidence)
    # Sizes may seem wrong only as long as no cause is at work.
    checked, evidence = _ask_as_sized(checked, evidence)
    # 7. The verdict, and 8. parts are left out and predicted: with the named causes, or the function of what has no name.
    verdict = judge_session(evidence)
    final = None if verdict == UNKNOWN else evidence.final
    held_out = None
    if final is not None and not (evidence.is_unnamed and evidence.function is not None):
        held_out = predict_left_out(evidence.plain, final)
        if held_out is not None and any(c.mechanism.as_filed is None for c in final.of.chosen):
            # What predicts little of what it was not fitted to is not named without doubt; but for the rig's constants, which the plain
            # model moves as well, against its file.
            evidence = evidence.learn_gain(held_out.gain)
            verdict = judge_session(evidence)
            if verdict == UNKNOWN:
                final = held_out = None
    if evidence.is_unnamed and evidence.function is not None:
        held_out = predict_by_function(evidence.function)
    # 9. What to measure next.
    proposal = _propose_recording(evidence) if verdict == AMBIGUOUS and not evidence.is_unnamed else None
    # 10. Numbers and words.
    extended = None if final is None else settle_outliers(final)
    found = report_session(checked.simulation, evidence, verdict, held_out, extended, proposal)
    if lag_is_filed:
        asked = (text for text in found.could_not_ask if text != NO_COMMAND)
        found = replace(found, could_not_ask=(*asked, _LAG_IS_FILED))
    return state_faults(found, checked.faults)


def _drop_filed_lag(checked: Checked) -> Checked:
    """The session without what its amplifier makes of its command, where that lags as the rig's file states it."""
    if checked.is_barred:
        return checked
    without = drop_filed_lag(checked.session, checked.simulation, checked.plain)
    if without is None:
        return checked
    session, simulation, plain = fit_session(without)
    return replace(checked, session=session, simulation=simulation, plain=plain)


def _ask(checked: Checked) -> Evidence:
    """Steps 2 to 6; where a fault bars all causes only what there is is seen."""
    session, plain = checked.session, checked.plain
    of = Extended(session, checked.simulation, plain.model, (), np.ones(session.size))
    return _screen(of, plain.theta)[1] if checked.is_barred else _search_causes(of, plain)


def _ask_without(doubts: Sequence[Doubt], checked: Checked, evidence: Evidence) -> tuple[Checked, Evidence]:
    """The session without recordings that may be of another film, where that is the more probable; with what that says of them."""
    names = {id for d in doubts for id in d.recordings}
    try:
        rest = fit_session([r for r in checked.session.recordings if r.recording_id not in names])
    except NotIdentifiableError:
        return checked, evidence
    evidence, without = _tell_each_other(evidence, _ask(Checked(*rest, checked.faults)))
    faults = weigh_doubts(doubts, checked.session, evidence, without)
    if any(f.sets_aside for f in faults):
        return Checked(*rest, (*checked.faults, *faults)), without
    return replace(checked, faults=(*checked.faults, *faults)), evidence


def _ask_unchanged(change: Change, checked: Checked, evidence: Evidence) -> tuple[Checked, Evidence]:
    """The session with the recordings from which on something seems to have changed, where a mechanism that does that to them is the more
    probable; with what that says of the change."""
    others = tuple(f for f in checked.faults if f is not change.fault)
    as_one = _drop_filed_lag(Checked(*change.as_one, others))
    unchanged, evidence = _tell_each_other(_ask(as_one), evidence)
    probability = weigh_change(change, unchanged, evidence)
    believed = probability > 1 / 2
    told = replace(change.fault, sets_aside=believed)
    faults = tuple(told if f is change.fault else f for f in checked.faults)
    faults = replace_doubt(faults, told, change.fault.probability * probability)
    return (replace(checked, faults=faults), evidence) if believed else (replace(as_one, faults=faults), unchanged)


def _tell_each_other(first: Evidence, second: Evidence) -> tuple[Evidence, Evidence]:
    """What two searches in recordings of one specimen found, each with what the other one found tried in it."""
    in_first, in_second = try_found_elsewhere(second, first), try_found_elsewhere(first, second)
    return (
        first if in_first is None else _tell_causes(first, in_first),
        second if in_second is None else _tell_causes(second, in_second),
    )


def _ask_as_sized(checked: Checked, evidence: Evidence) -> tuple[Checked, Evidence]:
    """The session with the actuation that its sizes promise, where that is the more probable; with what that says of them."""
    doubt = find_doubt(checked.faults)
    if doubt is None or evidence.best is None:
        return checked, evidence
    sized = _ask(replace(checked, plain=believe_sizes(checked.plain)))
    wrong = weigh_sizes(evidence, sized)
    if wrong > 1 / 2:
        return checked, evidence
    return replace(checked, faults=replace_doubt(checked.faults, doubt, wrong)), sized


def _search_causes(of: Extended, plain: PlainFit) -> Evidence:
    """Steps 2 to 6, begun anew where they find that the plain model was not at its optimum."""
    start, mechanical = plain.theta, plain.mechanical
    of = replace(of, simulation=of.simulation.about(of.model.physical(start)))
    earlier: Sequence[Hypothesis] = ()
    restarts = 0
    while True:
        evidence = _search_from(of, start, mechanical, earlier)
        if evidence.with_arm is not None:
            # The mechanical tests alone know nothing of this arm.
            (model, start), mechanical = evidence.with_arm, None
            of = replace(of, model=model, simulation=of.simulation.about(model.physical(start)))
            continue
        earlier, restarts = _list_close_causes(evidence), restarts + 1
        better = _find_better_plain(evidence) if restarts < RULES.plain.restarts else None
        if better is None:
            return evidence
        start = better


def _list_close_causes(evidence: Evidence) -> Sequence[Hypothesis]:
    """Single causes that come near the best one: a search from another film may end elsewhere, and must not lose them."""
    if evidence.posterior is None:
        return ()
    single = [h for h in evidence.posterior.hypotheses if len(h.causes) == 1]
    best = max((h.log_joint for h in single), default=0.0)
    return [h for h in single if h.log_joint > best - RULES.fit.close_call]


def _search_from(of: Extended, start: Float, mechanical: Float | None, earlier: Sequence[Hypothesis]) -> Evidence:
    """Steps 2 to 6 from entries `start` (P,) of the plain model.

    Parameters
    ----------
    mechanical : (P,) entries of the mechanical tests alone
    earlier : causes found in a search from elsewhere
    """
    # 2. Is there anything?
    changes, nothing = _screen(of, start)
    noise_fit, signatures, p_value, patterns = (
        nothing.noise_fit, nothing.signatures, nothing.p_value, nothing.patterns_before,
    )  # fmt: skip
    by_mechanism, by_pattern = p_value < RULES.alarm.mechanism_level, patterns.p_value < RULES.alarm.pattern_level
    by_place = compute_least_p(noise_fit) < RULES.alarm.pattern_level
    if not (by_mechanism or by_pattern or by_place):
        return nothing

    # 3. Tempering: no mechanism has exactly reality's form, so every block may be wrong by a share of its misfit.
    tempered = noise_fit.of.reweigh(temper_weights(of.session, noise_fit.misfit))
    plain = tempered.refine(tempered.fit(noise_fit.theta))
    tempered_signatures = compute_signatures(changes, plain)

    # 4. Every promising mechanism alone, fitted together with film and rig; the lag of the amplifier first, and all else beside it where
    # that is plain to see.
    lag = find_amplifier_lag(plain, tempered_signatures)
    given = plain if lag is None else temper_fit(lag)
    beside = changes if lag is None else renew_secants(changes, given)
    given_signatures = compute_signatures(beside, given)
    scores = find_best_scores(given_signatures)
    fitted: Sequence[ExtendedFit] = ()
    if lag is None or (scores and given_signatures.reaches(scores[0].statistic, RULES.cause.level)):
        fits = fit_each_mechanism(given, scores, given_signatures, RULES.fit.mechanisms)
        fitted = confirm_best(fits if lag is None else [*fits, fit_further_lag(given)])
    singles = fitted if lag is None else (lag,)
    fall = max((plain.chi2 - f.chi2 for f in singles), default=0.0)
    left = test_patterns(plain) if by_pattern else None
    pattern_stays = left is not None and left.p_value < RULES.alarm.left_level
    if not (pattern_stays or by_place) and fall < RULES.alarm.confirmed * nothing.threshold:
        # The screen was led on by what the model absorbs of a strong effect, or a pattern is within the form of the
        # model. No place is far beyond the noise: where one is, the likelihood has to say what of it the noise may be.
        return replace(nothing, p_value=signatures.compute_p(fall)) if singles else nothing

    # 5. All hypotheses under one likelihood: single causes, further ones beside the best, regions without a name.
    quiet = measure_quiet([plain, given, *fitted])
    plain, noise_fit, given = (f.allow_quiet(quiet) for f in (plain, noise_fit, given))
    singles, fitted = (tuple(f.allow_quiet(quiet) for f in fits) for fits in (singles, fitted))
    agreed = find_consensus([plain, noise_fit], mechanical)
    kept = [weigh_fit(h.model.allow_quiet(quiet)) for h in earlier if h.model.of.model.names == plain.of.model.names]
    given_agreed = agreed if lag is None else find_consensus([*singles, given], mechanical)
    from_consensus = search_from_consensus(given, given_agreed)
    of_given = [] if lag is None else [given_agreed]
    hypotheses = settle_hypotheses([*of_given, *map(weigh_fit, fitted), *from_consensus, *kept])
    hypotheses += add_causes(hypotheses, beside)
    with_arm = take_up_arm(refit_under(plain, rank_hypotheses(hypotheses)[0])) if hypotheses else None
    if with_arm is not None:
        return replace(nothing, p_value=p_value, with_arm=with_arm)
    noise = max(
        (settle_hypothesis(weigh_fit(f, noise_alone=True)) for f in (noise_fit, agreed.model)),
        key=lambda h: h.log_evidence,
    )
    unnamed = differentiate_regions(agreed.model)
    hypotheses = allow_form_errors(hypotheses, unnamed)
    regions: list[Hypothesis] = []
    if lag is None:
        regions = settle_regions(weigh_regions(agreed, unnamed), [noise, agreed, *hypotheses], plain)
        hypotheses += allow_form_errors(try_causes_of_form(agreed, regions, hypotheses, beside), unnamed)
        hypotheses, regions = name_regions(hypotheses, regions, agreed.model)
    posterior = Posterior.of([noise, agreed, *hypotheses, *regions])
    for base in posterior.find_sure():
        # What has no name may be beside a cause that is sure: every amplifier lags a little.
        further = settle_regions(weigh_regions(base, unnamed), hypotheses, refit_under(plain, base))
        hypotheses += allow_form_errors(try_causes_of_form(base, further, hypotheses, beside), unnamed)
        hypotheses, further = name_regions(hypotheses, further, base.model)
        regions += further
    posterior = Posterior.of([noise, agreed, *hypotheses, *regions])
    if lag is not None and _is_all_there_is(lag, posterior, beside):
        posterior = Posterior.of([noise, agreed, posterior.hypotheses[0]])
    if noise in posterior.find_set(RULES.verdict.credible):
        # Where nothing is more probable than its noise, that is as loud as the session makes it, and known no better.
        again = _test_again(changes, noise, in_doubt=noise is posterior.hypotheses[0])
        if again >= RULES.alarm.mechanism_level:
            return replace(nothing, p_value=again, noise_fit=noise.model, louder=noise.weight)
    p_value = min(p_value, patterns.p_value if by_pattern else 1.0)
    return _tell_causes(replace(nothing, p_value=p_value, plain=plain, singles=singles), posterior)


def _tell_causes(evidence: Evidence, posterior: Posterior) -> Evidence:
    """Step 6, the causes that a posterior tells, at their optimum, and what they leave."""
    found, plain = replace(evidence, posterior=posterior), evidence.plain
    told = found.sure or found.best
    final = None if told is None else order_causes(refit_under(plain, told))
    return replace(found, final=final, patterns_after=test_patterns(plain if final is None else final))


def _screen(of: Extended, start: Float) -> tuple[Secants, Evidence]:
    """Step 2, the plain model under the noise: signatures of all mechanisms, and smooth patterns that none of them proposes."""
    noise_fit = _fit_under_noise(of, start)
    changes = compute_secants(noise_fit)
    signatures = compute_signatures(changes, noise_fit)
    scores = find_best_scores(signatures)
    p_value = signatures.compute_p(scores[0].statistic) if scores else 1.0
    threshold = signatures.find_threshold(RULES.alarm.mechanism_level) if scores else float("inf")
    return changes, Evidence(noise_fit, signatures, p_value, threshold, test_patterns(noise_fit), plain=noise_fit)


def _test_again(changes: Secants, noise: Hypothesis, *, in_doubt: bool) -> float:
    """Probability of what the search finds by chance under the weights that the likelihood gives a hypothesis of noise, or of a lag."""
    signatures = compute_signatures(changes, noise.model)
    scores = find_best_scores(signatures)
    if not scores:
        return 1.0
    found = scores[0].statistic
    spread = RULES.detectable.noise_spread
    return signatures.compute_p_in_doubt(found, spread) if in_doubt else signatures.compute_p(found)


def _is_all_there_is(lag: ExtendedFit, posterior: Posterior, beside: Secants) -> bool:
    """Whether the lag of the amplifier does best alone, and what the search finds beside it is chance: as little a doubt about it as where no
    amplifier lags.
    """
    first = posterior.hypotheses[0]
    return (
        first.causes == lag.of.mechanism_ids
        and _test_again(beside, first, in_doubt=True) >= RULES.alarm.mechanism_level
    )


def _fit_under_noise(of: Extended, start: Float) -> ExtendedFit:
    """The plain model at its optimum under the noise alone, with a simulation whose nodes are about its film."""
    of = replace(of, model=of.model.free_actuation(start, RULES.prior.contradicted))
    found = of.refine(of.fit(start, most=_FEW_STEPS))
    film = of.model.physical(found.theta)
    of = replace(of, simulation=of.simulation.about(film).measured_against(film))
    return ExtendedFit(of, found.solution)


def _find_better_plain(evidence: Evidence) -> Float | None:
    """Entries (P,) at which the plain model does better than where it was left; None where there are none.

    A search that ended early looks like a discrepancy. The plain model is begun anew from where its tempered fit has
    gone and from the films of the best mechanisms; under the weights of the search only where these gain little more than that could be.
    """
    plain, noise_fit, rules = evidence.plain, evidence.noise_fit, RULES.plain
    if plain is noise_fit:
        return None
    causes = evidence.singles[:2]
    again = min((noise_fit.of.fit(f.theta) for f in (plain, *causes)), key=lambda f: f.chi2)
    if again.chi2 < rules.restart_share * noise_fit.chi2:
        return again.theta
    if not causes or plain.chi2 - causes[0].chi2 > rules.restart_asked * evidence.threshold:
        return None
    best = min((plain.of.fit(f.theta) for f in causes), key=lambda f: f.chi2)
    return best.theta if best.chi2 < plain.chi2 - rules.restart_chi2 else None


def _propose_recording(evidence: Evidence) -> NextRecording | None:
    """The recording that would tell the credible hypotheses apart."""
    best, final = evidence.best, evidence.final
    if best is None or final is None:
        return None
    rivals = [
        Rival(
            h.region.plain if h.region and h.beside else h.fit or evidence.plain,
            h.region,
            2 * (best.log_joint - h.log_joint),
        )
        for h in evidence.credible
        if h is not best
    ]
    return propose_separating(final, rivals)
