"""What the search for causes found in a session: the fits, tests and probabilities from which the verdict is read.

Does not belong here: the verdict (`pipeline.diagnose.judge`), and its words (`pipeline.diagnose.report`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from scipy.special import logsumexp

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.patterns import Patterns
from pipeline.diagnose.search.posterior import PLAIN, Hypothesis, Posterior, RegionFit, weigh_fit
from pipeline.diagnose.search.screen import Signatures
from pipeline.diagnose.simulation.parameters import BaseModel
from schemas.arrays import Float


@dataclass(frozen=True)
class Evidence:
    """The fits behind a verdict.

    Parameters
    ----------
    noise_fit : the plain model at its optimum under the noise alone
    signatures : about that model, of all mechanisms that the session can show
    p_value : probability that the noise alone makes the search find as much
    threshold : Λ at the false-alarm level of the search
    patterns_before : smooth patterns in the residual of `noise_fit`
    plain : the plain model under weights that allow for causes of any form
    singles : every mechanism that was fitted alone under the weights of `plain`, best evidence first; the lag of the amplifier alone
        where that is beyond doubt, and all else was asked beside it
    posterior : of all hypotheses; None where nothing is beyond the noise
    final : the listed causes that are told, under the weights of `plain`, the strongest first: those that are as good as certain beside
        what has no name, the most probable hypothesis otherwise; None where there is none, or the plain model is more probable
    patterns_after : smooth patterns that the best causes leave, or the plain model where there are none
    louder : (N,) weights of the residuals under the noise that the likelihood makes of the session, where nothing is found beyond that;
        None where the noise is that of the rests
    gain : held-out gain of the causes that are told; NaN as long as no part was left out, or where none can be stated
    with_arm : the plain model with one more arm and its entries, where causes ask for that: the search has to begin anew with it
    """

    noise_fit: ExtendedFit
    signatures: Signatures
    p_value: float
    threshold: float
    patterns_before: Patterns
    plain: ExtendedFit
    singles: tuple[ExtendedFit, ...] = ()
    posterior: Posterior | None = None
    final: ExtendedFit | None = None
    patterns_after: Patterns | None = None
    louder: Float | None = None
    with_arm: tuple[BaseModel, Float] | None = None
    gain: float = float("nan")

    @property
    def best(self) -> Hypothesis | None:
        """The most probable hypothesis of listed causes; None where the plain model is more probable."""
        return None if self.posterior is None else find_best(self.posterior)

    @property
    def log_evidence(self) -> float:
        """Of the session, under all hypotheses together."""
        if self.posterior is None:
            return weigh_fit(self.noise_fit, noise_alone=True).log_joint
        return float(logsumexp([h.log_joint for h in self.posterior.hypotheses]))

    @property
    def is_unnamed(self) -> bool:
        """Whether something is found, and that listed causes are all of it is less probable than not, or than that there is nothing."""
        posterior = self.posterior
        return posterior is not None and (self.best is None or posterior.named_share < RULES.verdict.listed)

    def learn_gain(self, gain: float) -> Evidence:
        """The evidence with the held-out gain of the causes that it tells: those that predict next to nothing are hardly there."""
        found = replace(self, gain=gain)
        if not found.explains_nothing or self.posterior is None:
            return found
        return replace(found, posterior=self.posterior.doubt_listed(RULES.gain.listed_below))

    @property
    def explains_nothing(self) -> bool:
        """Whether the causes that are told are known to predict next to nothing of parts that were left out."""
        return self.gain < RULES.gain.least_told

    @property
    def sure(self) -> Hypothesis | None:
        """Listed causes that are as good as certain beside what has no name; None where there are none but the amplifier's lag, which
        is no cause of what the film shows.
        """
        if self.posterior is None or not self.is_unnamed or self.explains_nothing:
            return None
        found = self.posterior.find_sure_beside()
        lag = () if self.given is None else self.given.of.mechanism_ids
        return None if found is None or {*found.causes} <= {*lag} else found

    @property
    def given(self) -> ExtendedFit | None:
        """The plain model with the lag of the amplifier, where all else was asked beside it."""
        lag = self.singles[0] if len(self.singles) == 1 else None
        return lag if lag is not None and lag.of.leaves_film else None

    @property
    def function(self) -> RegionFit | None:
        """The most probable function of a region without a name; None where there is none."""
        regions = () if self.posterior is None else self.posterior.regions
        return regions[0].region if regions else None

    @property
    def credible(self) -> tuple[Hypothesis, ...]:
        """The fewest hypotheses among which the truth is with `verdict.credible`."""
        return () if self.posterior is None else self.posterior.find_set(RULES.verdict.credible)

    @property
    def may_be_unlisted(self) -> bool:
        """Whether the credible hypotheses hold one without a name, or something speaks against the best."""
        best = self.best
        return any(not h.causes for h in self.credible) or (
            best is not None and not (best.shortfall.is_adequate and self.predicts)
        )

    @property
    def predicts(self) -> bool:
        """Whether nothing is known against what the causes predict of parts that were left out."""
        return not self.gain < RULES.gain.least_named


def find_best(posterior: Posterior) -> Hypothesis | None:
    """The most probable hypothesis of listed causes; None where the plain model with what reality does now and then is more
    probable than it.

    Parameters
    ----------
    posterior : of all hypotheses
    """
    plain = next(h for h in posterior.hypotheses if h.name == PLAIN)
    best = next(iter(posterior.listed), None)
    return best if best is not None and best.log_joint > plain.log_joint else None
