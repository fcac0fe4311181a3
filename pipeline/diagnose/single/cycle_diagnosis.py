"""The diagnosis of one large cycle that is alone: what one branch on the equilibrium stress gets wrong of it, and why.

Every mechanism is fitted to the loading and has to predict the unloading (`comparison`). The noise is that of
neighbouring samples, for there is no rest; what is left remembers for long, and counts as few independent values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi2_law

from pipeline.diagnose.features.kinds import CYCLE_FORCE
from pipeline.diagnose.features.records import find_converter_step
from pipeline.diagnose.judge import judge_predictions
from pipeline.diagnose.mechanisms import MECHANISMS, list_invisible
from pipeline.diagnose.results import AMBIGUOUS, NAMED, Diagnosis, Discrepancy, Estimate, NextRecording, Residuals
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.single.comparison import Comparison, TriedModel, compare_predictions
from pipeline.diagnose.single.cycle_model import CycleMechanism, CycleModel, Fitted, LargeCycle, list_mechanisms
from pipeline.diagnose.single.report import (
    Details,
    Films,
    describe_closest,
    describe_what_stays,
    list_smallest,
    report_comparison,
    thin_curves,
)
from pipeline.diagnose.single.still_outputs import bound_variance, dither, find_moving
from pipeline.physics.film import RelaxationModel
from schemas.arrays import Bool, Float, Int
from schemas.mechanisms import plain_name
from schemas.places import WITHIN, is_beyond_noise

STRESS, PREDICTED = "cycle.stress", "cycle.unseen"
"""Kinds of residuals: everything fitted to everything; the unloading as the fit to the loading predicts it."""
_DRAWS, _TRIALS, _SEED = 200, 400, 11
"""Parameters that are drawn from so many trials, and the seed of both."""
_OPEN, _WIDER = 1.0, 1.3
"""Standard deviation of a parameter, most of them logarithms, that the data do not hold; and how much wider is drawn
than is held."""
_NORMAL_90 = 1.645
"""Half width of a 90 % interval of the normal distribution, in standard deviations."""
_PLACES = 4
"""Parts of equal length into which loading and unloading are cut each, to say where the simulation is wrong."""
_HOLD_S, _SLOWER = 600.0, 10.0
"""Hold that is proposed, s, and how many times slower or faster a cycle."""
_SHOWN = 400
"""Samples of each curve that are kept for figures."""
_COMPARED, _FEW = 24, 60
"""Instants at which proposals are compared, and draws that say what is open there."""


@dataclass(frozen=True)
class _Tried:
    """A model fitted to the loading and to everything, with what both fits leave open.

    Parameters
    ----------
    learned, whole : fitted to the loading, and to everything
    drawn_learned, drawn_whole : (B, P) parameters that they leave open
    """

    learned: Fitted
    whole: Fitted
    drawn_learned: Float
    drawn_whole: Float

    @property
    def severity(self) -> dict[str, Estimate]:
        """Estimates from the fit to everything."""
        model = self.whole.model
        drawn = model.severity(self.drawn_whole)
        found = {}
        for key, value in model.severity(self.whole.x).items():
            here, (low, high) = float(value), np.quantile(drawn[key], [0.05, 0.95]).tolist()
            # The best value may lie at the edge of a bent valley, away from most of it.
            found[key] = Estimate(here, (high - low) / (2 * _NORMAL_90), min(low, here), max(high, here))
        return found

    def predict_unloading(self, unloading: Bool, plain: _Tried) -> TriedModel:
        """What it predicts of the unloading: as the plain model where the loading does not show its mechanism."""
        mechanism = self.whole.model.mechanism
        learned, drawn_x = (plain, plain.learned.x[None]) if self.learned.unseen else (self, self.drawn_learned)
        drawn = learned.learned.stress(drawn_x)[:, unloading]
        return TriedModel(
            mechanism="" if mechanism is None else mechanism.id,
            variant="" if mechanism is None else mechanism.variant,
            equation="" if mechanism is None else mechanism.equation,
            severity={} if mechanism is None else self.severity,
            whole=self.whole.stress(),
            unseen=learned.learned.stress()[unloading],
            drawn=drawn,
            at_limit=self.whole.is_at_limit,
        )


def diagnose_cycle(cycle: LargeCycle) -> tuple[Diagnosis, Comparison]:
    """What one branch on the equilibrium stress gets wrong of a large cycle, and which mechanism predicts its
    unloading.

    Parameters
    ----------
    cycle : with its plain fits

    Returns
    -------
    The diagnosis, and the comparison of the mechanisms behind it

    Raises
    ------
    NotIdentifiableError
        where no model has a fit
    """
    up = cycle.loading
    sd = estimate_noise_sd(cycle.stress) * (1 + RULES.single.noise_doubt / np.sqrt(cycle.stress.size))
    span, interval = float(np.ptp(cycle.time_s)), float(np.median(np.diff(cycle.time_s)))
    # Every mechanism is fitted to the loading, and to everything.
    rng = np.random.default_rng(_SEED)
    plain, *others = (_try_mechanism(cycle, m, rng) for m in (None, *list_mechanisms(span, interval)))
    # Those fitted to the loading predict the unloading.
    plain_model, *models = (t.predict_unloading(~up, plain) for t in (plain, *others))
    places = tuple(_list_discrepancies(cycle, (cycle.stress - plain.whole.stress()) / sd, sd))
    comparison = compare_predictions(
        plain_model, models, cycle.stress, cycle.stress[~up], sd, [place.p_value for place in places]
    )
    verdict = judge_predictions(comparison)
    proposal = _propose_recording(cycle, others, comparison, sd) if verdict == AMBIGUOUS else None
    details = _collect_details(cycle, sd, plain, others, comparison, verdict, places, proposal)
    simulated = plain.whole.stress()
    return report_comparison(comparison, verdict, cycle.stress, cycle.stress[~up], sd, simulated, details), comparison


def estimate_noise_sd(values: Float) -> float:
    """Standard deviation of the noise of single values.

    From second differences, robust against corners and steps of time; what a converter's rounding makes of the noise is part of it, and what
    stands exactly still shows none.

    Parameters
    ----------
    values : (m,) of a smooth course with noise
    """
    step, moves = find_converter_step(values), find_moving(values)
    second = np.diff(dither(values, step), 2)[moves[:-2] & moves[1:-1] & moves[2:]]
    scatter = float(np.median(second**2)) / (0.4549 * 6) if second.size else 0.0
    return float(np.sqrt(bound_variance(values, step, scatter - step**2 / 12)))


def _try_mechanism(cycle: LargeCycle, mechanism: CycleMechanism | None, rng: np.random.Generator) -> _Tried:
    model = CycleModel(cycle, mechanism)
    learned, whole = model.fit(cycle.loading), model.fit(np.ones(cycle.time_s.size, dtype=bool))
    return _Tried(learned, whole, _draw_open_parameters(learned, rng), _draw_open_parameters(whole, rng))


def _draw_open_parameters(fit: Fitted, rng: np.random.Generator) -> Float:
    """(B, P) parameters that the fit leaves open, within their limits; as they are where the mechanism is not seen.

    What is left stands for the noise, as few independent values as its memory allows. Drawn from the linear problem,
    with what it does not hold as wide as a factor e, and drawn again by how well they fit: valleys are bent (Rubin
    1987, sampling-importance resampling).
    """
    if fit.unseen:
        return np.tile(fit.x, (_DRAWS, 1))
    n, size = fit.residual.size, fit.x.size
    variance = float(fit.residual @ fit.residual) / max(n - size, 1) * _measure_memory(fit.residual)
    values, vectors = np.linalg.eigh(fit.jacobian.T @ fit.jacobian / variance)
    # What the data do not hold may come out slightly negative beside what they hold 16 digits better.
    root = vectors / np.sqrt(np.maximum(values, 0.0) + 1 / _OPEN**2)
    upper = np.linalg.qr(root.T, mode="r")
    z = rng.standard_normal((_TRIALS, size))
    x = np.clip(fit.x + _WIDER * z @ (np.sign(np.diag(upper))[:, None] * upper), *fit.model.limits)
    log_weight = -0.5 * (fit.misfit(x) / variance + np.sum((x - fit.x) ** 2, axis=1) / _OPEN**2 - np.sum(z**2, axis=1))
    weight = np.exp(log_weight - np.nanmax(log_weight))
    weight[~np.isfinite(weight)] = 0.0
    return np.asarray(x[rng.choice(_TRIALS, _DRAWS, p=weight / weight.sum())])


def _measure_memory(residual: Float) -> int:
    """Values over which a residual remembers: twice those after which its correlation is below 1/e, at most a quarter."""
    r = residual - residual.mean()
    spectrum = np.abs(np.fft.rfft(r, 2 * r.size)) ** 2
    correlation = np.fft.irfft(spectrum)[: r.size]
    below = np.flatnonzero(correlation < np.exp(-1) * correlation[0])
    first = int(below[0]) if below.size else r.size
    return int(np.clip(2 * first, 1, max(r.size // 4, 1)))


def _collect_details(
    cycle: LargeCycle,
    sd: float,
    plain: _Tried,
    others: Sequence[_Tried],
    found: Comparison,
    verdict: str,
    places: tuple[Discrepancy, ...],
    proposal: NextRecording | None,
) -> Details:
    best = found.told
    winner = next(t for t in others if _is_of(t, best.model))
    plain_sd, _ = _estimate_film_sd(plain)
    extended_sd, damper_sd = _estimate_film_sd(winner)
    named = verdict in (NAMED, AMBIGUOUS)
    words, left = (plain_name(best.model.mechanism).lower(), winner) if named else ("one branch", plain)
    return Details(
        specimen_id=cycle.fits.specimen_id,
        protocols=("cycle",),
        left_out={"the unloading": (best.before, best.after)},
        films=Films(
            _make_film(plain.whole.model, plain.whole.x),
            _make_film(winner.whole.model, winner.whole.x),
            plain_sd,
            extended_sd,
            damper_sd,
        ),
        discrepancies=places,
        residuals=(_list_residuals(cycle, plain, winner if named else plain, sd),),
        smallest=list_smallest(p.model for p in found.ranked),
        invisible=tuple(m for m in list_invisible({CYCLE_FORCE}) if m in MECHANISMS),
        could_not_ask=_list_unaskable(sd),
        unexplained=(
            describe_what_stays(words, left.whole.residual, sd, "kPa"),
            *(() if named else describe_closest(found)),
        ),
        next_recording=proposal,
    )


def _is_of(tried: _Tried, model: TriedModel) -> bool:
    mechanism = tried.whole.model.mechanism
    return mechanism is not None and (mechanism.id, mechanism.variant) == (model.mechanism, model.variant)


def _make_film(model: CycleModel, x: Float) -> RelaxationModel:
    """The branch and the slope of the equilibrium stress at rest, as stiffnesses of the film."""
    of_kpa = model.cycle.fits.n_per_mm_of_kpa
    return RelaxationModel(
        float(model.slope_at_rest(x)) * of_kpa, (float(model.gamma(x)) * of_kpa,), (float(np.exp(x[1])),)
    )


def _estimate_film_sd(tried: _Tried) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Standard deviations of k0, k1, τ1, and of the damper."""
    model, x = tried.whole.model, tried.drawn_whole
    of_kpa, tau = model.cycle.fits.n_per_mm_of_kpa, np.exp(x[:, 1])
    k0, k1 = model.slope_at_rest(x) * of_kpa, model.gamma(x) * of_kpa
    low, high = np.quantile([k0, k1, tau, k1 * tau], [0.05, 0.95], axis=1)
    spread = ((high - low) / (2 * _NORMAL_90)).tolist()
    return tuple(spread[:3]), (spread[3],)


