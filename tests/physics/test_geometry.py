"""One meaning of the film's sizes everywhere: `film_thickness_mm` is the whole film, `layers` says how often it is divided."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.analyse.cycle import stretch_and_stress
from pipeline.fit.relaxation.metrics import Geometry
from pipeline.fit.sensing.self_sensing import actuation_per_voltage_squared, current_section_mm2
from pipeline.simulate.procedures.calibration import Calibration
from pipeline.simulate.procedures.electrical import Electrical
from pipeline.simulate.procedures.mechanical import Mechanical
from pipeline.simulate.specimen import Deviations, Material, Specimen
from pipeline.transform.channels import drive
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording
from tests.physics.rig_truth import START_NS

STACK = {
    "recording_id": "stack",
    "protocol": "cyclic",
    "loading": "mechanical",
    "specimen_id": "ST-1",
    "started_at": "2024-03-04T08:00:00+00:00",
    "film_length_mm": "10",
    "film_width_mm": "10",
    "film_thickness_mm": "10",
    "stretch_1": "2",
}


def about(**keys: str) -> RecordingMetadata:
    return RecordingMetadata.parse(STACK | keys, where="stack")


def specimen(sizes: dict[str, Any]) -> Specimen:
    film = Material(k0_n_per_mm=1.0, relative_permittivity=4.7)
    return Specimen("S", "rig", "film", film, Deviations(), sizes)


def test_the_thesis_stack_has_its_modulus() -> None:
    """Ten layers, 10 × 10 mm, 10 mm thick, stretch 2, k0 0.40 N/mm: 0.16 MPa (section 4.4.1), not a tenth of it."""
    found = Geometry.of(about(layers="10"))
    assert found is not None
    assert (found.length_mm, found.section_mm2) == (20.0, 50.0)
    assert found.modulus_mpa(0.40) == pytest.approx(0.16)


@given(st.integers(1, 40))
def test_layers_do_not_change_the_section(layers: int) -> None:
    metadata = about(layers=str(layers))
    assert Geometry.of(metadata) == Geometry.of(about())
    assert current_section_mm2(metadata) == 50.0
    assert metadata.layer_thickness_mm == 10.0 / layers
    time = START_NS + np.arange(5, dtype=np.int64) * 1_000_000
    channels = {
        "stretch": Channel("stretch", time, np.linspace(1.0, 1.4, 5)),
        "stress": Channel("stress", time, np.linspace(0.0, 20.0, 5), resolution=0.5),
    }
    found = drive(Recording(metadata, RigConstants(), channels))
    assert found.input.values == pytest.approx(np.linspace(0.0, 4.0, 5))
    assert found.output.values == pytest.approx(np.linspace(0.0, 2.0, 5))  # 20 kPa on 100 mm²
    assert found.output.resolution == pytest.approx(0.05)


@given(st.integers(1, 12), st.sampled_from(["undeformed", "stretched"]))
def test_rig_and_analysis_agree_on_the_force_of_a_stack(layers: int, drawn: str) -> None:
    """Each layer has the whole voltage across its share of the thickness: the force grows with the square of their number."""
    sizes = {
        "film_length_mm": 50.0,
        "film_width_mm": 50.0,
        "film_thickness_mm": 2.0,
        "stretch_1": 1.4,
        "active_length_mm": 30.0,
        "active_width_mm": 40.0,
        "active_drawn": drawn,
        "relative_permittivity": 4.7,
        "layers": layers,
    }
    expected = actuation_per_voltage_squared(about(**{k: str(v) for k, v in sizes.items()}))
    film = specimen(sizes).film(electrical=True)
    assert expected is not None
    share = 30.0 * (1.4 if drawn == "undeformed" else 1.0) / 70.0
    assert film.force_per_voltage_squared == pytest.approx(expected.value * share)
    single = specimen({**sizes, "layers": 1}).film(electrical=True)
    assert film.force_per_voltage_squared == pytest.approx(layers**2 * single.force_per_voltage_squared)


@pytest.mark.parametrize("base", [Calibration, Mechanical, Electrical])
def test_what_tests_share_is_no_test(base: type) -> None:
    assert inspect.isabstract(base)
    with pytest.raises(TypeError, match="abstract"):
        base()


def pulled(**sizes: str | None) -> Recording:
    """A film pulled by 40 mm and back in 4 s with 5 N at the top."""
    keys = {k: v for k, v in (STACK | {"protocol": "cycle"} | sizes).items() if v is not None}
    half = np.linspace(0.0, 1.0, 21)
    course = np.concatenate([half, half[-2::-1]])
    time_ns = START_NS + (np.arange(course.size) * 1e8).astype(np.int64)
    channels = {
        "displacement": Channel("displacement", time_ns, 40.0 * course),
        "force": Channel("force", time_ns, 5.0 * course),
    }
    return Recording(RecordingMetadata.parse(keys, where="pulled"), RigConstants(), channels)


@pytest.mark.parametrize(
    ("sizes", "first", "largest", "stress_kpa"),
    [
        ({"stretch_1": None, "film_length_mm": "80"}, 1.0, 1.5, 50.0),
        ({"stretch_1": "1", "film_length_mm": "80"}, 1.0, 1.5, 50.0),
        ({"stretch_1": "2", "film_length_mm": "80"}, 2.0, 2.5, 50.0),
        ({"stretch_1": None, "film_length_mm": "80", "film_width_mm": None}, 1.0, 1.5, 5000.0),
        ({"stretch_1": None, "film_length_mm": None}, 1.0, 41.0, 50.0),
    ],
)
def test_sizes_without_a_pre_stretch_are_those_of_a_film_mounted_as_it_is(
    sizes: dict[str, str | None], first: float, largest: float, stress_kpa: float
) -> None:
    """They were once left aside as a whole, and a film of 80 mm was a cube of 1 mm stretched 41 times."""
    _, stretch, stress = stretch_and_stress(pulled(**sizes))
    assert stretch[0] == pytest.approx(first)
    assert stretch.max() == pytest.approx(largest)
    assert stress.max() == pytest.approx(stress_kpa)
