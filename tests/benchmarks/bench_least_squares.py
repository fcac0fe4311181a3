"""Our least squares and scipy's on the searches that the package really makes, side by side in one run.

The calls of the solver are recorded while specimens are fitted and sessions diagnosed, and each is made again: by our
search as it was made, and by `scipy.optimize.least_squares` (trf and dogbox) from the same start within the same
bounds, with the same Jacobians (analytic ones, or forward differences of all entries evaluated as one call),
`x_scale="jac"`, as many evaluations beside those for Jacobians as the search has steps, and, as `ftol`, the fall of
χ² that ends our search as a share of the χ² where it ended. Solvers take turns in going first, for simulations
remember predictions. Seconds are processor time of one search."""

from __future__ import annotations

import inspect
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from scipy.optimize import least_squares

from pipeline.analyse.inputs import Measured
from pipeline.analyse.recording import analyse_recording
from pipeline.analyse.session_features import SessionFeatures
from pipeline.analyse.specimen import analyse_specimen
from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.search import extended_model, plain_fit
from pipeline.diagnose.single import system_mechanisms
from pipeline.diagnose.single.oscillator import PARAMETERS, SystemRecord
from pipeline.diagnose.single.oscillator_fit import DIFFERENCE, LOWER, UPPER, fit_all, join_compared
from pipeline.fit.relaxation import electrical, forward, intervals, search, varpro
from pipeline.fit.relaxation.identify import fit_specimen
from pipeline.physics.least_squares import Options, Solution, minimise, tie, with_prior
from pipeline.simulate.campaign import simulate
from pipeline.simulate.plan import load_campaign
from schemas.arrays import Float, Int
from tests.helpers.fit_truth import ACRYLATE, BAND, SILICONE, STACK, film, mechanical, response, rig
from tests.helpers.truth_rig import KINDS, compact_session

