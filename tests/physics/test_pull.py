"""Pulls to failure against curves written out in closed form, and a rig that pulls a film apart."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ingest.draft import make_draft
from pipeline import Lab
from pipeline.analyse.pull import NOT_ASKED
from pipeline.cli import main
from pipeline.fit.laws import fit_laws
from pipeline.transform.pull import measure_pull
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError

SHEAR, LIMIT = 60.0, 5.0
"""Shear modulus in kPa and largest stretch of the film, kPa and 1."""


def gent(stretch: Float) -> Float:
    """Gent's law (Rubber Chem. Technol. 69, 1996), which none of the fitted laws is: stress in kPa."""
    room = LIMIT**2 + 2 / LIMIT - 3
    return SHEAR * (stretch - stretch**-2) / (1 - (stretch**2 + 2 / stretch - 3) / room)


def pulled(
    noise: float, *, breaks_at: float = 3.7, samples: int = 3000, tear: int = 0, seed: int = 0
) -> tuple[Float, Float, Float]:
    """Time, stretch and stress of a pull at 0.05/s that ends after stretch 4."""
    time = np.linspace(0, 60, samples)
    stretch = 1 + 0.05 * time
    stress = gent(stretch) + np.random.default_rng(seed).normal(0, noise, samples)
    first = int(np.searchsorted(stretch, breaks_at))
    stress[first:] = np.random.default_rng(seed + 1).normal(0, noise, samples - first)
    for i in range(tear):
        stress[first + i] = gent(np.array([breaks_at]))[0] * (1 - (i + 1) / (tear + 1))
    return time, stretch, stress


def test_strength_break_and_work_are_those_of_the_curve() -> None:
    time, stretch, stress = pulled(noise=0.3)
    found = measure_pull(time, stretch, stress)
    assert found.broke
    assert found.stretch_at_break < 3.7 <= found.stretch_at_break_upper  # type: ignore[operator]
    assert found.strength_kpa == pytest.approx(gent(np.array([3.7]))[0], abs=1.5)
    assert found.strength_kpa_sd == pytest.approx(0.3, rel=0.1)
    assert found.stress_at_100_kpa == pytest.approx(gent(np.array([2.0]))[0], abs=1.2)
    assert found.stress_at_300_kpa is None
    fine = np.linspace(1, 3.7, 100_001)
    assert found.work_kpa == pytest.approx(np.trapezoid(gent(fine), fine), rel=2e-3)
    assert found.rate_per_s == pytest.approx(0.05, rel=1e-6)
    assert found.warnings == ()


def test_bounds_of_the_slope_hold_the_true_one() -> None:
    around = np.array([1 - 1e-6, 1 + 1e-6])
    true = np.diff(gent(around))[0] / 2e-6
    found = [measure_pull(*pulled(noise=0.5, samples=1500, seed=seed)) for seed in range(300)]
    held = np.mean([one.modulus_kpa_lower <= true <= one.modulus_kpa_upper for one in found])
    assert 0.90 <= held <= 0.995  # 95 % of 300: 92.5 to 97.5 % in 95 of 100 such tests
    wide = np.median([one.modulus_kpa_upper - one.modulus_kpa_lower for one in found])
    assert wide == pytest.approx(2 * 1.96 * np.std([one.modulus_kpa for one in found]), rel=0.2)


@pytest.mark.parametrize("tear", [1, 3, 8])
def test_a_film_that_tears_is_broken_where_it_begins_to(tear: int) -> None:
    time, stretch, stress = pulled(noise=0.05, tear=tear)
    found = measure_pull(time, stretch, stress)
    assert found.stretch_at_break == pytest.approx(3.7, abs=0.004)


def test_a_film_that_holds_gives_lower_bounds() -> None:
    time, stretch, stress = pulled(noise=0.3, breaks_at=9.0)
    found = measure_pull(time, stretch, stress)
    assert not found.broke
    assert found.stretch_at_break_upper is None
    assert found.stretch_at_break == pytest.approx(4.0)
    assert "did not break" in found.warnings[0]
    assert found.stress_at_300_kpa == pytest.approx(gent(np.array([4.0]))[0], abs=2)


def test_an_offset_and_slip_are_told() -> None:
    time, stretch, stress = pulled(noise=0.05)
    assert "an offset of the load cell" in measure_pull(time, stretch, stress + 20).warnings[0]
    slips = np.where((stretch > 3) & (stretch < 3.7), 0.9 * gent(np.array([3.0]))[0], stress)
    assert "well before the break" in measure_pull(time, stretch, slips).warnings[0]


def test_a_sensor_at_its_end_is_no_break(tmp_path: Path) -> None:
    time, stretch, stress = pulled(noise=0.05)
    with pytest.raises(NotIdentifiableError, match="stands still"):
        measure_pull(time, np.minimum(stretch, 3.2), stress)


def test_too_little_is_refused() -> None:
    time, stretch, stress = pulled(noise=0.1)
    for part in (slice(0, 5), slice(0, 0)):
        with pytest.raises(NotIdentifiableError):
            measure_pull(time[part], stretch[part], stress[part])
    with pytest.raises(NotIdentifiableError, match="breaks after"):
        measure_pull(time, stretch, np.where(np.arange(stress.size) < 6, stress + 1, 0.0))


