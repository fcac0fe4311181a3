"""A function without a formula is a listed cause where it is that cause's but for the form, and only there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.judge import judge_session
from pipeline.diagnose.search import patterns
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.extended_model import Chosen, Extended
from pipeline.diagnose.search.form_functions import RegionChange, differentiate_regions
from pipeline.diagnose.search.likelihood import find_absorbed
from pipeline.diagnose.search.named_regions import name_regions
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.search.posterior import PLAIN, Hypothesis, Posterior, RegionFit, weigh_fit
from pipeline.diagnose.search.screen import compute_secants, compute_signatures
from pipeline.diagnose.search.several_causes import try_causes_of_form
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from schemas.arrays import Float
from tests.helpers.truth_rig import make_session as true_session

SESSION = 101
"""Seed of a session with nothing hidden: film, rig and noise are its, and what causes change is computed."""
SWEEPS_AND_CYCLES = (
    *({"protocol": "chirp", "strain_pp": s} for s in (0.006, 0.05)),
    *({"protocol": "cyclic", "strain_pp": s, "frequency_hz": 1.0, "cycles": 10} for s in (0.02, 0.12)),
)


@pytest.fixture(scope="module")
def plain() -> Extended:
    """The plain model of a session, without causes."""
    session = make_session([reduce(r) for r in true_session(SESSION, SWEEPS_AND_CYCLES, ()).recordings])
    simulation = Simulation(session)
    return Extended(session, simulation, fit_plain(session, simulation).model, (), np.ones(session.size))


@pytest.fixture(scope="module")
def theta(plain: Extended) -> Float:
    return fit_plain(plain.session, plain.simulation).theta


def hypothesis(plain: Extended, theta: Float, **causes: dict[str, float]) -> Hypothesis:
    """Listed causes at given parameters, film and rig at the plain model's."""
    of = replace(plain, chosen=tuple(Chosen(id, "") for id in causes))
    fit = of.fit(of.make_entries(theta, tuple(causes.values())), most=0)
    return Hypothesis("+".join(causes), -100.0, -4.0, fit, None, np.ones(1), np.zeros(1))


def region_like(plain: Extended, theta: Float, cause: Hypothesis, size: float, stage: str) -> Hypothesis:
    """The function of the amplitude in a stage that changes the features as a cause does, of that size."""
    fit = plain.refine(plain.fit(theta, most=0))
    change: RegionChange = next(
        c for c in differentiate_regions(fit) if (c.region.stage, c.region.covariate) == (stage, "amplitude")
    )
    effect = plain.session.whiten(cause.model.of.predict(cause.model.x) - plain.predict(theta))
    absorbed = find_absorbed(fit)
    columns = change.columns - absorbed @ (absorbed.T @ change.columns)
    weights = size * np.linalg.lstsq(columns, effect - absorbed @ (absorbed.T @ effect), rcond=None)[0]
    found = RegionFit(change.region, weights, np.eye(weights.size), fit, np.zeros(theta.size), 1.0)
    return Hypothesis(change.region.id, -90.0, -6.0, None, found, np.ones(1), np.zeros(1))


SLACK = {"overload": 0.1, "residual": 0.3, "softness": 1.0}
SOFTENING = {"drop": 0.02, "strain_scale": 0.5, "exponent": 1.0, "at_once": 0.1}


@pytest.mark.parametrize(
    ("size", "stage", "is_named"),
    [(1.0, "film", True), (1.2, "film", True), (-1.0, "film", False), (2.0, "film", False), (1.0, "contact", False)],
    ids=["alike", "a fifth larger", "of the other sign", "twice as large", "in another stage"],
)
def test_a_function_is_the_cause_whose_form_it_is_nearly(
    plain: Extended, theta: Float, size: float, stage: str, is_named: bool
) -> None:
    cause = hypothesis(plain, theta, amplitude_softening=SOFTENING)
    region = region_like(plain, theta, cause, size, stage)
    (named,), unnamed = name_regions([cause], [region], plain.refine(plain.fit(theta, most=0)))
    assert unnamed == ([] if is_named else [region])
    both = np.logaddexp(cause.log_joint, region.log_joint)
    assert named.log_joint == pytest.approx(both if is_named else cause.log_joint)


