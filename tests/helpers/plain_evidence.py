"""What a search finds that tries no cause."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.diagnose.faults.fitted import fit_session
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.extended_model import Extended
from pipeline.diagnose.search.patterns import test_patterns as find_patterns
from pipeline.diagnose.search.posterior import Posterior, weigh_fit
from pipeline.diagnose.search.screen import compute_secants, compute_signatures


def find_plain(features: Sequence[RecordingFeatures]) -> Evidence:
    """The plain model of a session under the noise, as a hypothesis of noise alone and with what nobody has thought of."""
    session, simulation, plain = fit_session(features)
    of = Extended(session, simulation, plain.model, (), np.ones(session.size))
    fit = of.refine(of.fit(plain.theta))
    signatures = compute_signatures(compute_secants(fit), fit)
    posterior = Posterior.of([weigh_fit(fit, noise_alone=True), weigh_fit(fit)])
    return Evidence(fit, signatures, 0.0, 10.0, find_patterns(fit), plain=fit, posterior=posterior)
