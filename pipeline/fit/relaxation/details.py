"""From the optimum of one order to a fit with its uncertainty: covariance, intervals, rig constants, and what limits
them.

Does not belong here: searching (`search`) and choosing between orders (`order`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.fit.relaxation.forward import GaussianPrior, Solution
from pipeline.fit.relaxation.intervals import (
    PARABOLIC,
    covariance,
    estimate,
    profile_limits,
    spring_of_dashpot,
    with_spring,
)
from pipeline.fit.relaxation.observations import Observations
from pipeline.fit.relaxation.order import bic, held_out_error
from pipeline.fit.relaxation.reference import Reference
from pipeline.fit.relaxation.results import Estimate, RelaxationFit
from pipeline.fit.relaxation.search import OrderFit
from pipeline.physics.film import RelaxationModel
from pipeline.physics.rig import TONNES_PER_KG
from schemas.arrays import Float
from schemas.numbers import pm, significant, with_unit

PROFILED = 0.1
"""Standard deviation of a logarithm from which the profile likelihood gives the limits. Up to `PARABOLIC` a standard
deviation still describes the likelihood, but limits by it are short: with 5 % noise they hold the truth in 92 % of
draws, those of the profile in 94 %."""
ONE_SIDED = 0.05
"""Share of a parameter's variance that is due to the spring of a pure dashpot, from which the same holds: 1/k ends at
0, so that what it does to the others goes to one side."""
MOST_PROFILED = 5
"""Most arms of a model whose parameters get profile likelihoods: a long ladder of arms describes a curve, not
springs."""
CONFLICT = 3.5
"""Standard deviations between a fitted rig constant and the rig file that are worth a word."""
CONSTANTS = {
    "clamp_mass_kg": ("the clamp's mass", "kg", TONNES_PER_KG),
    "load_cell_stiffness_n_per_mm": ("the load cell's stiffness", "N/mm", 1.0),
    "load_cell_damping_n_s_per_mm": ("the load cell's damping", "N s/mm", 1.0),
}
"""The constants as a rig file names them: what each is called in a sentence, its unit there, and what that is in the
package's units."""


