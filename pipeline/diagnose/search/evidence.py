"""What the search for causes found in a session: the fits and tests from which the verdict is made.

Does not belong here: the verdict (`pipeline.diagnose.judge`), and its words (`pipeline.diagnose.report`).
"""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.free_quantities import FreeQuantity
from pipeline.diagnose.search.patterns import Patterns
from pipeline.diagnose.search.screen import Signatures


@dataclass(frozen=True)
class Evidence:
    """The fits behind a verdict; all with tempered weights but `noise_fit`, whose weights are those of the noise alone.

    Parameters
    ----------
    noise_fit : the plain model at its optimum under the noise alone
    signatures : about that model, of all mechanisms that the session can show
    p_value : probability that the noise alone makes the search find as much
    threshold : Λ at the false-alarm level of the search
    patterns_before : smooth patterns in the residual of `noise_fit`
    is_discrepant : whether there is anything to explain
    plain : the plain model
    singles : every mechanism that was fitted alone, best evidence first
    final : the model with the causes that are believed; None where no mechanism is worth its parameters
    alternatives : fits that do as well with another mechanism in place of the strongest cause
    explained : share of the plain model's misfit that the causes explain
    patterns_after : smooth patterns that `final` leaves, or `plain` where there is none
    surely_beside, beside : free quantities that differ beside the causes: surely, and at least faintly
    instead : free quantities that explain more than the causes, in their place
    """

    noise_fit: ExtendedFit
    signatures: Signatures
    p_value: float
    threshold: float
    patterns_before: Patterns
    is_discrepant: bool
    plain: ExtendedFit
    singles: tuple[ExtendedFit, ...] = ()
    final: ExtendedFit | None = None
    alternatives: tuple[ExtendedFit, ...] = ()
    explained: float = float("nan")
    patterns_after: Patterns | None = None
    surely_beside: tuple[FreeQuantity, ...] = ()
    beside: tuple[FreeQuantity, ...] = ()
    instead: tuple[FreeQuantity, ...] = ()

    @property
    def leaves_pattern(self) -> bool:
        """Whether the causes leave a pattern. Where the plain model shows none, a weak one may be what is not known of
        the noise."""
        shown = self.patterns_before.p_value < RULES.alarm.pattern_level
        level = RULES.alarm.left_level if shown else RULES.alarm.pattern_level
        return self.patterns_after is not None and self.patterns_after.p_value < level