def _split_cycle(cycle: LargeCycle) -> list[tuple[str, Int]]:
    """Loading and unloading in parts of equal length: words, and the numbers of their samples."""
    found = []
    for words, numbers in (("loading", np.flatnonzero(cycle.loading)), ("unloading", np.flatnonzero(~cycle.loading))):
        for part in np.array_split(numbers, _PLACES):
            ends = cycle.stretch[part[0]], cycle.stretch[part[-1]]
            found.append((f"{words}, stretch {ends[0]:.2f} to {ends[1]:.2f}", part))
    return found


def _list_discrepancies(cycle: LargeCycle, left: Float, sd: float) -> list[Discrepancy]:
    found = []
    parts = _split_cycle(cycle)
    for where, part in parts:
        own = left[part]
        chi2, mean = float(own @ own), float(own.mean()) * sd
        p_value, side = float(chi2_law.sf(chi2, part.size)), "low" if mean > 0 else "high"
        # The whole counts as one of the places: where it is within the noise, so is each of them.
        is_beyond = is_beyond_noise(p_value, len(parts) + 1)
        found.append(
            Discrepancy(
                recording_id=cycle.fits.recording_id,
                where_found=where,
                chi2=chi2,
                degrees_of_freedom=part.size,
                p_value=p_value,
                statement=f"{where}: the simulated stress is {abs(mean):.3g} kPa too {side} on average, "
                f"{np.sqrt(chi2 / part.size):.2g} times the noise"
                if is_beyond
                else f"{where}: the stress is {WITHIN}",
            )
        )
    return found


