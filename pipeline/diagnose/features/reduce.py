"""From a recording to its features: the one door, by protocol, with what sessions need to know beside them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pipeline.diagnose.features.chirp import chirp_blocks
from pipeline.diagnose.features.cyclic import cyclic_blocks
from pipeline.diagnose.features.kinds import EXTRA_MASS, FeatureBlock, NoiseSample, RecordingFeatures
from pipeline.diagnose.features.observed import HELD, find_dead, observe_channels
from pipeline.diagnose.features.ramp import cycle_blocks, relaxation_blocks
from pipeline.diagnose.features.records import strain_length_mm
from pipeline.diagnose.features.rest import calibration_blocks, hum_block
from pipeline.diagnose.features.sphs import sphs_blocks
from pipeline.diagnose.features.step import step_blocks
from pipeline.diagnose.features.voltage_chirp import voltage_chirp_blocks
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.simulation.nodes import response_nodes
from pipeline.physics.film import EPSILON_0_N_PER_KV2
from pipeline.physics.rig import TONNES_PER_KG
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata
from schemas.protocols import CALIBRATION, ELECTRICAL, MECHANICAL
from schemas.recording import Recording

Reducer = Callable[[Recording, Float], tuple[list[FeatureBlock], list[NoiseSample], dict[str, float], list[str]]]

_REDUCERS: dict[tuple[str, str], Reducer] = {
    ("chirp", MECHANICAL): chirp_blocks,
    ("chirp", ELECTRICAL): voltage_chirp_blocks,
    ("cyclic", MECHANICAL): cyclic_blocks,
    ("step", MECHANICAL): relaxation_blocks,
    ("cycle", MECHANICAL): cycle_blocks,
    ("sphs", ELECTRICAL): sphs_blocks,
    ("sphs", "other"): sphs_blocks,
    ("step", ELECTRICAL): step_blocks,
}


def reducible(protocol: str, loading: str) -> bool:
    """Whether recordings of that protocol and loading have features."""
    return (protocol, loading) in _REDUCERS or (loading == CALIBRATION and protocol in ("tap", "weight"))


def reduce(recording: Recording) -> RecordingFeatures:
    """Features of a recording. Raises `NotIdentifiableError` for protocols without any and for records that carry none."""
    metadata = recording.metadata
    key = metadata.protocol, metadata.loading
    if not reducible(*key):
        raise NotIdentifiableError(
            f"{metadata.loading} {metadata.protocol} recordings are not simulated",
            where=metadata.recording_id,
            expected=", ".join(sorted({f"{loading} {protocol}" for protocol, loading in _REDUCERS})),
        )
    # With what was on the clamp, where it rings.
    heavy = replace(recording, rig=recording.rig.loaded(metadata.extra_clamp_mass_kg))
    nodes = response_nodes(heavy.rig)
    noise: list[NoiseSample] = []
    values: dict[str, float] = {}
    warnings: list[str] = []
    observed = observe_channels(recording)
    dead = find_dead(observed)
    if metadata.loading == CALIBRATION:
        blocks, values, warnings = calibration_blocks(recording)
    elif dead:
        # No response, but the fault is to be said.
        blocks, warnings = [], [f"{' and '.join(f'the {name} stands still' for name in dead)}: nothing is measured"]
    else:
        try:
            blocks, noise, values, warnings = _REDUCERS[key](heavy, nodes)
        except NotIdentifiableError as error:
            if not any(name.startswith(HELD) and share > RULES.fault.held for name, share in observed.items()):
                raise
            blocks, warnings = [], [str(error)]  # for what a channel has lost, which is to be said
        hum = hum_block(recording) if blocks and metadata.loading in (MECHANICAL, ELECTRICAL) else None
        blocks += [] if hum is None else [hum]
    values |= _values(recording) | observed
    return RecordingFeatures(
        recording_id=metadata.recording_id,
        specimen_id=metadata.specimen_id,
        protocol=metadata.protocol,
        loading=metadata.loading,
        started_at=metadata.started_at,
        duration_s=recording.duration_s,
        rig=recording.rig,
        blocks=tuple(blocks),
        noise=tuple(noise),
        nodes=nodes,
        values=values,
        settings={"command": "recorded" if "command" in recording.channels else "not recorded"},
        warnings=tuple(warnings),
    )


def _values(recording: Recording) -> dict[str, float]:
    metadata = recording.metadata
    # A calibration has no film, and what its file says of one is left out or a dummy.
    values = {} if metadata.loading == CALIBRATION else {"strain_length_mm": strain_length_mm(recording)}
    if metadata.rest_before_s is not None:
        values["rest_before_s"] = metadata.rest_before_s
    if recording.rig.load_cell_range_n is not None:
        values["force_range_n"] = recording.rig.load_cell_range_n
    temperature = recording.channels.get("temperature")
    if temperature is not None and np.isfinite(temperature.values).any():
        values["temperature_degc"] = float(np.nanmean(temperature.values))
    if metadata.extra_clamp_mass_kg:
        values[EXTRA_MASS] = metadata.extra_clamp_mass_kg * TONNES_PER_KG
    expected = actuation_prior(metadata)
    if expected is not None:
        values["actuation_n_per_kv2"], values["actuation_sd"] = expected
        values["layers"] = float(metadata.layers or 1)
    return values


def actuation_prior(metadata: RecordingMetadata) -> tuple[float, float] | None:
    """F_A/V² = ε0 εr w/z × share of the length that is active, N/kV², and its relative standard deviation; None if unknown.

    w and z are current sizes (thesis, eq 4.8); film in series with the active part passes on its share (real for one material).
    """
    needed = (
        metadata.relative_permittivity,
        metadata.active_width_mm,
        metadata.layer_thickness_mm,
        metadata.pre_stretch,
    )
    if any(x is None for x in needed):
        return None
    permittivity, width, thickness, along = (float(x) for x in needed if x is not None)
    across = metadata.lateral_stretch or along**-0.5
    drawn = metadata.active_drawn == "undeformed"
    width *= across if drawn else 1.0
    layers = metadata.layers or 1
    force = EPSILON_0_N_PER_KV2 * permittivity * width * along * across / thickness * layers
    total = metadata.total_length_mm or (metadata.film_length_mm or 0.0) * along
    if metadata.active_length_mm and total:
        force *= min(1.0, metadata.active_length_mm * (along if drawn else 1.0) / total)
    sd = metadata.relative_permittivity_sd
    return force, RULES.features.permittivity_sd if sd is None else sd / permittivity
