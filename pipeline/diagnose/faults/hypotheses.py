"""The faults that one recording may have, each with what it changes, what levels it moves, and what would put it right."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp

from pipeline.diagnose.faults import fault as ids
from pipeline.diagnose.faults.fault import say_times
from pipeline.diagnose.faults.levels import DRIVE, NOISE, RATE, SENSED, STRAIN, TENSION, Levels, log_likelihood_of
from pipeline.diagnose.faults.predict import Prediction, Suspect
from pipeline.diagnose.mechanisms.sensor import GAIN_ERROR, SENSOR_SATURATION
from pipeline.diagnose.rules import RULES
from pipeline.transform.calibration import GRAVITY_M_PER_S2
from schemas.arrays import Float
from schemas.numbers import significant

SOUND, MECHANISM = "", "mechanism"
"""What is no fault: the recording is as it should be; the film or the rig does there what the plain model does not."""
ANOTHER_FILM = "its film is not that of the others"
"""What is said of a foreign recording."""
ANOTHER_RIG = "another clamp and load cell are at work than the metadata name, with the film of the others"
"""What is said of a recording that was made on another rig than its metadata name."""
_POUND_FORCE, _EFFECTIVE = 4.4482216, 2.0**0.5
"""N of a pound-force; amplitude over effective value of a sinusoid."""
_FORCE_SLIPS = (
    1e3,
    1e-3,
    GRAVITY_M_PER_S2,
    1 / GRAVITY_M_PER_S2,
    1e3 / GRAVITY_M_PER_S2,
    _POUND_FORCE,
    1 / _POUND_FORCE,
)
"""Recorded over true force where a file says N of mN, kN, kgf, gf, lbf, or the other way round."""
_TRAVEL_SLIPS = (1e3, 1e-3, 25.4, 1 / 25.4)
"""The same of displacements in µm, m and inches."""
_COMMON_SLIPS = (2.0, 0.5, 10.0, 0.1, 100.0, 0.01, 2 * _EFFECTIVE, 1 / (2 * _EFFECTIVE), _EFFECTIVE, 1 / _EFFECTIVE)
"""Of amplitude, peak to peak and effective value for one another, and of ranges and probes ten times off."""
_STRETCHES = (2.0, 0.5, 10.0, 0.1)
"""Claimed over true time where a rate was entered wrongly."""
_LATEST_S, _FASTEST = 0.02, 2e-3
"""Longest delay and largest drift between two channels that are searched."""
_EXACT = 1e-6
"""Share of the distance of two places to which a continuous parameter is found."""
_OF_FILM = 4
"""Parameters of a film of its own that one recording shows."""
OF_RIG = 3
"""Parameters of a rig of its own: mass, stiffness and damping."""
_NOTHING_LEFT = 0.02
"""Response over that predicted below which hardly any is left."""
_NOT_SIMULATED = 0.1
"""How often a recording with a wrong clock shows what its simulation with that clock does not."""
_PROMISING = 0.05
"""Share of χ² that a drift must come down to for it to be followed through the functionals."""
_PLACES = 41
"""Places of a continuous parameter at which its search begins."""


@dataclass(frozen=True)
class Hypothesis:
    """One way in which a recording may be wrong.

    Parameters
    ----------
    cause : id of the fault, or one of the two that are none
    detail : which channel and by how much, in words
    predict : what the recording would show, None where that may be anything
    own_chi2 : χ² of the recording where it may be anything; that of the noise where it is not given
    may_open : of levels, those that may be as in the other recordings or anywhere
    log_prior : of this fault with this parameter
    free : number of continuous parameters, those of a film of its own included
    shifts, open_levels, flipped : of levels, as `Levels.log_likelihood` takes them
    shows : what of the samples themselves it explains: `flat`, `held`, `foreign`, `rig`
    channel, factor : of which channel samples were multiplied by what
    late : delay and drift of the output
    stretch : claimed over true time
    """

    cause: str
    detail: str
    predict: Callable[[], Prediction | None] | None
    log_prior: float
    free: int = 0
    shifts: Mapping[str, float] = field(default_factory=dict)
    open_levels: frozenset[str] = frozenset()
    may_open: frozenset[str] = frozenset()
    own_chi2: Callable[[], float] | None = None
    flipped: bool = False
    shows: frozenset[str] = frozenset()
    channel: str = ""
    factor: float = 1.0
    late: tuple[float, float] = (0.0, 0.0)
    stretch: float = 1.0


@dataclass(frozen=True)
class Mechanisms:
    """What is believed of mechanisms beforehand.

    Parameters
    ----------
    any_way : probability that one shows in the recording in whatever way
    as_film : that one makes another film of it there, as a softening does
    as_scale : that one makes the film softer or stiffer there by one factor, as what happens once to it does
    as_delay : that one makes the force late there, as a slow sensor does
    """

    any_way: float
    as_film: float = 0.0
    as_scale: float = 0.0
    as_delay: float = 0.0


def list_hypotheses(suspect: Suspect, levels: Levels, mechanisms: Mechanisms) -> Iterator[Hypothesis]:
    """All that may be wrong with a recording, and that nothing is."""
    prior = float(np.log(RULES.fault.prior))
    if levels.own_rig:
        words = "the others' rig explains it, the rig that its metadata name does not"
        yield Hypothesis(ids.FOREIGN_RIG, words, lambda: suspect.sound, prior, shows=frozenset({"rig"}))
    else:
        yield Hypothesis(SOUND, "", lambda: suspect.sound, 0.0)
        # A drive that lags in all tests under voltage looks like a rig of their own.
        if not (suspect.is_electrical and mechanisms.as_delay > 0):
            yield Hypothesis(ids.FOREIGN_RIG, ANOTHER_RIG, None, prior, OF_RIG, own_chi2=lambda: suspect.own_rig_chi2)
    yield Hypothesis(MECHANISM, "", None, 0.0)
    size = _weigh_size(suspect, suspect.sound, RULES.fault.mechanism_scale)
    for probability, free, own_chi2 in (
        (mechanisms.as_film, _OF_FILM, lambda: suspect.own_film_chi2),
        (mechanisms.as_scale, 1, lambda: suspect.scaled_film_chi2),
    ):
        if probability > 0:
            yield Hypothesis(MECHANISM, "", None, float(np.log(probability)) + size, free, own_chi2=own_chi2)
    yield from _scales(suspect, prior)
    yield from _delays(suspect, prior, mechanisms.as_delay)
    yield from _stretches(suspect, levels, prior)
    if not suspect.is_electrical:
        yield Hypothesis(
            ids.CHANNELS_SWAPPED,
            "force and displacement are in each other's place",
            suspect.swap,
            prior,
            open_levels=frozenset({STRAIN, RATE, TENSION, NOISE + "force", NOISE + "displacement"}),
        )
        for factor, weight in ((None, 0.5), (2.0, 0.25), (0.5, 0.25)):
            strain = levels.by_name.get(STRAIN)
            if strain is not None:
                shift = strain.value if factor is None else -float(np.log(factor))
                stated = float(np.exp(-shift))
                yield Hypothesis(
                    ids.STRAIN_WRONG,
                    f"strain_pp says {significant(stated, 3)} times the strain that was driven",
                    lambda: suspect.sound,
                    prior + float(np.log(weight)),
                    1 if factor is None else 0,
                    {STRAIN: shift},
                    factor=stated,
                )
    output = "force"
    dead = partial(suspect.scale, {output: 0.0})
    yield Hypothesis(
        ids.DEAD_CHANNEL, f"the {output} shows nothing but noise", dead, prior,
        open_levels=frozenset({TENSION, NOISE + output}), channel=output, factor=0.0,
    )  # fmt: skip

    def beside() -> float:
        """What is lost may as well lie where nothing is asked of the recording."""
        return min(suspect.sound_chi2, float(suspect.size))

    if levels.held:
        name, share = max(levels.held.items(), key=lambda item: item[1])
        yield Hypothesis(
            ids.DEAD_CHANNEL,
            f"the {name} stands still through {significant(100 * share, 2)} % of the record",
            None, prior, 1, open_levels=frozenset({TENSION, NOISE + name} if name == output else set()),
            may_open=frozenset({NOISE + name} if name != output else set()),
            own_chi2=beside, shows=frozenset({"held", "flat"}), channel=name,
        )  # fmt: skip
    if levels.flat > 0:
        yield Hypothesis(
            SENSOR_SATURATION.id,
            f"{significant(100 * levels.flat, 2)} % of the samples of the {levels.clipped} lie on a flat top",
            None, prior, 1, open_levels=frozenset({TENSION if levels.clipped == output else STRAIN}),
            own_chi2=beside, shows=frozenset({"flat", "held"}), channel=levels.clipped,
        )  # fmt: skip
    own = frozenset({TENSION, SENSED, NOISE + "force", NOISE + "displacement", NOISE + "voltage"})
    # Of another rig it may show anything; of the same one it shows a film, and perhaps the same noise.
    foreign = Hypothesis(
        ids.FOREIGN_RECORDING, ANOTHER_FILM, None, prior, _OF_FILM, may_open=own, shows=frozenset({"foreign", "rig"})
    )
    if levels.own_rig or levels.foreign:
        yield replace(foreign, open_levels=own, may_open=frozenset())
        return
    for log_share, free, own_chi2 in _list_other_films(suspect):
        yield replace(foreign, log_prior=prior + log_share, free=free, own_chi2=own_chi2)


def _list_other_films(suspect: Suspect) -> list[tuple[float, int, Callable[[], float]]]:
    """What another specimen's film may be: any, or like this one and softer or stiffer by one factor, as those of one material are.

    Returns
    -------
    Log of the share of all other films with how large the recording's features are, free parameters, χ²
    """
    share = float(np.log(0.5)) + _weigh_size(suspect, suspect.sound, RULES.fault.foreign_scale)
    return [(share, _OF_FILM, lambda: suspect.own_film_chi2), (share, 1, lambda: suspect.scaled_film_chi2)]


def _scales(suspect: Suspect, prior: float) -> Iterator[Hypothesis]:
    channels: dict[str, tuple[float, ...]] = {"force": _FORCE_SLIPS}
    channels |= {"voltage": ()} if suspect.is_electrical else {"displacement": _TRAVEL_SLIPS}
    for channel, slips in channels.items():
        every = (*slips, *_COMMON_SLIPS)
        for factor in every:
            yield _scale(suspect, channel, factor, ids.UNIT_SLIP, prior - float(np.log(len(every) * len(channels))), 0)
        if channel == "voltage":
            continue  # its square acts: a sign does not show
        yield _scale(suspect, channel, -1.0, ids.SIGN_FLIPPED, prior - float(np.log(2)), 0)
        found = _search(partial(_scale_by, suspect, channel), suspect, np.linspace(-1.5, 1.5, _PLACES))
        yield _scale(suspect, channel, float(np.exp(found)), GAIN_ERROR.id, prior - float(np.log(2)), 1)


def _scale_by(suspect: Suspect, channel: str, log_factor: float) -> Prediction:
    return suspect.scale({channel: float(np.exp(log_factor))})


def _scale(suspect: Suspect, channel: str, factor: float, cause: str, log_prior: float, free: int) -> Hypothesis:
    shift = float(np.log(abs(factor)))
    shifts = {NOISE + channel: shift}
    if channel == "force":
        shifts[TENSION] = shift
    shifts |= {STRAIN: shift} if channel == "displacement" else {DRIVE: shift} if channel == "voltage" else {}
    words = "has the opposite sign" if factor == -1.0 else f"is recorded {say_times(factor)}"
    return Hypothesis(
        cause, f"the {channel} {words}", partial(suspect.scale, {channel: factor}), log_prior, free, shifts,
        flipped=channel == "force" and factor < 0, channel=channel, factor=factor,
    )  # fmt: skip


def _delays(suspect: Suspect, prior: float, as_mechanism: float) -> Iterator[Hypothesis]:
    grid = _spread(_LATEST_S, 1e-6)
    late = _search(lambda x: suspect.delay(x, 0.0), suspect, grid)
    skew = Hypothesis(
        ids.CHANNEL_SKEW, f"the force is stamped {significant(1e3 * late, 3)} ms late", partial(suspect.delay, late, 0.0),
        prior, 1, channel="force", late=(late, 0.0),
    )  # fmt: skip
    yield skew
    if as_mechanism > 0:
        yield replace(skew, cause=MECHANISM, log_prior=float(np.log(as_mechanism)))
    drift = _search(lambda x: suspect.delay(0.0, x), suspect, _spread(_FASTEST, 1e-7))
    drifting: Callable[[float], Prediction] = partial(suspect.delay, 0.0)
    if suspect.compute_chi2(drifting(drift)) < _PROMISING * suspect.sound_chi2:
        drifting = suspect.follow_drift
        drift = _search(drifting, suspect, drift * np.linspace(0.98, 1.02, 5))
    yield Hypothesis(
        ids.CLOCK_DRIFT,
        f"the clock of the force runs {significant(1e6 * abs(drift), 3)} ppm {'ahead of' if drift > 0 else 'behind'} that of the input",
        partial(drifting, drift), prior, 1, channel="force", late=(0.0, drift),
    )  # fmt: skip


def _spread(largest: float, least: float) -> Float:
    """Places of both signs in equal steps of the logarithm, and 0."""
    positive = np.geomspace(least, largest, _PLACES)
    return np.concatenate([-positive[::-1], [0.0], positive])


def _stretches(suspect: Suspect, levels: Levels, prior: float) -> Iterator[Hypothesis]:
    rate = levels.by_name.get(RATE)
    for factor in _STRETCHES:
        yield _stretch(suspect, factor, prior + float(np.log(0.5 / len(_STRETCHES))), 0)
    if rate is not None and abs(rate.value) > rate.sd:
        found = float(np.exp(-rate.value))
        if not suspect.is_electrical and suspect.own.recordings[suspect.number].protocol == "chirp":
            near = -rate.value + np.linspace(-3, 3, 13) * rate.sd
            found = float(np.exp(_search(lambda x: suspect.stretch(float(np.exp(x))), suspect, near)))
        yield _stretch(suspect, found, prior + float(np.log(0.5)), 1)
        if rate.z() > RULES.fault.suspect and suspect.sound_chi2 > RULES.fault.agrees * suspect.size:
            # What it shows of rig and film at such times may be finer than its frequencies are simulated.
            stated = _stretch(suspect, found, prior + float(np.log(_NOT_SIMULATED)), _OF_FILM)
            yield replace(stated, predict=None)


def _stretch(suspect: Suspect, factor: float, log_prior: float, free: int) -> Hypothesis:
    return Hypothesis(
        ids.SAMPLE_RATE_WRONG,
        f"its clock claims {significant(factor, 4)} times the time that passed",
        partial(suspect.stretch, factor), log_prior, free, {RATE: -float(np.log(factor))}, stretch=factor,
    )  # fmt: skip


def _search(predict: Callable[[float], Prediction], suspect: Suspect, places: Float) -> float:
    """Where a continuous parameter makes χ² least: at the best of its places (q,), then between the neighbours of that."""

    def cost(x: float) -> float:
        return suspect.compute_chi2(predict(x))

    best = int(np.argmin([cost(float(x)) for x in places]))
    low, high = sorted((float(places[max(best - 1, 0)]), float(places[min(best + 1, places.size - 1)])))
    found = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": _EXACT * (high - low)})
    return float(found.x)


@dataclass(frozen=True)
class Judged:
    """A hypothesis with its χ² (that of the noise where it may be anything) and its log posterior, not normalised."""

    hypothesis: Hypothesis
    chi2: float
    log_posterior: float


def _weigh_mechanism(suspect: Suspect, predicted: Prediction, chi2: float, mechanism: float) -> float:
    """Log probability of a recording under a mechanism that has its way beside what is predicted.

    It is known by no more than how often it is there, that it is smooth, so that a few modes make it up, each as likely to be large as
    another, and that it does not change the response by much.
    """
    common = _weigh_size(suspect, predicted, RULES.fault.mechanism_scale)
    modes = RULES.form.modes
    excess = max(suspect.temper(chi2) - suspect.temper(suspect.size), 2.0)
    spread = 0.5 * modes * float(np.log1p(excess / modes))
    return float(np.log(mechanism)) - 0.5 * suspect.temper(suspect.size) - spread + common


def _weigh_size(suspect: Suspect, predicted: Prediction, usual: float) -> float:
    """Log likelihood of how large a recording's features are over those predicted, less that of a mechanism that changes nothing.

    Parameters
    ----------
    usual : logarithm of the factor that is usual
    """
    scale = suspect.measure_scale(predicted)
    if scale <= _NOTHING_LEFT:
        return float(np.log(RULES.fault.unmistakable))
    return log_likelihood_of(float(np.log(scale)) / usual) - float(np.log(usual / RULES.fault.mechanism_scale))


def _weigh_parameter(suspect: Suspect) -> float:
    """What the data take off the log probability of a hypothesis for each of its free parameters: half the logarithm of how much better
    they know it than beforehand."""
    if not suspect.size:
        return 0.5 * float(np.log(2.0))
    return 0.5 * float(np.log(max(suspect.temper(suspect.sound_chi2) - suspect.temper(suspect.size), 2.0)))


def weigh_another_film(suspect: Suspect) -> float:
    """Log probability, beforehand, that a recording is of another film, less what that film's free parameters take off it, and what a film like
    this one leaves more than any film."""
    least = suspect.temper(suspect.own_film_chi2)
    each = [
        share - free * _weigh_parameter(suspect) - 0.5 * (suspect.temper(chi2()) - least)
        for share, free, chi2 in _list_other_films(suspect)
    ]
    return float(np.log(RULES.fault.prior) + logsumexp(each))


def _measure_chi2(suspect: Suspect, hypothesis: Hypothesis, predicted: Prediction | None) -> float:
    if predicted is not None:
        return suspect.compute_chi2(predicted)
    return float(suspect.size) if hypothesis.own_chi2 is None or not suspect.size else hypothesis.own_chi2()


def judge_hypotheses(
    suspect: Suspect, levels: Levels, mechanisms: Mechanisms, others: Sequence[Levels] = ()
) -> Sequence[tuple[Judged, float]]:
    """Hypotheses with their posterior probabilities, the most probable first.

    Parameters
    ----------
    suspect : a recording, or several of one protocol that may have a fault in common
    levels, others : of the recording, and of the others where it is several
    mechanisms : what is believed of those that may show there
    """
    rules, judged = RULES.fault, []
    seen = {
        "flat": levels.flat > rules.flat,
        "held": max(levels.held.values(), default=0.0) > rules.held,
        "foreign": levels.foreign,
        "rig": levels.own_rig,
    }
    for h in list_hypotheses(suspect, levels, mechanisms):
        predicted = None if h.predict is None else h.predict()
        if h.predict is not None and predicted is None:
            continue
        chi2 = _measure_chi2(suspect, h, predicted)
        total = h.log_prior - h.free * _weigh_parameter(suspect)
        if h.cause == MECHANISM and h.predict is None and h.own_chi2 is None:
            total += _weigh_mechanism(suspect, suspect.sound, suspect.sound_chi2, mechanisms.any_way)
        elif predicted is None or h.cause == SOUND:
            total -= 0.5 * suspect.temper(chi2)
        else:  # what a fault or a delay leaves may be a mechanism, as it may be without one
            beside = _weigh_mechanism(suspect, predicted, chi2, mechanisms.any_way)
            total += float(np.logaddexp(-0.5 * suspect.temper(chi2), beside))
        total += sum(
            own.log_likelihood(h.shifts, open_levels=h.open_levels, may_open=h.may_open, flipped=h.flipped)
            for own in (levels, *others)
        )
        total += sum(
            float(np.log(rules.unmistakable)) for name, is_seen in seen.items() if is_seen and name not in h.shows
        )
        judged.append(Judged(h, chi2, total))
    log = np.array([j.log_posterior for j in judged])
    probability = np.exp(log - log.max())
    probability /= probability.sum()
    order = np.argsort(-probability)
    return [(judged[i], float(probability[i])) for i in order]