TITLE = "Least squares: our search and scipy's, on the searches of fits and diagnoses"
OURS, METHODS = "ours", ("trf", "dogbox")
EQUAL = 1e-3
"""Difference of χ², in units of χ² per value where that exceeds 1, that is none."""
SPECIMENS = ("PA-1", "SI-2", "SC-1")
PROTOCOLS = ("chirp", "sphs", "cyclic", "step")
SEEDS = range(3)
EFFECTS = (None, "missing_relaxation", "drive_lag")
SESSION = 103
"""Seed of the sessions of the pinned verdicts."""
EVERY = int(os.environ.get("DEALAB_BENCH_EVERY", "10"))
"""Of the refits of a session every so many are made again."""
DATA = Path(os.environ.get("DEALAB_REAL_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
LOUD_END, LENGTH, FIRST, LAST, INTERVAL_S = 40400, 8192, 10584, 11608, 2**14 / 1e7
"""Samples of the Silverbox as in `tests/real_data/test_system_real.py`."""

Call = Mapping[str, Any]


@dataclass(frozen=True)
class Search:
    """One search.

    ours : makes it, and returns χ²; beside : χ² that is in ours and not in the residuals
    residual, jacobian : (M,) and (M, P) at x (P,); starts (P,), of which the best end counts; low, high : (P,)
    fall, share, most : `Options` of ours
    unit : of χ²
    """

    ours: Callable[[], float]
    residual: Callable[[Float], Float]
    jacobian: Callable[[Float], Float]
    starts: Sequence[Float]
    low: Float
    high: Float
    fall: float
    share: float
    most: int
    unit: float = 1.0
    beside: float = 0.0


@contextmanager
def recorded(*places: tuple[Any, str]) -> Iterator[list[Call]]:
    """The calls of functions that stand in modules or classes under these names, with their arguments by name."""
    calls: list[Call] = []

    def watched(function: Callable[..., Any]) -> Callable[..., Any]:
        signature = inspect.signature(function)

        def call(*args: Any, **options: Any) -> Any:
            bound = signature.bind(*args, **options)
            bound.apply_defaults()
            calls.append(bound.arguments)
            return function(*args, **options)

        return call

    with ExitStack() as stack:
        for owner, name in places:
            stack.enter_context(mock.patch.object(owner, name, watched(getattr(owner, name))))
        yield calls


def run_scipy(given: Search, method: str, reached: float) -> float:
    """χ² where scipy ends, the best of the starts; inf where it fails. `reached`: where ours ended."""
    free = np.flatnonzero(given.low < given.high)
    ends = [np.inf]
    for start in given.starts:
        x = np.clip(start, given.low, given.high)

        def whole(entries: Float, x: Float = x) -> Float:
            point = x.copy()
            point[free] = entries
            return point

        def jacobian(entries: Float, whole: Callable[[Float], Float] = whole) -> Float:
            return given.jacobian(whole(entries))[:, free]

        def residual(entries: Float, whole: Callable[[Float], Float] = whole) -> Float:
            return given.residual(whole(entries))

        try:
            found = least_squares(
                residual,
                x[free],
                jacobian,
                (given.low[free], given.high[free]),
                method,
                x_scale="jac",
                ftol=max(given.fall / max(reached, 1e-300), given.share, 1e-15),
                xtol=1e-12,
                gtol=None,
                max_nfev=given.most,
            )
        except (ValueError, np.linalg.LinAlgError):
            continue
        ends.append(2 * float(found.cost))
    return min(ends) + given.beside


def remember(evaluate: Callable[[Float], tuple[Float, Float]]) -> tuple[Callable[[Float], Float], ...]:
    """Residual and Jacobian of a problem that has both at once, each evaluation made once."""
    known: dict[bytes, tuple[Float, Float]] = {}

    def at(x: Float) -> tuple[Float, Float]:
        key = x.tobytes()
        if key not in known:
            known.clear()
            known[key] = evaluate(x)
        return known[key]

    return lambda x: at(x)[0], lambda x: at(x)[1]


def forward_fits(calls: Sequence[Call]) -> list[Search]:
    """Fits of relaxation models to responses: analytic Jacobians, bounds on log τ, priors, ties."""
    return [_forward_fit(call) for call in calls]


def _forward_fit(call: Call) -> Search:
    observations, shape, prior, tied = (call[key] for key in ("observations", "shape", "prior", "tied"))

    def measure(points: Float, _: Int) -> tuple[Float, Float]:
        with np.errstate(over="ignore", invalid="ignore"):
            residual, jacobian = observations.evaluate(points[0], shape)
        return residual[None], jacobian[None]

    known = measure if prior is None else with_prior(measure, prior.mean, prior.root)
    known = known if tied is None else tie(known, tied.origin, tied.directions)

    def evaluate(x: Float) -> tuple[Float, Float]:
        residual, jacobian = known(x[None], np.zeros(1, dtype=np.int64))
        assert jacobian is not None
        return residual[0], jacobian[0]

    start = np.array(call["theta"], dtype=float) if tied is None else np.zeros(tied.directions.shape[1])
    low, high = np.full(start.size, -np.inf), np.full(start.size, np.inf)
    if tied is None:
        arms = slice(int(shape.spring) + shape.arms, int(shape.spring) + 2 * shape.arms)
        low[arms], high[arms] = call["log_tau_bounds"]

    def ours() -> float:
        return forward.polish(**call).chi2

    unit = max(1.0, ours() / observations.rows)
    return Search(ours, *remember(evaluate), [start], low, high, call["tolerance"] * unit, 0.0, forward.STEPS, unit)


def projections(calls: Sequence[Call]) -> list[Search]:
    """Searches over relaxation times with springs ≥ 0 found inside, from several starts."""
    return [
        found
        for call in calls
        for dashpot in (False, True)
        for size in range(1, 26)
        if (found := _projection(call["self"], [s for s in call["starts"] if (s[0].size, s[1]) == (size, dashpot)]))
    ]


def _projection(problem: varpro.LinearProblem, starts: list[tuple[Float, bool]]) -> Search | None:
    """From starts of one number of arms, with or without dashpot."""
    if not starts:
        return None
    size = starts[0][0].size
    present = np.ones((1, size + 2), dtype=bool)
    present[0, -1] = starts[0][1]

    def evaluate(x: Float) -> tuple[Float, Float]:
        found = problem.project(x[None], present)
        return found.residual[0], found.jacobian[0]

    def ours() -> float:
        return min(candidate.cost for candidate in problem.search(starts))

    unit = max(1.0, ours() / problem.target.size)
    low, high = np.full(size, problem.low), np.full(size, problem.high)
    options = varpro.SEARCH
    return Search(
        ours, *remember(evaluate), [t for t, _ in starts], low, high, options.fall, options.share, options.most, unit,
        problem.rest,
    )  # fmt: skip


def session_fits(calls: Sequence[Call], fall: float) -> list[Search]:
    """Searches of a diagnosis as they are made: Jacobians by forward differences, for ours also lent ones, and
    secants."""
    return [_session_fit(call, fall) for call in calls]


def _session_fit(call: Call, fall: float) -> Search:
    residuals, low, high = call["residuals"], call["low"], call["high"]
    free = np.flatnonzero(low < high)
    step = Options().difference

    def residual(x: Float) -> Float:
        return np.asarray(residuals(x[None])[0])

    def jacobian(x: Float) -> Float:
        width = np.where(x[free] + step <= high[free], step, -step)
        points = np.tile(x, (free.size + 1, 1))
        points[np.arange(1, free.size + 1), free] += width
        seen = residuals(points)
        columns = np.zeros((seen.shape[1], x.size))
        columns[:, free] = ((seen[1:] - seen[0]) / width[:, None]).T
        return columns

    def ours() -> float:
        return minimise(**call).chi2

    start = call["start"].x if isinstance(call["start"], Solution) else call["start"]
    unit = max(1.0, ours() / residual(start).size)
    return Search(ours, residual, jacobian, [start], low, high, fall, 0.0, call["most"], unit)


def oscillator_fits(call: Call) -> list[Search]:
    """Fits of nonlinear oscillators, each alone; ours are made side by side (`compare_oscillators`)."""
    oscillator, measured, problems = call["oscillator"], call["measured"], call["problems"]
    return [
        _oscillator_fit(oscillator, measured, problem, fit.cost)
        for problem, fit in zip(problems, fit_all(oscillator, measured, problems), strict=True)
    ]


def _oscillator_fit(oscillator: Any, measured: Float, problem: Any, cost: float) -> Search:
    unit = cost / np.sum(problem.fitted)
    rows = list(problem.free)

    def evaluate(x: Float) -> tuple[Float, Float]:
        theta = problem.at(x)
        columns = np.array([theta, *(theta + DIFFERENCE * (np.arange(PARAMETERS) == row) for row in rows)])
        seen = join_compared(oscillator, oscillator(columns.T))[:, problem.fitted] / np.sqrt(unit)
        return seen[0] - measured[problem.fitted] / np.sqrt(unit), (seen[1:] - seen[0]).T / DIFFERENCE

    return Search(
        lambda: cost / unit, *remember(evaluate), [problem.start[rows]], LOWER[rows], UPPER[rows], 0.0, 1e-5, 20
    )


def compare(name: str, searches: Sequence[Search]) -> list[dict[str, Any]]:
    """Each search by each solver."""
    solvers = (OURS, *METHODS)
    seconds, reached = dict.fromkeys(solvers, 0.0), {solver: np.empty(len(searches)) for solver in solvers}
    for number, one in enumerate(searches):
        end = one.ours()
        for solver in np.roll(solvers, number):
            begin = time.process_time()
            value = one.ours() if solver == OURS else run_scipy(one, str(solver), end)
            seconds[str(solver)] += time.process_time() - begin
            reached[str(solver)][number] = value / one.unit
    return rows_of(name, seconds, reached)


def compare_oscillators(call: Call) -> list[dict[str, Any]]:
    """All oscillators side by side by us, one after the other by scipy."""
    searches = oscillator_fits(call)
    begin = time.process_time()
    fit_all(**call)
    seconds, reached = {OURS: time.process_time() - begin}, {OURS: np.array([one.ours() for one in searches])}
    for method in METHODS:
        begin = time.process_time()
        reached[method] = np.array([run_scipy(one, method, one.ours()) for one in searches])
        seconds[method] = time.process_time() - begin
    return rows_of("oscillators of the Silverbox", seconds, reached)


def rows_of(name: str, seconds: Mapping[str, float], reached: Mapping[str, Float]) -> list[dict[str, Any]]:
    """Rows of the results: seconds of a search, and how χ² compares with ours."""
    count = reached[OURS].size
    rows = [{"name": f"{name}: {OURS}", "seconds": seconds[OURS] / count, "ratio": 1.0, "note": f"{count} searches"}]
    for method in METHODS:
        more = np.nan_to_num(reached[method] - reached[OURS], posinf=1e300)
        note = (
            f"χ² equal in {np.sum(np.abs(more) <= EQUAL)}, lower in {np.sum(more < -EQUAL)} (by more than 1 in"
            f" {np.sum(more < -1)}), higher in {np.sum(more > EQUAL)} (by more than 1 in {np.sum(more > 1)})"
        )
        ratio = seconds[method] / seconds[OURS]
        rows.append(
            {"name": f"{name}: scipy, {method}", "seconds": seconds[method] / count, "ratio": ratio, "note": note}
        )
    return rows


def record_test_films() -> tuple[list[Call], list[Call]]:
    """Forward fits and searches over relaxation times of films whose truth is known, on a rig and alone."""
    with recorded(*_FORWARD) as fits, recorded(*_STARTS) as starts:
        for truth in (ACRYLATE, STACK, SILICONE):
            for seed in SEEDS:
                rng = np.random.default_rng(seed)
                fit_specimen([response(BAND, mechanical(BAND, film(BAND, truth)), rng)], rig(1.03))
                fit_specimen([response(BAND, film(BAND, truth), rng, relative=0.05)])
    return fits, starts


def record_demonstration() -> tuple[list[Call], list[Call]]:
    """The same of specimens of the demonstration, mechanical, electrical and both."""
    campaign = load_campaign("thesis")
    chosen = [
        p for p in campaign.planned
        if p.specimen is not None and p.specimen.name in SPECIMENS and p.procedure.protocol in PROTOCOLS
    ]  # fmt: skip
    given: dict[str, list[Measured]] = {}
    for made in simulate(replace(campaign, planned=tuple(chosen))):
        one = made.recording
        results = tuple(r for r in analyse_recording(one).carried if not isinstance(r, SessionFeatures))
        given.setdefault(str(one.metadata.specimen_id), []).append(Measured(one.metadata, one.rig, results))
    with recorded(*_FORWARD) as fits, recorded(*_STARTS) as starts:
        for name, recordings in given.items():
            analyse_specimen(name, recordings, [], orders=(1, 2, 3))
    return fits, starts


def record_sessions() -> tuple[list[Call], list[Call]]:
    """Plain fits of sessions, and some of the refits with one cause more."""
    plains: list[Call] = []
    refits: list[Call] = []
    for effect in EFFECTS:
        effects = [] if effect is None else [(effect, KINDS[effect].typical)]
        features = tuple(reduce(one) for one in compact_session(SESSION, effects).recordings)
        with recorded((plain_fit, "minimise")) as first, recorded((extended_model, "minimise")) as then:
            diagnose(features)
        plains += first
        refits += then[::EVERY]
    return plains, refits


def silverbox() -> list[SystemRecord]:
    """One period of its multisine, and the part whose amplitude grows."""
    arrow = np.loadtxt(DATA / "silverbox" / "SNLS80mV.csv", delimiter=",", skiprows=1, usecols=(0, 1))
    arrow = (arrow - arrow.mean(axis=0))[LOUD_END - LENGTH : LOUD_END]
    period = np.genfromtxt(DATA / "silverbox" / "Schroeder80mV.csv", delimiter=",", skip_header=1, usecols=(2, 3))
    period = (period - period.mean(axis=0))[FIRST:LAST]
    return [
        SystemRecord("one period", period[:, 0], period[:, 1], INTERVAL_S, periodic=True),
        SystemRecord("growing", arrow[:, 0], arrow[:, 1], INTERVAL_S),
    ]


_FORWARD = ((search, "polish"), (intervals, "polish"), (electrical, "polish"))
_STARTS = ((varpro.LinearProblem, "search"),)


def run() -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for where, record in (("test films", record_test_films), ("the demonstration", record_demonstration)):
        fits, starts = record()
        rows += compare(f"forward fits of {where}", forward_fits(fits))
        rows += compare(f"relaxation times of {where} from all starts", projections(starts))
    plains, refits = record_sessions()
    rows += compare("plain fits of sessions", session_fits(plains, Options().fall))
    rows += compare("refits with one cause more, as they are made", session_fits(refits, Options().fall))
    if (DATA / "silverbox").is_dir():
        with recorded((system_mechanisms, "fit_all")) as asked:
            system_mechanisms.ask_system(silverbox())
        rows += compare_oscillators(max(asked, key=lambda call: len(call["problems"])))
    return rows
