"""What is published of records that are asked alone never contradicts itself, whatever the models do.

Models are drawn, not fitted: good and bad ones, noise of any level, records of any unit, places that are wrong or are not. The study
of the same name (`tests/studies/study_consistency.py`) holds whole diagnoses against the same list.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.stats import chi2

from pipeline.analyse.diagnosis_tables import comparison_tables
from pipeline.diagnose.judge import judge_predictions
from pipeline.diagnose.results import Discrepancy, Estimate
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.single.comparison import TriedModel, compare_predictions
from pipeline.diagnose.single.report import Details, Films, list_smallest, report_comparison
from pipeline.physics.film import RelaxationModel
from tests.helpers.contradictions import find_contradictions

_CAUSES = {"strain_stiffening": "stiffening", "sensor_saturation": "overload", "missing_relaxation": "stiffness_ratio"}
_FILM = RelaxationModel(1.0, (), ())


def _draw_diagnosis(rng: np.random.Generator) -> tuple[str, list[str]]:
    """The verdict on drawn models, and what contradicts what."""
    n, sd = int(rng.integers(40, 400)), 10 ** rng.uniform(-9, 6)
    h = n // 2
    misfit = float(rng.choice([0.0, 0.3, 3.0, 300.0]))
    shape = np.sin(np.arange(n) * rng.uniform(0.01, 1))
    measured = sd * rng.standard_normal(n)

    def try_model(mechanism: str, share: float, spread: float) -> TriedModel:
        whole = sd * misfit * (1 - share) * shape
        unseen = whole[:h] + sd * spread * rng.normal()
        drawn = unseen + sd * spread * rng.standard_normal((50, 1))
        size = float(rng.choice([1e-12, 0.02, 0.5, 300.0]))
        value = size * rng.normal()
        estimate = Estimate(value, size, value - 1.6 * size, value + 1.6 * size)
        severity = {_CAUSES[mechanism]: estimate} if mechanism else {}
        return TriedModel(mechanism, mechanism and "a form", "", severity, whole, unseen, drawn)

    plain = try_model("", 0.0, 0.0)

    def draw_share() -> float:
        return float(rng.choice([rng.uniform(-0.5, 1.0), 1.0]))

    alike = draw_share() if rng.random() < 0.5 else None
    models = [
        try_model(id, draw_share() if alike is None else alike, float(rng.choice([0.0, 0.1, 10.0]))) for id in _CAUSES
    ]
    places = []
    for i, part in enumerate(np.array_split(np.arange(n), 5)):
        square = float(np.sum(((plain.whole - measured)[part] / sd) ** 2))
        places.append(Discrepancy("r", f"part {i}", square, part.size, float(chi2.sf(square, part.size)), "wrong"))
    found = compare_predictions(plain, models, measured, measured[:h], sd, [place.p_value for place in places])
    verdict = judge_predictions(found)
    details = Details(
        "S",
        ("noise",),
        {},
        Films(_FILM, _FILM),
        tuple(places),
        (),
        smallest=list_smallest(models),
        unexplained=("left",),
    )
    diagnosis = report_comparison(found, verdict, measured, measured[:h], sd, plain.whole, details)
    return verdict, find_contradictions(comparison_tables(diagnosis, found), alone=True)


@pytest.mark.study
def test_what_is_published_of_drawn_models_does_not_contradict_itself() -> None:
    verdicts = Counter[str]()
    for seed in range(120):
        verdict, found = _draw_diagnosis(np.random.default_rng([33, seed]))
        verdicts[verdict] += 1
        assert not found, f"{seed}, {verdict}: {found}"
    assert min(verdicts[v] for v in ("none", "named", "ambiguous", "unknown")) >= 5, verdicts


def test_a_part_that_is_far_beyond_the_noise_is_never_none() -> None:
    """A tenth of a record is wrong by five times the noise, which is taken for so loud that the whole looks right."""
    rng = np.random.default_rng(1)
    measured = rng.standard_normal(1000)
    whole = np.where(np.arange(1000) < 20, 5.0, 0.0)
    plain = TriedModel("", "", "", {}, whole, whole[:500], whole[None, :500])
    square = float(np.sum((whole - measured)[:20] ** 2)) / 1.3**2
    place = float(chi2.sf(square, 20))
    found = compare_predictions(plain, [plain], measured, measured[:500], 1.3, [place])
    assert place < 1e-20
    assert judge_predictions(found) != "none"
    assert found.p_value < RULES.adequacy.level


@pytest.mark.parametrize(
    ("misfit", "share", "verdict"),
    [(100.0, 0.99, "named"), (100.0, 0.74, "unknown"), (3.0, 1.0, "named"), (3.0, 0.74, "unknown")],
)
def test_a_cause_that_leaves_more_than_it_may_is_not_named(misfit: float, share: float, verdict: str) -> None:
    """A mechanism that explains 74 % of a misfit of an integrator, far better than the others, left 12 times the noise."""
    rng = np.random.default_rng(5)
    shape = np.sqrt(2) * np.sin(np.arange(400) * 0.3)
    measured = rng.standard_normal(400)
    left = misfit * float(np.sqrt(1 - share)) * shape
    plain = TriedModel("", "", "", {}, misfit * shape, misfit * shape[:200], misfit * shape[None, :200])
    cause = TriedModel("slack", "a form", "", {}, left, left[:200], left[None, :200])
    assert judge_predictions(compare_predictions(plain, [cause], measured, measured[:200], 1.0)) == verdict
