"""What fits say of recordings that were not made, how surely, and which of many proposals is worth making."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol, Self, TypeVar

import numpy as np

from pipeline.diagnose.features.kinds import TAP_RING, WEIGHT_GAIN
from pipeline.diagnose.features.noise_density import NoiseLaw
from pipeline.diagnose.proposals.designs import (
    MOST_OFTEN,
    OFTEN,
    Proposal,
    imagine_features,
    reduce_tests,
    repeat_proposal,
)
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import Extended, ExtendedFit
from pipeline.diagnose.simulation.session import Session, make_session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.least_squares import central
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError

_CALIBRATIONS = (TAP_RING, WEIGHT_GAIN)


def imagine_sessions(final: ExtendedFit) -> Callable[[Proposal], tuple[Session, Simulation] | None]:
    """What makes the proposed recordings after a session, and their simulation; None where they would have no features."""
    session = final.of.session
    reduced = reduce_tests(session, final.of.model.physical(final.theta))

    def imagine_session(proposal: Proposal) -> tuple[Session, Simulation] | None:
        try:
            new = imagine_features(session, reduced, proposal)
            later = make_session([*session.recordings, *new], _extend_laws(session, len(new)))
        except NotIdentifiableError:
            return None
        number = len(session.recordings)
        # What severities are relative to stays that of the session at hand, however large the new recording is.
        part = replace(later.part([p.recording >= number for p in later.places]), scale=session.scale)
        return part, Simulation(part, final.of.simulation)

    return imagine_session


def _extend_laws(session: Session, number: int) -> dict[tuple[int, str], NoiseLaw]:
    """Noise of a session's channels, with that of so many further recordings: as loud as that of the others."""
    return {
        key: replace(law, white=np.append(law.white, np.full(number, np.median(law.white))))
        for key, law in session.laws.items()
    }


@dataclass(frozen=True)
class Seen:
    """What a fit says of recordings that were not made, and how surely; all whitened.

    Parameters
    ----------
    fit : the fit
    of : its model over these recordings
    values : (N,) features
    rows : (N, P) how they move with the fit's entries
    root : (P, P) a root of the fit's covariance, L Lᵀ
    """

    fit: ExtendedFit
    of: Extended
    values: Float
    rows: Float
    root: Float

    @classmethod
    def of_fit(cls, part: Session, simulation: Simulation, fit: ExtendedFit) -> Seen:
        """What a fit says of the recordings of `part`."""
        of = fit.of.move_to(part, simulation, np.ones(part.size))
        of = replace(of, model=of.model.with_loads(part.loaded))
        rows = central(of.compute_data_residuals, fit.x, *of.limits)
        width = np.sqrt(np.diag(fit.covariance))
        values, vectors = np.linalg.eigh(fit.covariance / np.outer(width, width))
        root = width[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        return cls(fit, of, part.whiten(of.predict(fit.x)), rows, root)

    def measure_against(self, others: Float) -> float:
        """χ² that these recordings would say against the fit, were they as `others` (N,) say."""
        difference = others - self.values
        return self.measure_shown(difference, difference)

    def measure_shown(self, change: Float, forms: Float) -> float:
        """χ² of a change that the fit does not follow.

        Parameters
        ----------
        change : (N,) of the features
        forms : (N,) a difference that mechanisms predict, whose form is wrong by a share
        """
        if not (np.isfinite(change).all() and np.isfinite(forms).all()):
            return 0.0
        noise, moves, inner = self._share_out(forms)
        along = moves.T @ (change / noise)
        return float(np.sum((change / noise) ** 2) - along @ np.linalg.solve(inner, along))

    def measure_narrowing(self, forms: Float) -> float:
        """Change of twice the log evidence by what the recordings would say of the mechanisms' parameters.

        The more these are free to do, the more it costs.

        Parameters
        ----------
        forms : (N,) a difference that mechanisms predict, whose form is wrong by a share
        """
        if not np.isfinite(forms).all():
            return 0.0
        inner = self._share_out(forms)[2]
        after = self.root @ np.linalg.solve(inner, self.root.T)
        return 2 * (self.fit.log_volume(after) - self.fit.log_volume(self.fit.covariance))

    def _share_out(self, forms: Float) -> tuple[Float, Float, Float]:
        """The covariance of the recordings, noise and wrong forms on its diagonal and the fit's uncertainty beside it, as its parts.

        What forms may be wrong by is weighed down for the fit as well: it takes less of a change up. Calibrations have
        no forms.

        Returns
        -------
        Standard deviations (N,) of noise and forms, moves (N, P) of the fit in them, and (P, P) I + movesᵀ moves, with
        which the matrix inversion lemma (Woodbury) gives every inverse
        """
        wrong = np.where(np.isin(self.of.session.kind, _CALIBRATIONS), 0.0, RULES.proposal.form_error) * forms
        noise = np.sqrt(1 + wrong**2)
        moves = (self.rows @ self.root) / noise[:, None]
        return noise, moves, np.eye(moves.shape[1]) + moves.T @ moves


class Judged(Protocol):
    """A proposal, and what it is worth."""

    @property
    def proposal(self) -> Proposal: ...

    def compute_merit(self) -> float: ...

    def multiply(self, often: float) -> Self:
        """What so many times the data would be worth at most."""


J = TypeVar("J", bound=Judged)


@dataclass(frozen=True)
class Wanted:
    """Merit that is wanted of a proposal.

    Parameters
    ----------
    least : less is not proposed
    good : from here on nothing is made very often for more
    enough : from here on nothing is made often for more
    """

    least: float
    good: float
    enough: float


def choose_best(proposals: Iterable[Proposal], judge: Callable[[Proposal], J | None], wanted: Wanted) -> J | None:
    """The proposal of most merit, those included that are made more often where none is good without.

    Parameters
    ----------
    proposals : what could be made
    judge : the worth of one; None where it would have no features
    wanted : merits that decide

    Returns
    -------
    None where no proposal has the least merit
    """

    def best(some: Iterable[Proposal]) -> list[J]:
        """Best first."""
        judged = [judge(p) for p in some]
        return sorted((j for j in judged if j is not None), key=lambda j: j.compute_merit(), reverse=True)

    def longer(often: Mapping[str, int], worth: float) -> list[J]:
        """The best that, made so many times as often, may be worth that much."""
        hopeful = [j for j in found if j.multiply(often.get(j.proposal.test, 1)).compute_merit() >= worth]
        again = [p for p in (repeat_proposal(j.proposal, often) for j in hopeful) if p is not None]
        return best(again[:1])

    found = best(proposals)
    chosen = found[:1]
    for often, asked, worth in (
        (OFTEN, wanted.enough, wanted.enough),
        (MOST_OFTEN, wanted.good, wanted.least),
    ):
        if not any(j.compute_merit() >= asked for j in chosen):
            chosen = sorted([*longer(often, worth), *chosen], key=lambda j: j.compute_merit(), reverse=True)[:1]
    return chosen[0] if chosen and chosen[0].compute_merit() >= wanted.least else None
