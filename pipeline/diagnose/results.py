"""What a diagnosis says: discrepancies, candidates, verdict. Types only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.diagnose.faults.fault import Fault
from pipeline.physics.film import RelaxationModel
from schemas.arrays import Float
from schemas.assumptions import Assumption

NONE, NAMED, AMBIGUOUS, UNKNOWN = "none", "named", "ambiguous", "unknown"


@dataclass(frozen=True)
class Discrepancy:
    """Where the plain simulation is wrong: a recording and a band, decade of time, cycle or level within it.

    `chi2` over `degrees_of_freedom` features; `p_value` under the noise alone; `statement` in words and numbers.
    """

    recording_id: str
    where_found: str
    chi2: float
    degrees_of_freedom: int
    p_value: float
    statement: str


@dataclass(frozen=True)
class Estimate:
    """A severity with its standard deviation and its 90 % interval, in the unit of its key."""

    value: float
    sd: float
    lower: float = float("nan")
    upper: float = float("nan")


@dataclass(frozen=True)
class Candidate:
    """One mechanism, alone in the model, at its optimum.

    likelihood_ratio : fall of χ² (twice the log likelihood ratio), with the form of the model allowed to be a little
        wrong
    bic : fall of χ² less log(effective number of data) per parameter, negative: not worth its parameters
    probability : among the candidates, by the evidence of each with a log-uniform prior of its severity
    severity : main severity by its key in the contract, `parameter`, and its standard deviation
    explained : share of the plain model's misfit that it explains
    gain : share of the held-out squared error beyond the noise; NaN where it was not asked for
    equation, variant : what was tried
    """

    mechanism: str
    likelihood_ratio: float
    bic: float
    probability: float
    severity: float
    severity_sd: float
    explained: float
    gain: float
    variant: str
    equation: str
    parameter: str = ""


@dataclass(frozen=True)
class Predicted:
    """A block of features that both models predicted without having seen it; (n,) each, `sd` of the noise."""

    recording_id: str
    kind: str
    label: str
    plain: Float
    extended: Float
    sd: Float


@dataclass(frozen=True)
class HeldOut:
    """Held-out error of the plain and of the extended model, pooled over the parts left out one by one.

    before, after : root mean square in units of the noise
    gain : share of the squared error beyond the noise that the extension removes, `lower` to `upper` its 95 % interval; NaN where the
        plain model's held-out error is within the noise
    size : number of features that were predicted; parts : part left out → (before, after); predicted : block by block
    entries : (parts, Q) the mechanisms' entries in the extended model fitted without each part
    """

    before: float
    after: float
    gain: float
    lower: float
    upper: float
    size: int
    parts: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    predicted: tuple[Predicted, ...] = ()
    entries: Float = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True)
class NextRecording:
    """A recording, or a few, that would tell causes apart. `designs`: keys of the contract's `recording` block of each,
    and `warmer_k`, how much warmer than now the room is; `text` for people; `separation`: expected difference of χ²
    between the two closest causes; `leaves`: ids of causes that it does not tell from the strongest."""

    designs: tuple[Mapping[str, str | float], ...]
    text: str
    separation: float
    leaves: tuple[str, ...] = ()


@dataclass(frozen=True)
class Extension:
    """The model with the named mechanisms.

    film, film_sd : relaxation model of the film in it, and standard deviations (k0, k…, tau…); `plain_film` without
        them
    damper_sd : standard deviations of the arms' dampers, whose springs and times err together
    severities : mechanism → key → estimate; `variants` mechanism → form
    chi2, plain_chi2 : of all features; `size` their number
    """

    severities: Mapping[str, Mapping[str, Estimate]]
    variants: Mapping[str, str]
    film: RelaxationModel
    film_sd: tuple[float, ...]
    damper_sd: tuple[float, ...]
    plain_film: RelaxationModel
    plain_film_sd: tuple[float, ...]
    chi2: float
    plain_chi2: float
    size: int


@dataclass(frozen=True)
class Residuals:
    """Of one recording: measured features, simulated by the plain and the extended model, for the pages.

    `kind` and `label` of each feature's block, `frequency_hz` and `time_s` where it is, `sd` of its noise; (n,) each.
    """

    recording_id: str
    kind: NDArray[np.str_]
    label: NDArray[np.str_]
    frequency_hz: Float
    time_s: Float
    measured: Float
    plain: Float
    extended: Float
    sd: Float


@dataclass(frozen=True)
class Term:
    """A point of an estimated function: what a stage is changed by at a value of what it depends on.

    Parameters
    ----------
    hypothesis : `stage/covariate`
    stage, covariate, covariate_value, covariate_unit : where
    term, lower_95, upper_95, unit : the value with its 95 % interval
    """

    hypothesis: str
    stage: str
    covariate: str
    covariate_value: float
    covariate_unit: str
    term: float
    lower_95: float
    upper_95: float
    unit: str


@dataclass(frozen=True)
class Diagnosis:
    """What the simulation of a specimen's session gets wrong, and why.

    verdict : none, named, ambiguous or unknown
    mechanisms : all that are named together, the strongest first; empty for none; for `unknown` those that explain a
        part
    also_possible : alternatives to the strongest that the recordings cannot tell from it; `unlisted` where it may be
        none of the list
    p_value : of the whole search under the noise alone
    supported_by : protocols in which the extension lowers the misfit clearly
    smallest_detectable : mechanism → key → severity that would be found with 80 % probability; smallest_parameters the
        same in the extension's own parameters (onset types: largest load over onset, less 1)
    invisible : mechanisms that leave no trace in these recordings
    could_not_ask : questions that these recordings cannot answer, in words
    unexplained : what is left where the verdict is unknown, what speaks for a cause that is in no list, and where the
        causes mend next to nothing of what is far beyond the noise, in words
    explained : share of the plain model's misfit that the mechanisms explain together; NaN for none
    probabilities : hypothesis → posterior probability; they sum to 1; empty for none
    stage : where something acts, most probably; None for none
    depends_on : what it depends on, more probably than not
    terms : the function of the most probable region without a name
    left_p_value : of smooth patterns that they leave, on the scale that allows their form to be a little wrong; NaN for
        none
    faults : what is wrong with recordings and their metadata; their causes come first among the mechanisms, and all
        else is of the recordings without them
    assumed : recording → what its diagnosis takes for granted of it, beside what its own analyses do
    would_tell : what tells possible causes apart where no recording that is proposed does, in words
    """

    specimen_id: str
    verdict: str
    mechanisms: tuple[str, ...]
    also_possible: tuple[str, ...]
    p_value: float
    supported_by: tuple[str, ...]
    held_out: HeldOut | None
    extension: Extension | None
    candidates: tuple[Candidate, ...]
    discrepancies: tuple[Discrepancy, ...]
    next_recording: NextRecording | None
    smallest_detectable: Mapping[str, Mapping[str, float]]
    invisible: tuple[str, ...]
    could_not_ask: tuple[str, ...]
    unexplained: tuple[str, ...]
    plain_film: RelaxationModel
    residuals: tuple[Residuals, ...]
    smallest_parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    explained: float = float("nan")
    left_p_value: float = float("nan")
    probabilities: Mapping[str, float] = field(default_factory=dict)
    stage: str | None = None
    depends_on: tuple[str, ...] = ()
    terms: tuple[Term, ...] = ()
    faults: tuple[Fault, ...] = ()
    assumed: Mapping[str, tuple[Assumption, ...]] = field(default_factory=dict)
    would_tell: tuple[str, ...] = ()

    @property
    def is_extended(self) -> bool:
        """Whether there is a model beside the plain one: with the causes, or with the function of what has no name."""
        return self.extension is not None or (self.verdict == UNKNOWN and bool(self.terms))

    @property
    def mechanism(self) -> str | None:
        """The strongest; None for none and unknown."""
        return self.mechanisms[0] if self.verdict in (NAMED, AMBIGUOUS) and self.mechanisms else None
