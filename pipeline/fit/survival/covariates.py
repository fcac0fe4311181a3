"""What a life may depend on, as columns of a design: laws of stress and categories, and designs that tell nothing.

ln t = intercept + Σ coefficient · x. The coefficient of an inverse power law is its exponent, that of Arrhenius' law the
activation energy in eV.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError, RefusedError
from schemas.life_covariates import ARRHENIUS, CATEGORY, EXPONENTIAL_LAW, INVERSE_POWER

BOLTZMANN_EV_PER_K = 8.617333262e-5
_ZERO_CELSIUS_K = 273.15


@dataclass(frozen=True)
class Law:
    """How a stress enters: `transform` of its values, which have to be above `above`, and what its coefficient is."""

    transform: Callable[[Float], Float]
    above: float
    coefficient: str
    unit: str


LAWS: Mapping[str, Law] = {
    INVERSE_POWER: Law(np.log, 0.0, "exponent", ""),
    EXPONENTIAL_LAW: Law(np.asarray, -np.inf, "slope of ln t", "per unit"),
    ARRHENIUS: Law(
        lambda celsius: 1 / (BOLTZMANN_EV_PER_K * (celsius + _ZERO_CELSIUS_K)),
        -_ZERO_CELSIUS_K,
        "activation energy",
        "eV",
    ),
}


@dataclass(frozen=True)
class Covariate:
    """One thing that lives depend on.

    Parameters
    ----------
    name : such as "voltage"
    law : of `LAWS`, or `CATEGORY`
    values : (n,) numbers (temperatures in °C for Arrhenius' law), or names of categories
    unit : of the values, for messages
    """

    name: str
    law: str
    values: Float | Sequence[str]
    unit: str = ""

    @property
    def is_category(self) -> bool:
        return self.law == CATEGORY

    @property
    def levels(self) -> tuple[str, ...]:
        """Categories in alphabetical order; the first one is what the others are compared with."""
        return tuple(sorted(set(map(str, self.values))))

    def columns(self) -> tuple[tuple[str, ...], Float]:
        """Names and values (n, columns) of what enters the design.

        Raises
        ------
        RefusedError
            A value is missing or has no place under the law.
        """
        if self.is_category:
            words = np.array([str(value) for value in self.values])
            names = tuple(f"{self.name}: {level}" for level in self.levels[1:])
            return names, np.stack([words == level for level in self.levels[1:]], axis=1).astype(
                np.float64
            ) if names else np.zeros((words.size, 0))
        law, x = LAWS[self.law], np.asarray(self.values, dtype=np.float64)
        wrong = ~(np.isfinite(x) & (x > law.above))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise RefusedError(
                f"{self.name} of {x[row]:g} {self.unit}".rstrip(),
                where=f"row {row}",
                expected=f"a value above {law.above:g} for the {self.law} law"
                if np.isfinite(law.above)
                else "a finite value",
            )
        return (self.name,), law.transform(x)[:, None]


@dataclass(frozen=True)
class Design:
    """Columns of all covariates beside the intercept.

    Parameters
    ----------
    names : (p,) of the columns
    owners : (p,) the covariate of each
    x : (n, p) values
    """

    names: tuple[str, ...]
    owners: tuple[str, ...]
    x: Float

    @property
    def matrix(self) -> Float:
        """(n, 1 + p) with the intercept."""
        return np.column_stack((np.ones(self.x.shape[0]), self.x))

    def without(self, covariate: str) -> Design:
        keep = [i for i, owner in enumerate(self.owners) if owner != covariate]
        return Design(tuple(self.names[i] for i in keep), tuple(self.owners[i] for i in keep), self.x[:, keep])


def make_design(covariates: Sequence[Covariate], failed: Bool) -> Design:
    """The design of all covariates.

    Parameters
    ----------
    covariates : each with n values
    failed : (n,) who failed, which decides what can be told

    Raises
    ------
    NotIdentifiableError
        A covariate has one value, a category has no failure (its effect is infinite), all failures came at one value of a
        stress, or covariates change together.
    RefusedError
        A covariate has another number of values than there are lives, or values that its law does not take.
    """
    for covariate in covariates:
        if len(covariate.values) != failed.size:
            raise RefusedError(
                f"{covariate.name} has {len(covariate.values)} values",
                expected=f"one for each of the {failed.size} lives",
            )
        _check_informative(covariate, failed)
    parts = [(covariate, *covariate.columns()) for covariate in covariates]
    design = Design(
        tuple(name for _, names, _ in parts for name in names),
        tuple(covariate.name for covariate, names, _ in parts for _ in names),
        np.column_stack([np.zeros((failed.size, 0)), *(x for _, _, x in parts)]),
    )
    centred = design.x - design.x.mean(axis=0)
    scale = np.sqrt((centred**2).sum(axis=0))
    if design.x.shape[1] and np.linalg.matrix_rank(centred / scale, tol=1e-8) < design.x.shape[1]:
        raise NotIdentifiableError(
            f"{' and '.join(c.name for c in covariates)} change together: their effects cannot be told apart",
            expected="specimens in which one of them differs while the others are equal",
        )
    return design


def _check_informative(covariate: Covariate, failed: Bool) -> None:
    values = np.asarray([str(v) for v in covariate.values] if covariate.is_category else covariate.values)
    levels = np.unique(values)
    shown = f"{levels[0]}" if covariate.is_category else f"{levels[0]:g} {covariate.unit}".rstrip()
    if levels.size < 2:
        raise NotIdentifiableError(
            f"{covariate.name} has one value ({shown}): nothing to fit its law to",
            expected="lives at two or more values",
        )
    if covariate.is_category:
        for level in levels:
            if not failed[values == level].any():
                raise NotIdentifiableError(
                    f"{covariate.name} {level}: none of its {int((values == level).sum())} specimens failed, so its effect"
                    " has no finite estimate (separation)",
                    expected="at least one failure in each category",
                    remedy="Compare survival curves, or leave the category out",
                )
    elif np.unique(values[failed]).size < 2:
        at = f"{values[failed][0]:g} {covariate.unit}".rstrip()
        raise NotIdentifiableError(
            f"all failures came at one value of {covariate.name} ({at}): its effect has no finite estimate (separation)",
            expected="failures at two or more values",
        )
