"""The probability that a search finds as much by chance, where the noise is known and where it is itself in doubt."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.diagnose.search.screen import Signatures


@pytest.fixture(scope="module")
def signatures() -> Signatures:
    """Sixty places of a search that share eight independent directions."""
    rng = np.random.default_rng(seed=5)
    seen = rng.normal(size=(60, 8))
    seen /= np.linalg.norm(seen, axis=1)[:, None]
    return Signatures((), (), seen @ seen.T, np.ones(60), np.zeros(60), np.zeros(60, dtype=bool))


def test_doubt_about_the_noise_makes_nothing_less_likely_by_chance(signatures: Signatures) -> None:
    found = np.linspace(12, 40, 15)  # where it is rare
    known = np.array([signatures.compute_p(x) for x in found])
    doubted = np.array([signatures.compute_p_in_doubt(x, 0.3) for x in found])
    assert np.all(doubted > known)
    assert np.all(np.diff(doubted) < 0)
    assert np.all(doubted < 1)


def test_without_doubt_both_are_one(signatures: Signatures) -> None:
    for x in (8.0, 15.0, 25.0):
        assert signatures.compute_p_in_doubt(x, 1e-3) == pytest.approx(signatures.compute_p(x), rel=0.05)


def test_it_holds_its_level_where_the_variance_is_drawn(signatures: Signatures) -> None:
    """Noise whose variance is a Γ about the expected one: a probability below 2 % is seen in 2 % of the draws."""
    rng = np.random.default_rng(seed=6)
    variance = rng.gamma(1 / 0.3**2, 0.3**2, 4000)
    directions = np.linalg.cholesky(signatures.correlation + 1e-9 * np.eye(60))
    scores = np.sqrt(variance) * (directions @ rng.normal(size=(60, 4000)))
    found = np.maximum(scores.max(axis=0), 0.0) ** 2
    limit = min(x for x in np.linspace(5, 40, 141) if signatures.compute_p_in_doubt(x, 0.3) < 0.02)
    assert np.mean(found > limit) == pytest.approx(0.02, abs=0.008)
