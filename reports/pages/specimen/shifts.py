"""How far a cause in the model moves the film: said once, for the table of parameters and for the diagnosis.

Two models stand against the extended one: the one that is fitted to the responses alone, and the plain one of the
diagnosis, which is fitted to all recordings, calibrations of the rig too. A cause may bias the one and not the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from reports.evidence import Standing
from reports.figures.curves import arms
from reports.results import Query, Results
from reports.results import Row as Record
from schemas.explanations import call_cause
from schemas.numbers import significant

MOVED = 2.0
"""Standard deviations from which on a parameter has moved."""
FILM_SQL = """SELECT parameter, unit, plain, plain_sd, extended, extended_sd, moved_sd
FROM diagnosis_parameters
WHERE specimen_id = $specimen
ORDER BY parameter"""


@dataclass(frozen=True)
class Shifts:
    """The largest shift of a parameter towards the extended model, SD: from the fit to the responses alone, and from the plain model
    of the diagnosis; None where a model is not there to compare. `cause`: what the cause in it is called."""

    fitted: float | None
    fitted_parameter: str
    plain: float | None
    cause: str = "the cause"

    @property
    def any(self) -> bool:
        """The film of one of them is not that of the extended model."""
        return any(one is not None and one > MOVED for one in (self.fitted, self.plain))


def measure_shift(before: Record, after: Record, column: str) -> float | None:
    """How far a parameter of two fits is apart, in SD of both together; None where one is not known."""
    sds = [r[f"{column}_sd"] for r in (before, after)]
    if before[column] is None or after[column] is None or any(sd is None for sd in sds):
        return None
    combined = float(np.hypot(*sds))
    return abs(after[column] - before[column]) / combined if combined else None


def load(results: Results, standing: Standing) -> Shifts:
    """The shifts of a specimen's film."""
    fitted: Mapping[str, float] = {}
    if standing.fit is not None and standing.extension is not None:
        fitted = _of_fits(standing.fit, standing.extension)
    rows = results.rows(Query(FILM_SQL, {"specimen": standing.specimen_id}))
    plain = max((r["moved_sd"] for r in rows if r["moved_sd"] is not None), default=None)
    most = max(fitted, key=lambda name: fitted[name], default="")
    return Shifts(fitted.get(most), most, plain, call_cause(standing.diagnosis or {"verdict": ""}))


def _of_fits(fit: Record, extension: Record) -> dict[str, float]:
    """The shift of each spring and damper, by name."""
    columns = {"k0": "k0_n_per_mm"}
    for i in range(1, len(arms(fit)) + 1):
        columns |= {f"k{i}": f"k{i}_n_per_mm", f"c{i}": f"c{i}_n_s_per_mm"}
    found = {name: measure_shift(fit, extension, column) for name, column in columns.items()}
    return {name: shift for name, shift in found.items() if shift is not None}


def tell(shifts: Shifts) -> str:
    """What ignoring the cause does to the film, in words."""
    biases = f"ignoring {shifts.cause} biases the film"
    if shifts.plain is not None and shifts.plain > MOVED:
        return biases
    if shifts.fitted is not None and shifts.fitted > MOVED:
        off = f"the model fitted to the responses alone is up to {significant(shifts.fitted, 2)} SD off ({shifts.fitted_parameter})"
        if shifts.plain is None:
            return f"{biases}: {off}"
        return f"{off}; the plain model of the diagnosis, which rests on all recordings, finds the same film as with {shifts.cause}"
    return "the film stays where it was"