@dataclass(frozen=True)
class Context:
    """What intervals need beside a solution."""

    observations: Observations
    reference: Reference
    bounds: tuple[float, float]
    profile_all: bool
    prior: GaussianPrior | None = None

    def detailed(self, found: OrderFit) -> RelaxationFit:
        """The fit with covariance, BIC and held-out error, without intervals."""
        solution = found.solution
        shape = solution.shape
        data = self.observations.data
        freedom = data - shape.size
        dispersion = max(1.0, solution.chi2 / freedom) if freedom >= 4 else 1.0
        held_out = held_out_error(self.observations, solution)
        names = shape.names + self.observations.nuisance.names
        further = None
        if shape.dashpot:
            further = spring_of_dashpot(self.observations, solution)
            names += (f"1/k{shape.order}",)
        return RelaxationFit(
            order=found.order,
            model=shape.model(solution.theta),
            shape=shape,
            theta=solution.theta,
            names=names,
            covariance=covariance(solution, dispersion, self.observations.rows, further),
            estimates={},
            chi2=solution.chi2,
            dispersion=dispersion,
            data=data,
            lines=self.observations.lines,
            parameters=shape.size,
            bic=bic(solution.chi2, self.reference.dispersion, shape.size, data),
            residual=solution.residual,
            rigs=self.observations.rigs,
            held_out_error=held_out if np.isfinite(held_out) else None,
            warnings=found.notes,
        )

    def finished(self, fit: RelaxationFit, found: OrderFit, *, profile: bool, adequate: bool = True) -> RelaxationFit:
        """The fit with its estimates; profile likelihood where the log-likelihood is no parabola, if asked for.

        `adequate`: the order suffices, so that what it says about the rig means something.
        """
        solution, shape = found.solution, fit.shape
        estimates: dict[str, Estimate] = {}
        warnings = list(fit.warnings)
        c = fit.covariance
        for name, value, direction in _parameters(fit.model, shape, solution.theta.size):
            sd = float(np.sqrt(direction @ c[: direction.size, : direction.size] @ direction))
            limits = None
            if profile and shape.order <= MOST_PROFILED and (sd > PROFILED or _one_sided(fit, direction)):
                limits = self._profile(solution, direction, sd, fit.dispersion)
            estimates[name] = estimate(value, sd, limits)
            if sd > PARABOLIC and not name.startswith("tau"):
                warnings.append(_unresolved(name, estimates[name], profiled=limits is not None))
        estimates |= self._nuisance(solution, c)
        if adequate:
            warnings += self._rig_conflicts(solution)
        if not shape.spring:
            estimates["k0"] = Estimate(0.0)
        return replace(fit, estimates=estimates, warnings=tuple(warnings))

    def _profile(
        self, solution: Solution, direction: Float, sd: float, factor: float
    ) -> tuple[float | None, float | None]:
        """Profile limits. A pure dashpot gets its spring back for it, which may be rigid: the wider of both on
        either side."""
        observations, shape = self.observations, solution.shape
        limits = profile_limits(observations, solution, direction, sd, factor, self.bounds, self.prior)
        if not shape.dashpot or self.prior is not None:
            return limits
        extended = with_spring(observations, solution)
        n, a = shape.arms, int(shape.spring)
        new = np.zeros(extended.theta.size)
        new[: a + n] = direction[: a + n]
        new[a + n + 1 : a + 2 * n + 1] = direction[a + n : a + 2 * n]
        new[a + n] = new[a + 2 * n + 1] = direction[a + 2 * n]
        fastest = float(np.log(extended.shape.split(extended.theta)[2].min()))
        bounds = min(self.bounds[0], fastest), self.bounds[1]
        springy = profile_limits(observations, extended, new, sd, factor, bounds)
        below, above = zip(limits, springy, strict=True)
        return (
            None if None in below else min(x for x in below if x is not None),
            None if None in above else max(x for x in above if x is not None),
        )

    def _rig_conflicts(self, solution: Solution) -> list[str]:
        """Constants that the data put far outside what the rig file says."""
        found = []
        for r, prior in enumerate(self.observations.rigs):
            places = [solution.shape.size + p for p in self.observations.nuisance.rigs[r]]
            values, sd = prior.values(solution.theta[places]), prior.sd
            for i, (words, dimension, unit) in enumerate(CONSTANTS.values()):
                distance = abs(values[i] - prior.nominal[i]) / sd[i] if sd[i] > 0 else 0.0
                if distance > CONFLICT:
                    expected = pm(float(prior.nominal[i]) / unit, float(sd[i]) / unit, dimension)
                    found.append(
                        f"the fit puts {words} at {with_unit(significant(float(values[i]) / unit, 4), dimension)},"
                        f" {significant(distance, 2)} SD from the {expected} of the rig's file and calibrations"
                    )
        return found

    def _nuisance(self, solution: Solution, c: Float) -> dict[str, Estimate]:
        """Rig constants and the actuation amplitude with their standard deviations."""
        found: dict[str, Estimate] = {}
        nuisance, size = self.observations.nuisance, solution.shape.size
        for r, prior in enumerate(self.observations.rigs):
            places = [size + p for p in nuisance.rigs[r]]
            values = prior.values(solution.theta[places])
            slopes = prior.slopes(values)
            spread = slopes @ c[np.ix_(places, places)] @ slopes.T
            for i, (name, (_, _, unit)) in enumerate(CONSTANTS.items()):
                value, sd = float(values[i]) / unit, float(np.sqrt(max(spread[i, i], 0.0))) / unit
                label = name if r == 0 else f"{name} ({r + 1})"
                found[label] = Estimate(value, sd, value - 1.96 * sd, value + 1.96 * sd, "wald")
        if nuisance.amplitude is not None:
            place = size + nuisance.amplitude
            sd = float(np.sqrt(c[place, place]))
            found["force_per_voltage_squared_n_per_kv2"] = estimate(float(np.exp(solution.theta[place])), sd, None)
        return found


def _one_sided(fit: RelaxationFit, direction: Float) -> bool:
    """Whether direction·θ depends on how rigid the spring of a pure dashpot is."""
    if not fit.shape.dashpot or not fit.names[-1].startswith("1/k"):
        return False
    c, n = fit.covariance, direction.size
    shared = float(c[-1, :n] @ direction) ** 2
    return shared > ONE_SIDED * float(c[-1, -1]) * float(direction @ c[:n, :n] @ direction)


def _parameters(model: RelaxationModel, shape: object, size: int) -> list[tuple[str, float, Float]]:
    """Name, value and direction in θ of each reported material parameter: springs, dampers, relaxation times."""
    n = len(model.k)
    a = int(model.k0 > 0)
    unit = np.eye(size)
    found: list[tuple[str, float, Float]] = []
    if a:
        found.append(("k0", model.k0, unit[0]))
    for i, (k, tau) in enumerate(zip(model.k, model.tau, strict=True)):
        found.append((f"k{i + 1}", k, unit[a + i]))
        found.append((f"c{i + 1}", k * tau, unit[a + i] + unit[a + n + i]))
        found.append((f"tau{i + 1}", tau, unit[a + n + i]))
    if model.c_inf > 0:
        found.append((f"c{n + 1}", model.c_inf, unit[a + 2 * n]))
    return found


def _unresolved(name: str, found: Estimate, *, profiled: bool) -> str:
    if not profiled:
        return f"{name} unresolved"
    if found.lower is not None and found.upper is not None:
        return f"{name} between {significant(found.lower)} and {significant(found.upper)} (95 %, profile)"
    if found.lower is not None:
        return f"{name} at least {significant(found.lower)} (95 %), no upper limit"
    if found.upper is not None:
        return f"{name} at most {significant(found.upper)} (95 %), no lower limit"
    return f"{name} unresolved: no limit on either side"
