"""What a mechanism is: its equation, its parameters, where it acts, and the effect that a simulation composes.

    command → [drive] → V → [actuation] → F_A → [film] → T → [contact] → [rig] → F, x → [sensor] → [drift] → recorded

Belongs here: the types. One object per mechanism stands in the file of its family.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pipeline.diagnose.features import kinds
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.simulation.describing import Loads
from pipeline.diagnose.simulation.effects import Effect, Scale

STAGES = ("drive", "actuation", "film", "contact", "rig", "sensor", "drift")
SEVERITY, SHAPE = "severity", "shape"
Values = Mapping[str, float]

SWEEPS = frozenset({kinds.CHIRP_RESPONSE, kinds.CHIRP_HARMONIC, kinds.CHIRP_LEVEL})
CYCLES = frozenset({kinds.CYCLIC_RESPONSE, kinds.CYCLIC_HARMONIC, kinds.CYCLIC_LEVEL})
RAMPS = frozenset({kinds.RELAXATION_FORCE, kinds.CYCLE_FORCE})
MECHANICAL = SWEEPS | CYCLES | RAMPS | {kinds.CYCLIC_CAPACITANCE}
SPHS_FORCE = frozenset({kinds.SPHS_RESPONSE, kinds.SPHS_DETECTION})
VOLTAGE_CHIRPS = frozenset({kinds.VOLTAGE_CHIRP_RESPONSE, kinds.VOLTAGE_CHIRP_HARMONIC})
FORCES = SWEEPS | CYCLES | RAMPS | SPHS_FORCE | VOLTAGE_CHIRPS | {kinds.STEP_FORCE}
"""Kinds of the force of a film, in any test: what bends it shows in them."""
STEP_SENSED = frozenset({kinds.STEP_FORCE, kinds.STEP_CAPACITANCE})
ELECTRICAL = STEP_SENSED | VOLTAGE_CHIRPS | kinds.UNDER_VOLTAGE | kinds.SENSED
"""Kinds that follow H; with the lines that a linear film leaves empty: `BENT`."""
BENT = ELECTRICAL | SPHS_FORCE
AMPLIFIER = kinds.AMPLIFIER


@dataclass(frozen=True)
class Parameter:
    """A parameter of a mechanism.

    `low` to `high` is the plausible range of its size (no limit), `least` and `most` are hard limits. The effect vanishes
    where all severities are 0; a shape has no effect by itself. `log`: searched and believed uniform in the logarithm of its
    size. `signed`: both signs are possible. `factor`: 1 + value multiplies a constant that the plain model searches in the
    logarithm; its own logarithm is searched, so that the two can change places. `start` is where a search begins. `only`: the
    variants that have it; none: all.
    """

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    role: str = SEVERITY
    log: bool = True
    signed: bool = False
    factor: bool = False
    least: float = 0.0
    most: float = float("inf")
    only: tuple[str, ...] = ()

    def is_at_limit(self, value: float) -> bool:
        """Whether a fit ended at the largest value, or, of one with both signs, the least that there can be."""
        nearly = RULES.adequacy.at_limit
        return value > nearly * self.most or (self.signed and self.least < 0 and value < nearly * self.least)

    @property
    def start(self) -> float:
        return (self.low * self.high) ** 0.5 if self.log else (self.low + self.high) / 2


@dataclass(frozen=True)
class Context:
    """What severities are relative to: the session's scale, its loads without mechanisms, rest force N (NaN unknown)."""

    scale: Scale
    loads: Loads
    rest_force_n: float


@dataclass(frozen=True)
class Mechanism:
    """A way in which the simulation can be wrong: one entry of the list, and all that the diagnosis needs to know of it.

    Parameters
    ----------
    id : name in the contract
    stage : one of STAGES
    depends_on : what its effect depends on, in the words of the contract; empty where it is the same everywhere
    equation : what it does, as a formula in words that a report can show
    source : where the equation comes from
    parameters : severities first, then shapes
    shows : kinds of features that can show it; in all others the effect is exactly absent
    faint : protocols of those in which it is too small to count on (the resonance is far above, the strain is tiny)
    confusable : other mechanism → what separates the two
    effect : parameters by name, variant → what it changes in the simulation
    variants : versions of its equation that are tried one by one; the first is the usual one
    onset : its severity is (largest load)/(onset) − 1, and its first derivative vanishes there: a score at 0 does not see it
    absorbed : whether film and rig of the plain model can take its place, so that a screen sees next to nothing of a strong one; it is
        searched from several severities then, with film and rig fitted to each first
    varies_with : what its size may change with beside that, where its formula has none of it
    relaxes : whether it is a relaxation of the film, of which another arm of the plain model could take a part
    softening : parameters → share of the film's static stiffness that stays; a fit starts with a film stiffer by its inverse
    as_arm : stiffness over k0, time constant s → parameters at which it is an arm as the plain model's; None: it never is one
    as_filed : errors of the clamp mass and of the load-cell stiffness (true over filed, less 1) → parameters that say the same, so
        that a fit can start with the rig as its file has it; None: it says nothing of them
    report : parameters, variant, context → the keys of the contract; None: the parameters are those keys
    """

    id: str
    stage: str
    depends_on: tuple[str, ...]
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    shows: frozenset[str]
    confusable: Mapping[str, str]
    effect: Callable[[Values, str], Effect]
    faint: tuple[str, ...] = ()
    variants: tuple[str, ...] = ("",)
    onset: bool = False
    absorbed: bool = False
    varies_with: tuple[str, ...] = ()
    relaxes: bool = False
    softening: Callable[[Values], float] | None = field(default=None)
    as_arm: Callable[[float, float], Values] | None = field(default=None)
    as_filed: Callable[[float, float], Values] | None = field(default=None)
    report: Callable[[Values, str, Context], Mapping[str, float | str]] | None = field(default=None)

    @property
    def forms(self) -> tuple[str, ...]:
        """Its variants, with those that no screen tries: parameters alone name them."""
        named = dict.fromkeys(form for p in self.parameters for form in p.only)
        return self.variants + tuple(form for form in named if form not in self.variants)

    @property
    def usual_variants(self) -> tuple[str, ...]:
        """Those of its variants that have no parameter of their own."""
        own = {form for p in self.parameters for form in p.only}
        return tuple(v for v in self.variants if v not in own)

    def list_parameters(self, variant: str) -> tuple[Parameter, ...]:
        """The parameters that a variant has."""
        return tuple(p for p in self.parameters if not p.only or variant in p.only)

    @property
    def covariates(self) -> tuple[str, ...]:
        """What its form may be another function of."""
        return self.depends_on + self.varies_with

    @property
    def severities(self) -> tuple[Parameter, ...]:
        """Parameters without which the effect vanishes."""
        return tuple(p for p in self.parameters if p.role == SEVERITY)

    def list_shapes(self, variant: str) -> tuple[Parameter, ...]:
        """Parameters of a variant that have no effect by themselves."""
        return tuple(p for p in self.list_parameters(variant) if p.role == SHAPE)

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name."""
        return next(p for p in self.parameters if p.name == name)

    def report_severity(self, values: Values, variant: str, context: Context) -> dict[str, float | str]:
        """Severity by the keys of the contract.

        Parameters
        ----------
        values : parameters by name
        variant : of the equation
        context : what severities are relative to
        """
        return dict(values) if self.report is None else dict(self.report(values, variant, context))
