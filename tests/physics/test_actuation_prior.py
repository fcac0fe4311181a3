"""What the geometry says of the actuation, before any fit: layers act side by side on thinner films."""

from __future__ import annotations

import pytest

from pipeline.diagnose.features.reduce import actuation_prior
from pipeline.physics.film import EPSILON_0_N_PER_KV2
from schemas.metadata import RecordingMetadata

KEYS = {
    "recording_id": "r1",
    "protocol": "sphs",
    "loading": "electrical",
    "specimen_id": "S",
    "started_at": "2026-01-01T00:00:00Z",
    "film_thickness_mm": "1.0",
    "film_length_mm": "20",
    "stretch_1": "1.0",
    "active_width_mm": "40",
    "active_drawn": "stretched",
    "relative_permittivity": "4.0",
}


@pytest.mark.parametrize("layers", [1, 2, 5])
def test_layers_of_one_film_act_in_parallel_on_thinner_films(layers: int) -> None:
    """Maxwell: ε0 εr w V²/z per layer; a film of the same whole thickness in n layers gives n² of it."""
    found = actuation_prior(RecordingMetadata.parse({**KEYS, "layers": str(layers)}))
    assert found is not None
    force, sd = found
    assert force == pytest.approx(EPSILON_0_N_PER_KV2 * 4.0 * 40.0 / 1.0 * layers**2)
    assert sd == pytest.approx(0.1)
