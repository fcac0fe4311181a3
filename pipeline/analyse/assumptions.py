"""What the analyses of a recording take for granted: every default that stands for a key or a channel which is missing.

Each rule here has its counterpart where the default is used; whoever gives a key a default adds the rule. What a reader
takes for granted of times and units comes with the recording (`Recording.assumptions`). Does not belong here: defaults
that no result depends on.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING

from ingest.tables import LifetimeTable, RelaxationTable, ResponseTable
from pipeline.diagnose.features.reduce import reducible
from pipeline.fit.relaxation.metrics import Geometry
from pipeline.physics.rig import missing_constants, rig_prior
from schemas.assumptions import Assumption
from schemas.metadata import RecordingMetadata, RigConstants, TableMetadata
from schemas.numbers import compact
from schemas.protocols import ELECTRICAL, MECHANICAL, WITH_RIG
from schemas.recording import Recording
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

_SIZES = ("film_length_mm", "film_width_mm", "film_thickness_mm")
_FORCE_OF_FILM = "model_fits, predictions and diagnoses of the specimen"


def assumption_table(about: RecordingMetadata | TableMetadata, assumed: Collection[Assumption]) -> pa.Table:
    """Rows of `assumptions`."""
    return TABLES["assumptions"].from_objects(
        assumed, recording_id=about.recording_id, specimen_id=getattr(about, "specimen_id", None)
    )


def find_assumptions(recording: Recording) -> tuple[Assumption, ...]:
    """What the analyses of a recording take for granted, what its reader did first.

    Parameters
    ----------
    recording : any recording; of one of loading `other` only what its reader assumed is told
    """
    about, channels = recording.metadata, frozenset(recording.channels)
    found = list(recording.assumptions)
    if about.loading in (MECHANICAL, ELECTRICAL):
        found += _about_film(about, channels)
    if about.loading == MECHANICAL:
        found += _about_pull(about, channels)
    if about.loading == ELECTRICAL:
        found += _about_voltage(about, recording.rig, channels)
    if (about.protocol, about.loading) in WITH_RIG:
        found += _about_rig(recording.rig)
    found += _about_unused(recording)
    return tuple(found)


def find_table_assumptions(table: LifetimeTable | ResponseTable | RelaxationTable) -> tuple[Assumption, ...]:
    """What is taken for granted of a table that stands instead of recordings."""
    if isinstance(table, LifetimeTable):
        return table.assumptions
    about, found = table.metadata, list(table.assumptions)
    if table.measured_as == "modulus" and about.film_length_mm is None:
        found.append(_cube("a modulus is given and none of " + ", ".join(_SIZES)))
    found.append(
        Assumption(
            "clamp and load cell",
            "not in the response",
            "the table is what a machine computed, and no rig goes with it",
            _FORCE_OF_FILM,
        )
    )
    if isinstance(table, RelaxationTable):
        because = "the table does not say how long the ramp took"
        found.append(Assumption("step of the relaxation", "a jump", because, "relaxation times near the ramp's"))
    return tuple(found)


def _cube(because: str) -> Assumption:
    return Assumption(
        "sizes of the film",
        "a cube of 1 mm: 1 MPa = 1 N/mm, stretch − 1 = mm",
        because,
        "stiffnesses in N/mm, moduli in MPa, stretch and stress",
    )


def _about_film(about: RecordingMetadata, channels: Collection[str]) -> Iterator[Assumption]:
    """Sizes and pre-stretches."""
    missing = [name for name in _SIZES if getattr(about, name) is None]
    given = len(missing) < len(_SIZES)
    in_stress = {"stretch", "stress"} & set(channels)
    if (about.protocol in ("cycle", "pull") or in_stress) and missing and about.loading == MECHANICAL:
        if in_stress or not given:
            yield _cube(f"{', '.join(missing)} not given")
        else:
            parts = [] if about.film_length_mm is not None else ["length 1 mm"]
            parts += [] if about.undeformed_section_mm2 is not None else ["cross-section 1 mm²"]
            yield Assumption(
                "sizes of the film", ", ".join(parts), f"{', '.join(missing)} not given", "stretch, stress and moduli"
            )
    if about.stretch_1 is None and about.pre_stretch is not None:
        yield Assumption(
            "pre-stretch along the force",
            "1",
            "undeformed sizes are given and no stretch_1: mounted as it is",
            "moduli, stretch, field, expected forces",
        )
    if about.stretch_2 is None and about.pre_stretch is not None and about.loading == ELECTRICAL:
        yield Assumption(
            "pre-stretch across the force",
            f"{compact(about.lateral_stretch, 4)}, 1/√stretch_1",
            "no stretch_2: uniaxial",
            "thickness, field, expected forces and permittivity",
        )
    if about.loading == MECHANICAL and Geometry.of(about) is not None:
        yield Assumption(
            "volume of the film",
            "kept: its section falls as 1/stretch_1",
            "no section was measured under load",
            "moduli",
        )


def _about_pull(about: RecordingMetadata, channels: Collection[str]) -> Iterator[Assumption]:
    """Directions, zero and history of a mechanical test."""
    if {"displacement", "force"} <= set(channels):
        yield Assumption(
            "polarity of displacement and force",
            "extension and tension positive, as recorded",
            "a recording cannot tell which way its channels count",
            "the sign of every stiffness",
        )
    if about.protocol in ("cycle", "pull") and "displacement" in channels and about.film_length_mm is not None:
        yield Assumption(
            "rest length",
            f"displacement 0 is stretch {compact(about.pre_stretch, 4)}",
            "no channel gives the length itself",
            "stretch of the whole cycle, and moduli",
        )
    if about.rest_before_s is None:
        yield _at_rest()


def _at_rest() -> Assumption:
    return Assumption(
        "rest before the recording",
        "as long as it takes: at rest at its first sample",
        "no rest_before_s",
        "relaxation, diagnoses",
    )


def _about_voltage(about: RecordingMetadata, rig: RigConstants, channels: Collection[str]) -> Iterator[Assumption]:
    """Electrodes, permittivity, amplifier and history of an electrical test."""
    electrode = about.active_length_mm is not None or about.active_width_mm is not None
    if electrode and about.active_drawn is None:
        drawn = "undeformed" if about.protocol == "force_map" else "stretched"
        yield Assumption(
            "state of the film whose electrode was measured", drawn, "no active_drawn", "expected forces, permittivity"
        )
    if about.layers is None and about.film_thickness_mm is not None:
        yield Assumption("layers", "1", "no layers", "field, expected forces and permittivity")
    if about.layers is not None and about.layers > 1 and about.film_thickness_mm is not None:
        yield Assumption(
            "film_thickness_mm of a stack",
            "that of all layers together",
            f"{about.layers} layers",
            "field, expected forces and permittivity; diagnoses, where the actuation does not say that it is of one layer",
        )
    if about.relative_permittivity is not None and about.relative_permittivity_sd is None:
        yield Assumption(
            "standard deviation of the permittivity",
            "10 %",
            "no relative_permittivity_sd",
            "modulus from self-sensing, diagnoses of the actuation",
        )
    if "command" in channels and rig.amplifier_gain_kv_per_v is None:
        yield Assumption(
            "gain of the amplifier",
            "the measured voltage over its command",
            "no amplifier_gain_kv_per_v in the rig file",
            "diagnoses of the drive",
        )
    if about.protocol == "lifetime":
        if about.voltage_setpoint_kv is None:
            because = "no voltage_setpoint_kv"
            yield Assumption("set point", "the level that the record holds", because, "start of the life, its group")
        if about.test_duration_s is None:
            yield Assumption(
                "planned duration of the test", "until the voltage goes", "no test_duration_s", "what ended the life"
            )
    elif about.rest_before_s is None and about.protocol != "force_map":
        yield _at_rest()
    if about.rods is not None and about.electrode_gap_mm is None:
        because = "no electrode_gap_mm"
        yield Assumption("electrodes over the rods", "one over all of the film", because, "weak_regions")
    if about.rods is not None and None in (about.film_length_mm, about.film_width_mm):
        because = "no film_length_mm or no film_width_mm"
        yield Assumption("film over the rods", "as large as its electrode", because, "weak_regions")


def _about_unused(recording: Recording) -> Iterator[Assumption]:
    """Channels that no analysis of this kind of recording takes: what they show is taken to make no difference."""
    about, channels = recording.metadata, recording.channels
    kind = about.definition()
    used = {*kind.optional, *next(given for given in kind.required if set(given) <= channels.keys())}
    if reducible(about.protocol, about.loading):
        used.add("temperature")
    for name in sorted(channels.keys() - used):
        yield Assumption(
            f"channel {name}",
            "not used",
            f"no analysis of {about.loading} {about.protocol} recordings takes it",
            "every result, if what it shows matters",
        )


def _about_rig(rig: RigConstants) -> Iterator[Assumption]:
    """Constants of clamp and load cell that the rig file does not give."""
    name = f"rig file of {rig.rig_id}" if rig.rig_id else "the rig's keys"
    lacking = missing_constants(rig)
    if lacking is not None:
        yield Assumption(
            "clamp and load cell", "not in the response", f"no load_cell_stiffness_n_per_mm in {name}", _FORCE_OF_FILM
        )
        return
    prior = rig_prior(rig)
    for one in () if prior is None else prior.presumed:
        yield Assumption(one.what, one.value, f"not in {name}", "clamp resonance in " + _FORCE_OF_FILM)
    if rig.force_gain is None:
        yield Assumption("gain of the force channel", "1", f"no force_gain in {name}: never calibrated", "all forces")
