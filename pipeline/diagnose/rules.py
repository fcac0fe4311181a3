"""Every number by which the diagnosis decides something, in one place: with meaning, unit and what calibrated it.

`RULES.<step>.<rule>` is a number; `list_rules` gives all of them with their words, from which the table in this
package's README is written. Numerical tolerances (steps of a derivative, rounds of an iteration, sizes of a grid that
is fine enough) decide nothing and stand where they are used. A case that goes wrong asks for a better model, not for
another number here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

from schemas.explanations import CREDIBLE
from schemas.places import LEVEL

NOT_CALIBRATED = "not calibrated"
STUDY = "study of hidden effects (`tests/studies/results.md`)"
TEMPERING = f"{STUDY}, starting from 10 to 20 % of a block's misfit"
BAYES_100 = "theory: odds of 100 to 1 (ln 100), decisive on Jeffreys' scale"
RIGS = "sessions of rigs written apart (`tests/studies/results.md`)"
CLEAN = "clean sessions of two rigs (`tests/hidden_effects/test_faults.py`)"
COST = "time of a diagnosis; no verdict of the study changed"


def _rule(value: Any, meaning: str, calibration: str = NOT_CALIBRATED, unit: str = "1") -> Any:
    """A field of a frozen dataclass with its words."""
    return field(default=value, metadata={"meaning": meaning, "calibration": calibration, "unit": unit})


@dataclass(frozen=True)
class FeatureRules:
    """What of a recording is used as features."""

    chirp_rest: int = _rule(32, "fewest samples of rest before a chirp that give its noise", unit="samples")
    cyclic_rest: int = _rule(8, "fewest samples of rest before cycles that give their noise", unit="samples")
    ramp_rest: int = _rule(8, "fewest samples of rest before a ramp that give its noise", unit="samples")
    step_rest: int = _rule(16, "fewest samples of rest before voltage steps that give their noise", unit="samples")
    noise_samples: int = _rule(16, "fewest samples of a rest that say anything of the noise", unit="samples")
    hum_rest: float = _rule(0.3, "shortest rest in which mains are looked for", unit="s")
    per_cycle: int = _rule(10, "fewest samples per cycle of which harmonics are taken", unit="samples")
    per_turn: float = _rule(
        5.0, "fewest samples per turn of the clamp at which its ringing after an edge is followed", RIGS, "samples"
    )
    most_cycles: int = _rule(400, "most cycles of a recording that are taken one by one", COST, "cycles")
    most_groups: int = _rule(24, "most groups of voltage steps that are taken one by one", COST, "groups")
    ramp_windows: int = _rule(4, "fewest windows of a hold that are worth having", unit="windows")
    periods: int = _rule(3, "fewest whole periods of an SPHS that give its response", unit="periods")
    line_input: float = _rule(1e-3, "least input of a line over the largest for the line to count as excited")
    sphs_command: float = _rule(
        0.1, "least line of the command over the largest at which voltage over command is taken"
    )
    step_command: float = _rule(0.05, "least step of the command at which voltage over command is taken", unit="V")
    same_level: float = _rule(0.02, "relative difference of voltages within which steps have one level")
    most_lost: float = _rule(0.2, "share of the samples that may be lost before a recording is refused")
    clear_response: float = _rule(0.3, "least |1 + (−Mω² + jωc)/kL| at which a response says anything of the film")
    own_noise_count: float = _rule(
        8.0, "fewest independent ordinates of a rest that may have its own noise", unit="ordinates"
    )
    own_noise: float = _rule(
        3.5, "standard deviations by which a rest must miss the session's noise to have its own", unit="SD"
    )
    permittivity_sd: float = _rule(0.1, "relative standard deviation of the permittivity where the metadata give none",
                                   "metadata: 10 % if absent")  # fmt: skip
    amplifier_sd: float = _rule(
        0.01, "relative standard deviation of the amplifier's gain where the rig file gives none"
    )
    weight_sd: float = _rule(
        7.6e-4,
        "relative standard deviation of the force of a known mass, where standard gravity stands for the local one",
        "theory: 9.793 to 9.819 m/s² between 30° and 60° of latitude (Somigliana's formula)",
    )
    mains_level: float = _rule(1e-4, "probability of the rests under no mains below which mains are in the model")


@dataclass(frozen=True)
class PlainRules:
    """The plain model: its order and its optimum."""

    orders: tuple[int, ...] = _rule(
        (1, 2, 3), "numbers of arms that are tried", "Maxwell–Wiechert models of the thesis", "arms"
    )
    arm_worth: float = _rule(16.0, "fall of χ², in units of the misfit that stays, for which another arm is taken",
                             "theory: tail of a search over the arm's place at 0.1 %", "χ²")  # fmt: skip
    sound: float = _rule(1.3, "χ² per value at which no other start can do clearly better")
    same_optimum: float = _rule(1e-4, "share of χ² within which ends of searches are one optimum")
    same_optimum_chi2: float = _rule(0.1, "χ² within which ends of searches are one optimum", unit="χ²")
    agreeing: int = _rule(3, "ends of searches in one optimum after which no other start is tried", COST, "searches")
    astray: float = _rule(1000.0, "χ² per value from which a search is begun anew with other clamps")
    clamps: int = _rule(3, "clamps of other masses that are tried then", unit="clamps")
    restarts: int = _rule(
        3, "times at most that the plain model is begun anew where the search for causes found better", unit="times"
    )
    restart_share: float = _rule(0.9, "share of χ² below which the plain model was not at its optimum")
    restart_chi2: float = _rule(1.0, "fall of the tempered χ² for which it is begun anew", unit="χ²")
    restart_asked: float = _rule(
        10.0, "Λ over its threshold up to which causes might stem from a plain model short of its optimum"
    )


@dataclass(frozen=True)
class AlarmRules:
    """Is there anything? Levels of false alarm, and the screen by signatures."""

    mechanism_level: float = _rule(0.002, "false-alarm level of the search over the listed mechanisms",
                                   f"{STUDY}: 1 of 586 clean sessions alarmed")  # fmt: skip
    pattern_level: float = _rule(
        1e-5, "the same for smooth patterns, whose noise is known less well", f"{STUDY}, same sessions"
    )
    left_level: float = _rule(1e-3, "probability of a pattern on the tempered scale below which it stays", STUDY)
    confirmed: float = _rule(
        0.8, "share of the threshold of Λ that a fit must reach which the screen only promised", STUDY
    )
    visible: float = _rule(0.05, "length of a signature below which a mechanism leaves no trace", unit="SD")
    severity_levels: int = _rule(3, "severities of a parameter at which signatures are taken", COST, "points")
    weak_part: float = _rule(0.01, "part of the lowest severity at which the signature of a weak effect is taken")
    shape_places: tuple[tuple[float, ...], ...] = _rule(
        ((0.1, 0.5, 0.9), (0.2, 0.8), (0.5,)),
        "places in the ranges of the first, second and later shapes for signatures",
        COST,
    )
    least_part: float = _rule(0.2, "least part of a strong effect's signature for which a score may stand", STUDY)


@dataclass(frozen=True)
class TemperRules:
    """Model-form error: how wrong the form of a right mechanism may be."""

    share: float = _rule(0.15, "share of a block's misfit that a form which is not quite right may leave", TEMPERING)
    outlier: float = _rule(3.0, "misfit of a block from which it counts for less in the film of the extended model",
                           unit="SD of its χ²")  # fmt: skip


@dataclass(frozen=True)
class FitRules:
    """Which mechanisms are fitted, from where, and how far."""

    mechanisms: int = _rule(8, "mechanisms of the screen that are fitted at least", STUDY, "mechanisms")
    variants: int = _rule(2, "variants of a mechanism that are fitted at most", COST, "variants")
    close_further: float = _rule(
        0.5, "share of the best mechanism's score from which another is fitted beside the causes so far", COST
    )
    close_variant: float = _rule(0.5, "share of the best variant's score that the second must have", COST)
    starts: int = _rule(
        3, "starts, beside the screen's own, of a mechanism whose place the plain model can take", STUDY, "starts"
    )
    onset_starts: tuple[float, ...] = _rule((0.1, 0.3, 1.0, 4.0), "severities, over the lowest plausible one, from which a mechanism "
                                            "with an onset is searched", STUDY)  # fmt: skip
    followed: int = _rule(2, "searches of one mechanism that go on after a few steps", COST, "searches")
    astray: float = _rule(10.0, "χ² over that of the base from which a start is given up", COST)
    strong: float = _rule(3.0, "χ² per value of the base from which no start is given up", STUDY)
    amplifier_left: float = _rule(
        0.1,
        "χ² of the measured voltages that a lag may leave, over that without it, where all else is asked beside it",
    )
    vanished: float = _rule(0.01, "share of its stiffness below which an arm has vanished and is tried again")
    still_falling: float = _rule(
        0.01, "share of what a mechanism explains that a round of steps must add for another round", COST
    )
    hopeless: float = _rule(
        10.0, "times what the screen or the last round promised that a fit is not expected to exceed", STUDY
    )
    near_of_explained: float = _rule(
        0.3, "χ² above the best mechanism's, over what that explains, from which another is given up", STUDY
    )
    near_of_left: float = _rule(0.7, "the same over what the best leaves beyond the noise", STUDY)
    close_call: float = _rule(
        12.0, "log evidence behind the best within which a search is brought to its optimum", unit="ln"
    )
    close_call_share: float = _rule(0.02, "the same, as a share of the best log evidence")
    bent: float = _rule(
        20.0,
        "log likelihood by which the film that most recordings agree on must be better to be searched from",
        COST,
        "ln",
    )
    from_consensus: int = _rule(5, "mechanisms that are fitted from there at least", COST, "mechanisms")
    settled: int = _rule(
        6, "hypotheses that are brought to the optimum under their own weights at most", COST, "hypotheses"
    )
    settled_chi2: float = _rule(0.1, "fall of χ² below which an optimum is confirmed", unit="χ²")
    settled_share: float = _rule(2e-4, "the same, as a share of χ²")


@dataclass(frozen=True)
class CauseRules:
    """How further causes are looked for beside the first."""

    close: float = _rule(
        4.6, "difference of log evidence within which causes cannot be told apart (9.2 of Λ)", BAYES_100, "ln"
    )
    most: int = _rule(3, "causes that are named together at most", "given: at most three", "causes")
    bases: int = _rule(2, "best single mechanisms on which a second one is tried", COST, "mechanisms")
    level: float = _rule(1e-3, "false-alarm level of a further cause", STUDY)


@dataclass(frozen=True)
class FormRules:
    """How wrong the form of a model may be: the likelihood of all hypotheses."""

    modes: float = _rule(6.0, "smooth modes of a group of features by which a form is wrong", RIGS, "modes")
    shares: tuple[float, ...] = _rule(
        (0.01, 0.03, 0.1, 0.3),
        "shares of its own effect by which the form of a hypothesis may be wrong, each as likely",
        RIGS,
    )
    bends: tuple[float, ...] = _rule(
        (0.03, 0.1, 0.3),
        "shares of its effect by which a cause may depend in another way on what it depends on, each as likely",
        RIGS,
    )
    bent: float = _rule(0.5, "probability that it does")
    louder: tuple[float, ...] = _rule(
        (1.5, 2.0, 3.0), "noise of a test over that of its rests", "driven noise of rigs written apart", "SD"
    )
    noisy: float = _rule(0.03, "probability that a test is as noisy as that", RIGS)
    drifting: float = _rule(0.03, "probability that a group drifts as no rest shows", RIGS)
    widest_drift: float = _rule(100.0, "largest variance of such a drift", RIGS, "variances of the noise")
    drift_modes: float = _rule(2.0, "smooth modes by which a force over time drifts", RIGS, "modes")
    session: float = _rule(
        0.03, "probability of a session that drifts as no rest shows, and of one noisier than its rests", RIGS
    )
    many: float = _rule(
        0.5, "probability that a group drifts, or a test is noisy, in such a session", "as often as not"
    )
    outlier: float = _rule(0.01, "probability that a group is wrong by something else", RIGS)
    widest: float = _rule(1e9, "largest variance of such a group", unit="variances of the noise")


@dataclass(frozen=True)
class PriorRules:
    """What is believed beforehand."""

    plain: float = _rule(0.5, "that nothing is beside the plain model but noise")
    anything: float = _rule(0.05, "that it is something that nobody has thought of, in a few groups of features")
    listed: float = _rule(0.4, "that one of the listed causes is, each as likely, and its variants alike")
    contradicted: float = _rule(
        4.0, "deviation of the actuation from what sizes and permittivity say, from which these are wrong", unit="SD"
    )
    further: float = _rule(0.05, "that another of them is beside it")
    unnamed: float = _rule(0.05, "that it is something without a name in one of the regions")


@dataclass(frozen=True)
class VerdictRules:
    """From probabilities to one of the four verdicts."""

    credible: float = _rule(CREDIBLE, "probability of what is named, and of the set that is possible", "given: 95 %")
    listed: float = _rule(
        0.5, "probability of all listed causes together below which the verdict is `unknown`", "given: 50 %"
    )
    told_pattern: float = _rule(1e-3, "probability of a pattern below which it is told")
    closest: float = _rule(
        0.5, "share of the misfit from which the listed cause that takes it away is told beside `unknown`"
    )


@dataclass(frozen=True)
class AdequacyRules:
    """When a simulation is not adequate: the one rule, for sessions and for records that are asked alone (`adequacy`)."""

    level: float = _rule(
        LEVEL,
        "probability that the noise makes one of all places as wrong, below which a place is beyond it; so is a record that is asked alone",
    )
    something_else: float = _rule(
        0.5,
        "probability that a group of features is wrong by something else, above which nothing is named without doubt",
        "more probable than not",
    )
    left: float = _rule(
        0.05,
        "share of the misfit of a record asked alone that a cause may leave to be named, where that is more than noise",
        "a measured Duffing circuit leaves 0.022 and 0.001 with the cause it was built with, two simulated integrators 0.29 and 0.26 with none",
    )
    at_limit: float = _rule(0.99, "share of the way to a limit of a severity from which a fit has ended there", CLEAN)


@dataclass(frozen=True)
class GainRules:
    """Held-out gain: which parts are left out, and when a share is stated."""

    shows: float = _rule(0.1, "share of the causes' trace from which a protocol counts as one that shows them")
    touched: float = _rule(1e-3, "share of the causes' trace below which a block is not asked")
    removable: float = _rule(
        1.5, "excess of the plain model's held-out χ² below which no gain is stated", unit="SD of χ²"
    )
    least_told: float = _rule(
        0.1,
        "held-out gain below which causes explain nothing: what is there is in no list",
        "rigs written apart: of 23 sessions that told causes below it the first was right in 5, and 15 had an effect in no list",
    )
    listed_below: float = _rule(
        0.22,
        "probability, below it, that a listed cause is what is there",
        "rigs written apart: 5 of the same 23 sessions",
    )
    least_named: float = _rule(
        0.5,
        "held-out gain below which causes are not named without doubt",
        "rigs written apart: of sessions that were named, 1 of 10 was right below it and 109 of 141 above",
    )
    most_variance: float = _rule(
        1.0, "mean variance of a prediction over the noise up to which a part can be predicted"
    )
    most_parts: int = _rule(5, "parts into which one protocol is dealt at most", COST, "parts")
    supports: float = _rule(
        9.0, "fall of χ² within a protocol that counts as support", "theory: three standard deviations", "χ²"
    )


@dataclass(frozen=True)
class DetectableRules:
    """Smallest detectable severities, and what a page lists as wrong."""

    power: float = _rule(0.8, "probability with which a smallest detectable severity would be found", "given: 80 %")
    shapes: float = _rule(0.8, "share of the plausible shapes in which it would be")
    beyond: float = _rule(2.0, "times the plausible range beyond which no severity is given")
    noise_spread: float = _rule(
        0.3, "relative standard deviation of the variance of a block's noise", "length of a usual rest"
    )
    spans: int = _rule(3, "bands or spans of time into which a block is split", unit="spans")
    split_from: int = _rule(12, "values from which a block is split", unit="values")
    stays_level: float = _rule(1e-6, "probability below which what causes leave at a place is told")
    stays_rms: float = _rule(3.0, "times the noise from which it is told", unit="SD")
    stays_share: float = _rule(0.5, "share of the plain model's χ² there from which it is told")
    most_told: int = _rule(3, "places that are told at most", unit="places")


@dataclass(frozen=True)
class ProposalRules:
    """Which recording is proposed next."""

    form_error: float = _rule(0.15, "share of a predicted difference that counts as noise", TEMPERING)
    undecided: tuple[float, ...] = _rule((0.5, 0.1, 0.03), "probability of leaving causes undecided above which a recording is not "
                                         "proposed; above which much longer and longer ones are tried", STUDY)  # fmt: skip
    most_certain: float = _rule(0.99, "largest probability that is stated")
    shown: float = _rule(1.0, "χ² that causes must add in a recording to show there", unit="χ²")


@dataclass(frozen=True)
class SingleRules:
    """Records that are asked without a session: one large cycle, a system of another kind."""

    explained: float = _rule(0.6, "share of the misfit that a mechanism must explain to be possible", STUDY)
    interval: float = _rule(0.95, "probability of the interval of a gain, and of one model being better than another")
    detectable: float = _rule(2.8, "smallest detectable severity", "theory: 80 % power at a level of 5 %", "SD")
    noise_doubt: float = _rule(
        3.0, "over √n: share by which the noise of a cycle may be louder than its estimate", unit="SD"
    )
    way_back: float = _rule(0.1, "share of the samples of a cycle that the way back must have")
    way_back_span: float = _rule(0.2, "share of the stretch of a cycle that the way back must have")
    unseen: float = _rule(1e-6, "length of a parameter's column over the longest below which a part does not show it")
    form_error: float = _rule(0.15, "share of a predicted difference that counts as noise", TEMPERING)
    decides: float = _rule(9.2, "χ² between causes from which a recording is proposed", BAYES_100, "χ²")
    louder: float = _rule(1.5, "input of the louder half over that of the quieter from which they are two parts")
    driven_alike: float = _rule(0.6, "overlap of spectra from which one part can be predicted from another")
    above_excited: float = _rule(1.25, "frequency over the highest excited one from which the output is noise")
    excited: float = _rule(1e-4, "share of the input's largest power from which a frequency is excited")
    memory: float = _rule(5.0, "decay times over which a residual remembers", unit="decay times")
    shortest: int = _rule(128, "fewest samples of a system's records that can be dealt into parts", unit="samples")
    other_hold: float = _rule(
        0.98,
        "misfit of an input that is held or goes straight between samples, over a band-limited one, below which it counts",
    )
    run_in: float = _rule(1.0, "memory of a system over the length of its records, above which they do not tell it")
    most_steps: int = _rule(100_000, "steps that one simulation of a system may take", COST, "steps")


@dataclass(frozen=True)
class FaultRules:
    """Recordings first: faults of everyday life, before any mechanism is asked."""

    strain_sd: float = _rule(0.05, "relative error of a stated strain that is no fault", CLEAN)
    drive_sd: float = _rule(0.03, "the same of a stated voltage", CLEAN)
    rate_sd: float = _rule(0.005, "the same of a stated frequency of sinusoids", CLEAN)
    sweep_rate_sd: float = _rule(0.015, "the same of the highest frequency of a sweep as it is read", CLEAN)
    sweep_alike_sd: float = _rule(0.008, "the same against other sweeps", CLEAN)
    rest_sd: float = _rule(0.03, "relative scatter of rest force and rest capacitance within a session", CLEAN)
    rest_spread: float = _rule(0.2, "scatter of the others from which rest levels expect nothing")
    noise_sd: float = _rule(0.5, "scatter of the logarithm of a channel's noise between recordings", CLEAN)
    suspect: float = _rule(
        6.0, "deviation of a level from which a recording is left out until it is explained", unit="SD"
    )
    anywhere: float = _rule(3.0, "range of the logarithm of a level that a fault leaves open")
    stray: float = _rule(
        0.05, "probability that a rest level or a noise is another than in the other recordings without a fault", CLEAN
    )
    flat: float = _rule(0.003, "share of a channel's samples on a flat top that is clipping", CLEAN)
    held: float = _rule(0.01, "share of a record in which a channel stands still that is a drop-out", CLEAN)
    unmistakable: float = _rule(1e-6, "probability of a flat top, a drop-out or another film's sizes without the fault")
    misses: float = _rule(6.0, "excess of a recording's χ² over the noise at which it misses the others", unit="SD")
    misses_ratio: float = _rule(2.0, "its χ² per value over that of the others from which it does", CLEAN)
    astray: float = _rule(20.0, "χ² per value from which the films of single sweeps are tried as starts", COST)
    agrees: float = _rule(1.5, "χ² per value up to which recordings agree with each other", CLEAN)
    smoother: float = _rule(
        0.7, "roughness of the film with a corrected rig, over that without, up to which it is tried"
    )
    film_like: float = _rule(0.15, "the same up to which a rig's file is called wrong by the responses alone", CLEAN)
    film_points: float = _rule(20.0, "independent values that speak in it, of any number of responses", CLEAN)
    form_error: float = _rule(0.01, "share of a misfit by which an undone fault may be wrong in form")
    named: float = _rule(0.95, "probability from which a fault is named", "verdicts: named from 0.95")
    prior: float = _rule(
        0.003, "probability of each kind of fault in a recording", "habits of laboratories, not counted"
    )
    no_slip: float = _rule(
        0.5, "probability that sizes are wrong where they promise another actuation by a factor that is no usual slip"
    )
    mechanism_scale: float = _rule(
        0.3, "logarithm of the factor by which a mechanism usually changes a recording's response", unit="SD"
    )
    foreign_scale: float = _rule(
        0.7,
        "the same of another film: of other thickness, width or material",
        "films of one laboratory, not counted",
        "SD",
    )
    mechanism: float = _rule(0.2, "probability of a mechanism that shows in a recording like which there is no other")
    mechanism_beside_peer: float = _rule(1e-4, "the same where another recording like it agrees with all others")
    off: float = _rule(
        5.0, "deviation of a constant from its file or of a size from its promise that is asked", unit="SD"
    )


@dataclass(frozen=True)
class Rules:
    """All rules, by step."""

    features: FeatureRules = FeatureRules()
    fault: FaultRules = FaultRules()
    plain: PlainRules = PlainRules()
    alarm: AlarmRules = AlarmRules()
    temper: TemperRules = TemperRules()
    fit: FitRules = FitRules()
    cause: CauseRules = CauseRules()
    form: FormRules = FormRules()
    prior: PriorRules = PriorRules()
    verdict: VerdictRules = VerdictRules()
    adequacy: AdequacyRules = AdequacyRules()
    gain: GainRules = GainRules()
    detectable: DetectableRules = DetectableRules()
    proposal: ProposalRules = ProposalRules()
    single: SingleRules = SingleRules()


RULES = Rules()
"""The rules in use."""


@dataclass(frozen=True)
class Rule:
    """One rule in words: `name` is step and rule with a dot between, `value` its number or numbers."""

    name: str
    value: str
    unit: str
    meaning: str
    calibration: str


def list_rules(rules: Rules = RULES) -> Iterator[Rule]:
    """All rules with their words, step by step."""
    for step in fields(rules):
        own = getattr(rules, step.name)
        for rule in fields(own):
            words = rule.metadata
            value = _write_value(getattr(own, rule.name))
            yield Rule(f"{step.name}.{rule.name}", value, words["unit"], words["meaning"], words["calibration"])


def _write_value(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(f"({_write_value(v)})" if isinstance(v, tuple) else f"{v:g}" for v in value)
    return f"{value:g}"


def write_table() -> str:
    """The rules as a table in Markdown, for this package's README."""
    rows = ["| rule | value | unit | meaning | calibrated by |", "| --- | --- | --- | --- | --- |"]
    for r in list_rules():
        cells = (f"`{r.name}`", r.value, r.unit, r.meaning.replace("|", "\\|"), r.calibration)
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows)