def test_what_a_region_says_is_shared_by_the_causes_that_it_may_be(plain: Extended, theta: Float) -> None:
    """Nothing of its probability is lost or counted twice."""
    cause = hypothesis(plain, theta, amplitude_softening=SOFTENING)
    weaker = replace(cause, log_evidence=cause.log_evidence - 3.0)
    region = region_like(plain, theta, cause, 1.0, "film")
    named, unnamed = name_regions([cause, weaker], [region], plain.refine(plain.fit(theta, most=0)))
    assert not unnamed
    total = np.logaddexp(np.logaddexp(cause.log_joint, weaker.log_joint), region.log_joint)
    assert np.logaddexp(named[0].log_joint, named[1].log_joint) == pytest.approx(total)
    assert named[0].log_joint - named[1].log_joint == pytest.approx(3.0)


def test_a_cause_that_all_probable_hypotheses_share_is_sure_whatever_is_beside_it(
    plain: Extended, theta: Float
) -> None:
    """What has no name is looked for beside it, also where a further cause is in doubt."""
    alone = hypothesis(plain, theta, amplitude_softening=SOFTENING)
    both = hypothesis(plain, theta, amplitude_softening=SOFTENING, slack=SLACK)
    other = replace(hypothesis(plain, theta, slack=SLACK), log_evidence=-110.0)
    found = Posterior.of([alone, replace(both, log_evidence=-99.5), other])
    assert [h.name for h in found.find_sure()] == ["amplitude_softening"]


def test_a_cause_that_is_sure_is_told_where_what_has_no_name_beside_it_is_likelier_than_all_names(
    plain: Extended, theta: Float
) -> None:
    """A clamp far from its file was `unknown`, because something in no list was there as well."""
    cause = hypothesis(plain, theta, amplitude_softening=SOFTENING)
    function = region_like(plain, theta, cause, 1.0, "contact").region
    assert function is not None
    beside = replace(
        cause, name="amplitude_softening+contact/amplitude", fit=None, log_evidence=-80.0,
        region=replace(function, plain=cause.model),
    )  # fmt: skip
    noise = replace(weigh_fit(plain.refine(plain.fit(theta, most=0))), name=PLAIN, log_evidence=-500.0)
    fit = cause.model
    nothing = Evidence(fit, compute_signatures(compute_secants(noise.model), noise.model), 0.0, 10.0, patterns.test_patterns(fit), plain=noise.model)  # fmt: skip
    found = replace(nothing, posterior=Posterior.of([noise, cause, beside]))
    assert found.sure is cause
    assert judge_session(found) == "ambiguous"
    alone = replace(beside, name="contact/amplitude", region=replace(function, plain=noise.model))
    doubtful = replace(nothing, posterior=Posterior.of([noise, cause, alone]))
    assert doubtful.sure is None
    assert judge_session(doubtful) == "unknown"


@pytest.mark.long
def test_causes_that_a_function_may_be_the_form_of_are_tried_where_none_was(plain: Extended, theta: Float) -> None:
    """One that is in another stage, or less probable than what is listed, asks for nothing."""
    fit = plain.refine(plain.fit(theta, most=0))
    base = replace(weigh_fit(fit), log_evidence=-200.0)
    changes = compute_secants(fit)
    softening = hypothesis(plain, theta, amplitude_softening=SOFTENING)
    region = region_like(plain, theta, softening, 1.0, "film")
    tried = {h.name for h in try_causes_of_form(base, [region], [], changes)}
    assert "amplitude_softening" in tried
    again = try_causes_of_form(base, [region], [replace(softening, log_evidence=-150.0)], changes)
    assert "amplitude_softening" not in {h.name for h in again}
    assert not try_causes_of_form(base, [region], [replace(softening, log_evidence=0.0)], changes)