@pytest.mark.parametrize(
    ("law", "truth", "curve"),
    [
        ("neo-Hookean", {"shear_modulus": 60.0}, lambda x: 60 * (x - x**-2)),
        ("Ogden, one term", {"shear_modulus": 60.0, "exponent": 3.0}, lambda x: 2 * 60 / 3.0 * (x**2.0 - x**-2.5)),
        ("non-affine", {"crosslink_modulus": 40.0, "entanglement_modulus": 55.0, "largest_stretch": 4.0},
         lambda x: 40 / 3 * (x - x**-2) * (9 * 16 - x**2 - 2 / x) / (3 * 16 - x**2 - 2 / x)
         + 55 * (1 - x**-1.5 - x**-2 + x**-0.5)),
    ],
)  # fmt: skip
def test_the_law_of_the_curve_is_found_with_its_parameters(law: str, truth: dict[str, float], curve: object) -> None:
    stretch = np.linspace(1, 4, 600)
    noise = np.random.default_rng(3).normal(0, 0.5, stretch.size)
    fits, curves = fit_laws(stretch, curve(stretch) + noise)  # type: ignore[operator]
    chosen = next(fit for fit in fits if fit.selected)
    assert chosen.law == law
    assert chosen.rmse == pytest.approx(0.5, rel=0.15)
    for name, value in truth.items():
        assert abs(chosen.parameters[name] - value) < 4 * chosen.sds[name], name
        assert chosen.sds[name] < 0.1 * value
    np.testing.assert_allclose(curves[law], curve(stretch), atol=0.5)  # type: ignore[operator]


CAMPAIGN = """
name = "pulls"
seed = 4
started_at = 2026-03-01T08:00:00+01:00
[rigs.stage]
clamp_mass_kg = 0.05
load_cell_stiffness_n_per_mm = 200.0
damping_ratio = 0.05
load_cell_range_n = 20.0
[rigs.stage.channels.displacement]
low = -50
high = 50
[rigs.stage.channels.force]
low = -20
high = 20
[materials.film]
k0_n_per_mm = 0.4
k_n_per_mm = [0.1]
c_n_s_per_mm = [0.2]
[specimens.T-1]
rig = "stage"
material = "film"
pretension_n = 0.0
[specimens.T-1.geometry]
film_length_mm = 20.0
film_width_mm = 10.0
film_thickness_mm = 1.0
stretch_1 = 1.0
[[recordings]]
test = "chirp"
specimens = ["T-1"]
id = "sweep"
sample_rate_hz = 500
amplitude_mm = 0.3
frequency_start_hz = 0.5
frequency_stop_hz = 50
rest_s = 8
[[recordings]]
test = "pull"
specimens = ["T-1"]
id = "pull"
format = "csv"
sample_rate_hz = 100
break_mm = 30.0
rate_mm_per_s = 2.0
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """A night over a sweep and a pull of one film on the virtual rig."""
    folder = tmp_path_factory.mktemp("pull")
    (folder / "pulls.toml").write_text(CAMPAIGN, encoding="utf-8")
    assert main(["simulate", str(folder / "pulls.toml"), "--out", str(folder / "raw")]) == 0
    assert main(["nightly", str(folder / "raw"), "--lab", str(folder / "lab"), "--jobs", "0"]) == 0
    return Lab(folder / "lab")


@pytest.mark.long
@pytest.mark.slow
def test_a_night_measures_a_pull_on_the_virtual_rig(lab: Lab) -> None:
    (row,) = lab.sql("SELECT * FROM pull_tests").to_dict("records")
    assert row["broke"]
    assert row["stretch_at_break"] <= 1 + 30 / 20 <= row["stretch_at_break_upper"] + 1e-3
    # a spring of 0.4 N/mm and a Maxwell arm of 0.1 N/mm and 2 s, drawn at 2 mm/s, over 10 mm²
    force = 0.4 * 30 + 0.2 * 2 * (1 - np.exp(-15 / 2))
    assert row["strength_kpa"] == pytest.approx(1e3 * force / 10, rel=5e-3)
    begins = 1 / (1 / (0.4 + 0.1) + 1 / 200)  # with the load cell behind the film, N/mm
    assert row["modulus_kpa_lower"] < 1e3 * begins * 20 / 10 < row["modulus_kpa_upper"]
    assert row["modulus_kpa"] == pytest.approx(1e3 * begins * 20 / 10, rel=5e-3)
    assert row["rate_per_s"] == pytest.approx(2 / 20, rel=5e-3)  # the load cell gives way by 0.25 %
    laws = lab.sql("SELECT * FROM pull_laws ORDER BY law").to_dict("records")
    assert [r["law"] for r in laws] == ["Ogden, one term", "neo-Hookean", "non-affine"]
    assert sum(r["selected"] for r in laws) == 1
    assert all(json.loads(r["parameters"]) for r in laws)


@pytest.mark.slow
def test_a_pull_is_not_asked_by_the_diagnosis(lab: Lab) -> None:
    (diagnosis,) = lab.sql("SELECT verdict FROM diagnoses").to_dict("records")
    assert diagnosis["verdict"] in ("none", "unknown", "named", "ambiguous")
    (notes,) = lab.sql("SELECT notes FROM recordings WHERE protocol = 'pull'")["notes"]
    assert NOT_ASKED in notes
    assert lab.sql("SELECT * FROM without_result").empty


@pytest.mark.slow
def test_the_page_shows_where_the_film_breaks(lab: Lab) -> None:
    pages = list((lab.folder / "reports").rglob("*.html"))
    (page,) = [p for p in pages if "Pulls to failure" in p.read_text(encoding="utf-8")]
    text = page.read_text(encoding="utf-8")
    assert "The film breaks at stretch 2.50 under 1240" in text
    assert "break at stretch 2." in text


@pytest.mark.slow
def test_a_pull_without_a_mapping_is_recognised(lab: Lab) -> None:
    source = Path(lab.sql("SELECT source_path FROM recordings WHERE protocol = 'pull'")["source_path"][0])
    bare = lab.folder / "bare.csv"
    bare.write_bytes(source.read_bytes())
    draft = make_draft(bare)
    assert (draft.content["recording"]["protocol"], draft.content["recording"]["loading"]) == ("pull", "mechanical")