def _list_unaskable(sd: float) -> tuple[str, ...]:
    return (
        "There is one cycle at one rate: a relaxation and another law of equilibrium differ in what they predict of the unloading, "
        "in nothing else",
        "Damage that only shows below the largest stretch so far leaves no trace while loading: it cannot be fitted there",
        f"No rest was recorded: the noise, {sd:.2g} kPa, is that of neighbouring samples",
    )


def _list_residuals(cycle: LargeCycle, plain: _Tried, extended: _Tried, sd: float) -> Residuals:
    """Everything as fitted to everything, and as the fits to the loading predict it."""
    whole = [cycle.time_s, cycle.stress, plain.whole.stress(), extended.whole.stress()]
    learned = [cycle.time_s, cycle.stress, plain.learned.stress(), extended.learned.stress()]
    parts = [thin_curves(values, _SHOWN) for values in (whole, learned)]
    n = parts[0][0].size
    time, measured, first, second = (np.concatenate(both) for both in zip(*parts, strict=True))
    return Residuals(
        recording_id=cycle.fits.recording_id,
        kind=np.repeat([STRESS, PREDICTED], n),
        label=np.repeat(["loading and unloading", "fitted to the loading"], n),
        frequency_hz=np.full(2 * n, np.nan),
        time_s=time,
        measured=measured,
        plain=first,
        extended=second,
        sd=np.full(2 * n, sd),
    )


