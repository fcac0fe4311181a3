"""The master curve on a specimen's page, and what is not known there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.inputs import Measured
from pipeline.analyse.temperatures import TEMPERATURE, join_temperatures
from pipeline.transform.response import STIFFNESS, FrequencyResponse
from reports.build import build_reports
from schemas.metadata import RigConstants, TableMetadata
from tests.helpers.synthetic_lab import Story
from tests.helpers.viscoelastic_truth import frequency_isotherms


def tables(*, second: float = 0.0, unit: str = "MPa", only: int = 5, **about: object) -> list[Measured]:
    """Tables of one film at several temperatures, as the recording stage carries them."""
    found = []
    for one in frequency_isotherms(np.random.default_rng(8), second=second)[:only]:
        response = FrequencyResponse(
            one.axis, one.value, one.variance, np.ones(one.axis.size, dtype=bool), STIFFNESS, "mechanical",
            recording_id=one.recording_id, specimen_id="T-1",
            details={"measured_as": "modulus", "scale": 1.0, "unit": unit, TEMPERATURE: one.temperature_c},
        )  # fmt: skip
        metadata = TableMetadata.parse({"recording_id": str(one.recording_id), "specimen_id": "T-1", **about})
        found.append(Measured(metadata, RigConstants(), (response,)))
    return found


def page_of(folder: Path, measured: list[Measured]) -> str:
    """The text of the specimen's page."""
    analysis, story = Analysis(), Story()
    join_temperatures(analysis, "T-1", measured)
    assert not analysis.failures
    for one in measured:
        story.recording(one.recording_id, "T-1", "", "mechanical", kind="frequency_response")
    for name, rows in analysis.joined().items():
        story.rows[name] += rows.to_pylist()
    story.run()
    lab = story.write(folder / "lab")
    build_reports(lab)
    page = (lab / "reports" / "specimens" / "T-1.html").read_text(encoding="utf-8")
    page = re.sub(r'<img[^>]*alt="([^"]*)"[^>]*>', r" \1 ", page)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page)).replace("\xa0", " ")


def test_a_master_curve_has_its_part_of_the_page(tmp_path: Path) -> None:
    text = page_of(tmp_path, tables())
    assert "Five temperatures make one curve at 25.0 °C over 5.8 decades" in text
    assert re.search(r"WLF ✓ 8\.\d+ \(7\.\d+–8\.\d+\) 1[45]\d\.?\d* \(1[34]\d\.?\d*–1[56]\d\.?\d*\)", text)
    assert "Warning." not in text.split("Shifts by temperature")[0].split("make one curve")[1]


def test_the_page_warns_with_numbers_where_the_superposition_fails(tmp_path: Path) -> None:
    text = page_of(tmp_path, tables(second=0.3, unit="kPa"))
    assert "Master curve of T-1 in kPa" in text
    assert "but for more than noise at five of them" in text
    assert "Warning. Time-temperature superposition leaves more than noise at 5 of 5 temperatures" in text


@pytest.mark.parametrize(("about", "at"), [({}, 25.0), ({"reference_temperature_c": "55"}, 60.0)])
def test_the_reference_is_the_nearest_to_23_degrees_or_to_what_is_asked(about: dict[str, str], at: float) -> None:
    analysis = Analysis()
    joined, unit = join_temperatures(analysis, "T-1", tables(**about))
    assert unit is not None
    assert unit.name == "MPa"
    assert analysis.joined()["master_curves"]["reference_c"].to_pylist() == [at]
    (curve,) = joined[0].of(FrequencyResponse)
    assert curve.recording_id is None
    assert curve.frequency_hz.size == 5 * 19
    assert np.all(np.diff(curve.frequency_hz) >= 0)
    assert not any(one.results for one in joined[1:])


def test_repeats_at_one_temperature_stay_what_they_are() -> None:
    one = tables(only=1)
    given = [*one, *one]
    joined, unit = join_temperatures(Analysis(), "T-1", given)
    assert (joined, unit) == (given, None)


def test_vertical_shifts_are_used_where_they_are_asked_for() -> None:
    analysis = Analysis()
    join_temperatures(analysis, "T-1", tables(vertical_shift="free"))
    curve = analysis.joined()["master_curves"].to_pylist()[0]
    assert curve["vertical"] is True
    assert curve["vertical_p"] is None
    assert any(row["b"] != 1 for row in analysis.joined()["shift_factors"].to_pylist())
