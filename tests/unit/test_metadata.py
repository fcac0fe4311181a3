"""Metadata and rig constants: what is required, what is malformed, what comes back from text."""

from __future__ import annotations

import math
from dataclasses import fields
from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import RefusedError
from schemas.metadata import RecordingMetadata, RigConstants, TableMetadata
from schemas.protocols import PROTOCOLS, missing_channels, protocol

REQUIRED = {
    "recording_id": "r-1.a_B",
    "protocol": "sphs",
    "loading": "electrical",
    "specimen_id": "s1",
    "started_at": "2026-03-01T15:05:00+01:00",
}


def test_all_keys_from_text_and_back() -> None:
    text = REQUIRED | {
        "film_length_mm": "70",
        "stretch_1": "2.0",
        "layers": "1",
        "masses_kg": "0.1, 0.2,0.5",
        "extra_clamp_mass_kg": "0.05",
        "controller": "closed",
        "rest_before_s": "0",
        "failure_site": "rod",
        "weather": "rain",
        "notes": "",
    }
    found = RecordingMetadata.parse(text)
    assert found.started_at == datetime(2026, 3, 1, 14, 5, tzinfo=UTC)
    assert (found.film_length_mm, found.layers, found.masses_kg) == (70.0, 1, (0.1, 0.2, 0.5))
    assert found.notes is None
    assert found.extra == {"weather": "rain"}
    assert RecordingMetadata.parse(found.to_text()) == found


@pytest.mark.parametrize("key", list(REQUIRED))
def test_each_required_key_is_named_when_missing(key: str) -> None:
    for raw in ({k: v for k, v in REQUIRED.items() if k != key}, REQUIRED | {key: "  "}):
        with pytest.raises(RefusedError, match=f"required key {key} is missing"):
            RecordingMetadata.parse(raw, where="a.mcap")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("recording_id", "-x"),
        ("recording_id", "a b"),
        ("recording_id", "ä"),
        ("recording_id", "a/../b"),
        ("recording_id", "x" * 81),
        ("recording_id", "a\n"),
        ("protocol", "Chirp"),
        ("loading", "both"),
        ("started_at", "yesterday"),
        ("started_at", "2026-03-01"),
        ("started_at", "2026-13-01T00:00:00Z"),
        ("film_width_mm", "0"),
        ("film_width_mm", "nan"),
        ("film_width_mm", "1e999"),
        ("film_width_mm", "1,5"),
        ("film_width_mm", True),
        ("repeats", "0"),
        ("repeats", "1.5"),
        ("sweep", "quadratic"),
        ("masses_kg", "0.1,-0.2"),
        ("drive_kv", "-1"),
    ],
)
def test_malformed_keys_are_named_with_value_and_expectation(key: str, value: Any) -> None:
    with pytest.raises(RefusedError) as refused:
        RecordingMetadata.parse(REQUIRED | {key: value}, where="a.mcap")
    assert key in refused.value.problem
    assert refused.value.expected
    assert refused.value.where == "a.mcap"


def test_protocol_and_loading_must_go_together() -> None:
    with pytest.raises(RefusedError, match='loading "mechanical" does not go with protocol sphs') as refused:
        RecordingMetadata.parse(REQUIRED | {"loading": "mechanical"})
    assert "electrical" in refused.value.expected


def test_lateral_stretch_of_a_uniaxial_film() -> None:
    uniaxial = RecordingMetadata.parse(REQUIRED | {"stretch_1": 4})
    assert uniaxial.lateral_stretch == pytest.approx(0.5)
    assert RecordingMetadata.parse(REQUIRED | {"stretch_1": 4, "stretch_2": 3}).lateral_stretch == 3
    assert RecordingMetadata.parse(REQUIRED).lateral_stretch is None


@given(st.dictionaries(st.text(max_size=20), st.text(max_size=50), max_size=5))
def test_unknown_keys_are_kept_or_refused_never_changed(extra: dict[str, str]) -> None:
    known = set(RecordingMetadata.__dataclass_fields__)
    extra = {k: v for k, v in extra.items() if k not in known}
    try:
        found = RecordingMetadata.parse(REQUIRED | extra)
    except RefusedError:
        assert any("\x00" in v for v in extra.values())
        return
    assert dict(found.extra) == extra


def test_rig_constants_with_noise_and_back() -> None:
    text = {
        "rig_id": "r1",
        "clamp_mass_kg": "0.05",
        "clamp_mass_kg_sd": "0.001",
        "force_noise_sd": "1e-3",
        "paint": "red",
    }
    rig = RigConstants.parse(text)
    assert (rig.clamp_mass_kg, rig.clamp_mass_kg_sd, rig.noise_sd) == (0.05, 0.001, {"force": 1e-3})
    assert rig.extra == {"paint": "red"}
    assert RigConstants.parse(rig.to_text()) == rig
    for key in ("clamp_mass_kg", "force_noise_sd", "load_cell_range_n"):
        with pytest.raises(RefusedError, match=f"rig.{key}"):
            RigConstants.parse({key: "-1"})


def test_table_metadata_needs_only_its_name() -> None:
    found = TableMetadata.parse({"recording_id": "t1", "configuration": "rods", "origin": "paper"})
    assert (found.configuration, found.started_at, found.extra) == ("rods", None, {"origin": "paper"})
    assert TableMetadata.parse(found.to_text()) == found
    with pytest.raises(RefusedError, match="recording_id"):
        TableMetadata.parse({})
    with pytest.raises(RefusedError, match="protocol"):
        TableMetadata.parse({"recording_id": "t1", "protocol": "dance"})


def test_missing_channels_of_the_nearest_alternative() -> None:
    chirp = protocol("chirp", "mechanical")
    assert missing_channels(chirp, {"displacement", "force"}) == ()
    assert missing_channels(chirp, {"stress", "stretch"}) == ()
    assert missing_channels(chirp, {"stress", "force", "displacement"}) == ()
    assert missing_channels(chirp, {"stress"}) == ("stretch",)
    assert all(p.required for p in PROTOCOLS.values())
    assert not math.isnan(len(PROTOCOLS))


def test_a_mass_on_the_clamp_adds_to_its_own_and_lowers_its_frequency() -> None:
    rig = RigConstants(
        clamp_mass_kg=0.1, load_cell_stiffness_n_per_mm=20.0, clamp_frequency_hz=70.0, clamp_frequency_hz_sd=0.1
    )
    heavy = rig.loaded(0.3)
    assert heavy.clamp_mass_kg == pytest.approx(0.4)
    assert (heavy.clamp_frequency_hz, heavy.clamp_frequency_hz_sd) == pytest.approx((35.0, 0.05))
    assert heavy.load_cell_stiffness_n_per_mm == 20.0
    assert rig.loaded(None) is rig.loaded(0.0) is rig
    unknown = RigConstants(load_cell_stiffness_n_per_mm=20.0)
    assert unknown.loaded(0.3) is unknown


@pytest.mark.parametrize("cls", [RecordingMetadata, RigConstants])
def test_every_key_says_what_it_means(cls: type) -> None:
    """Standard deviations are told with the key that they belong to; a table's keys are those of a recording."""
    keys = {f.name: f.metadata["meaning"] for f in fields(cls) if "parser" in f.metadata}
    unsaid = {name for name, meaning in keys.items() if not meaning}
    assert unsaid <= {f"{name}_sd" for name in keys}
    assert {f.name for f in fields(TableMetadata)} <= {f.name for f in fields(RecordingMetadata)}