def _propose_recording(
    cycle: LargeCycle, others: Sequence[_Tried], found: Comparison, sd: float
) -> NextRecording | None:
    """Of a slower cycle, a faster one and a hold the one that separates the possible mechanisms best; None where none
    does.

    As in `next_recording`: Dᵀ (N + C)⁻¹ D, of which C is what the cycle at hand leaves open about the alternative.
    """
    possible = [next(t for t in others if _is_of(t, p.model)) for p in found.possible]
    best: tuple[float, str, dict[str, str | float]] | None = None
    for text, design, time, stretch in _list_proposals(cycle):
        seen = np.unique(np.linspace(1, time.size - 1, _COMPARED).astype(int))
        shown = [_predict_elsewhere(t, time, stretch)[:, seen] for t in possible]
        pairs = [
            (i, j)
            for i in range(len(shown))
            for j in range(len(shown))
            if _name_mechanism(possible[i]) != _name_mechanism(possible[j])
        ]
        apart = min((_compute_separation(shown[i], shown[j], sd) for i, j in pairs), default=0.0)
        if best is None or apart > best[0]:
            best = apart, text, design
    if best is None or best[0] < RULES.single.decides:
        return None
    return NextRecording((best[2],), f"{best[1]}: tells the causes that are possible apart", best[0])


def _name_mechanism(tried: _Tried) -> str:
    return "" if tried.whole.model.mechanism is None else tried.whole.model.mechanism.id


def _predict_elsewhere(tried: _Tried, time: Float, stretch: Float) -> Float:
    """(1 + B, m) what a model predicts of another test, at its optimum and drawn, kPa."""
    model = tried.whole.model.elsewhere(time, stretch)
    return model.stress(np.vstack([tried.whole.x, tried.drawn_whole[:_FEW]]))


def _compute_separation(true: Float, rival: Float, sd: float) -> float:
    """χ² against an alternative, (1 + B, m) each, with the form error as noise."""
    difference = true[0] - rival[0]
    noise = np.diag(sd**2 + (RULES.single.form_error * difference) ** 2)
    return float(difference @ np.linalg.solve(noise + np.cov(rival[1:].T), difference))


def _list_proposals(cycle: LargeCycle) -> list[tuple[str, dict[str, str | float], Float, Float]]:
    t, lam = cycle.time_s - cycle.time_s[0], cycle.stretch
    strain = float(lam.max() - 1)
    test: dict[str, str | float] = {"protocol": "cycle", "loading": "mechanical"}
    up = t[: cycle.top + 1]
    held = np.concatenate([up, up[-1] + np.geomspace(1e-3, 1.0, 200) * _HOLD_S])
    stretch = np.concatenate([lam[: cycle.top + 1], np.full(200, lam[cycle.top])])
    return [
        (f"the same cycle {_SLOWER:g} times slower", {**test, "slower": _SLOWER}, t * _SLOWER, lam),
        (f"the same cycle {_SLOWER:g} times faster", {**test, "slower": 1 / _SLOWER}, t / _SLOWER, lam),
        (
            f"the same loading, then held at the largest stretch for {_HOLD_S / 60:g} minutes",
            {"protocol": "step", "loading": "mechanical", "strain_pp": round(strain, 4), "hold_s": _HOLD_S}, held, stretch,
        ),
    ]  # fmt: skip
