"""A model that believes its sizes, whatever the actuation says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.plain_fit import begin_arm
from pipeline.diagnose.simulation.parameters import ACTUATION
from tests.helpers.truth_rig import Effect
from tests.physics.test_regions import plain_model


@pytest.mark.slow
def test_a_model_that_believes_its_sizes_keeps_to_them_with_another_arm() -> None:
    of = plain_model(331, Effect("field_dependent_permittivity", 0.05)).of
    place = of.model.index(ACTUATION)
    assert place is not None
    theta = np.array([e.mean for e in of.model.entries])
    theta[place] += 100 * of.model.prior_sd[place]
    believed = replace(of.model, is_sized=True)
    assert not np.isfinite(of.model.free_actuation(theta, RULES.prior.contradicted).prior_sd[place])
    assert believed.free_actuation(theta, RULES.prior.contradicted) is believed
    more, _ = begin_arm(of.session, believed, theta, 0.3, 1.0)
    assert more.is_sized
