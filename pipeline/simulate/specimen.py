"""Specimens as they truly are: material, geometry, electrodes, and the film that the rig feels.

What the recording's metadata say about a specimen is its `geometry`, word for word; what is true follows from geometry,
material and the specimen's own deviations.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pipeline.physics.film import RelaxationModel
from pipeline.simulate.bench import Film
from pipeline.simulate.tables import number, numbers, text
from schemas.errors import UsageError
from schemas.metadata import RecordingMetadata

EPSILON_0_N_PER_KV2 = 8.8541878e-6
EPSILON_0_PF_PER_MM = 8.8541878e-3

GEOMETRY = (
    "film_length_mm",
    "film_width_mm",
    "film_thickness_mm",
    "stretch_1",
    "stretch_2",
    "layers",
    "active_length_mm",
    "active_width_mm",
    "active_drawn",
    "sensing_length_mm",
    "sensing_width_mm",
    "sensing_region",
    "total_length_mm",
    "rods",
    "rod_spacing_mm",
    "rod_diameter_mm",
    "electrode_gap_mm",
    "relative_permittivity",
    "relative_permittivity_sd",
    "configuration",
)
"""Keys of the recording's metadata that describe a specimen."""


@dataclass(frozen=True)
class Material:
    """A film's relaxation model for the specimens of one kind (springs N/mm; arms by times s or dampers N s/mm).

    `c_inf_n_s_per_mm` is a pure dashpot. `relative_permittivity` is the true one.
    """

    k0_n_per_mm: float = number(above=0)
    k_n_per_mm: tuple[float, ...] = numbers((), above=0)
    tau_s: tuple[float, ...] | None = numbers(None, above=0)
    c_n_s_per_mm: tuple[float, ...] | None = numbers(None, above=0)
    c_inf_n_s_per_mm: float = number(0.0, at_least=0)
    relative_permittivity: float | None = number(None, at_least=1)

    def __post_init__(self) -> None:
        given = [times for times in (self.tau_s, self.c_n_s_per_mm) if times is not None]
        if len(given) != (1 if self.k_n_per_mm else 0):
            raise ValueError("arms need k_n_per_mm and one of tau_s and c_n_s_per_mm")
        if given and len(given[0]) != len(self.k_n_per_mm):
            raise ValueError(f"{len(self.k_n_per_mm)} springs but {len(given[0])} dampers or times")

    @property
    def model(self) -> RelaxationModel:
        if self.tau_s is not None:
            times = self.tau_s
        else:
            times = tuple(c / k for c, k in zip(self.c_n_s_per_mm or (), self.k_n_per_mm, strict=True))
        arms = sorted(zip(self.k_n_per_mm, times, strict=True), key=lambda arm: -arm[1])
        return RelaxationModel(
            self.k0_n_per_mm, tuple(k for k, _ in arms), tuple(t for _, t in arms), self.c_inf_n_s_per_mm
        )


def scaled(model: RelaxationModel, stiffness: float = 1.0, time: float = 1.0) -> RelaxationModel:
    """The model with all stiffnesses and all relaxation times multiplied."""
    return RelaxationModel(
        model.k0 * stiffness,
        tuple(k * stiffness for k in model.k),
        tuple(t * time for t in model.tau),
        model.c_inf * stiffness * time,
    )


@dataclass(frozen=True)
class Deviations:
    """How one specimen differs from its material, and what is under its electrodes.

    `active_springs` multiplies the springs of the arms in the active part (its electrode makes it relax more);
    `constrained_length_mm` is the part of the stretched length that a glued-on layer holds rigid. `blocked_scale`
    multiplies the static force of force maps in direction 1: rods across it add to it, and gaps in an electrode take less
    than their area.
    Under a field the permittivity changes by `permittivity_per_kv2` × V², with the time constant `permittivity_time_s`.
    """

    stiffness_scale: float = number(1.0, above=0)
    time_scale: float = number(1.0, above=0)
    permittivity_scale: float = number(1.0, above=0)
    active_springs: float = number(1.0, above=0)
    pretension_n: float = number(0.0, at_least=0)
    constrained_length_mm: float = number(0.0, at_least=0)
    blocked_scale: float = number(1.0, above=0)
    permittivity_per_kv2: float = number(0.0)
    permittivity_time_s: float = number(100.0, above=0)
    rest_capacitance_pf: float | None = number(None, above=0)
    rest_before_s: float | None = number(None, at_least=0)
    batch: str | None = text(None)
    notes: str | None = text(None)


@dataclass(frozen=True)
class Specimen:
    """One specimen. `effects`: mechanism → parameters of what is hidden in its recordings."""

    name: str
    rig_name: str
    material_name: str
    material: Material
    deviations: Deviations
    geometry: Mapping[str, Any] = field(default_factory=dict)
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def model(self) -> RelaxationModel:
        """Relaxation model of the whole film, as stretched on the rig."""
        return scaled(self.material.model, self.deviations.stiffness_scale, self.deviations.time_scale)

    @property
    def permittivity(self) -> float:
        """True relative permittivity. Raises `UsageError` where the campaign gives none."""
        if self.material.relative_permittivity is None:
            raise UsageError(
                "relative_permittivity is missing",
                where=f"materials.{self.material_name}",
                expected=f"a value, because {self.name} is tested under voltage",
            )
        return self.material.relative_permittivity * self.deviations.permittivity_scale

    def metadata(self) -> dict[str, Any]:
        """What the recordings say about the specimen."""
        values: dict[str, Any] = {"specimen_id": self.name, "material": self.material_name, "rig_id": self.rig_name}
        values |= self.geometry
        if self.deviations.batch is not None:
            values["batch"] = self.deviations.batch
        if self.deviations.rest_before_s is not None:
            values["rest_before_s"] = self.deviations.rest_before_s
        if self.deviations.constrained_length_mm:
            values["constrained_length_mm"] = self.deviations.constrained_length_mm
        return values

    @property
    def sizes(self) -> Sizes:
        return Sizes.of(self)

    def film(self, *, electrical: bool) -> Film:
        """The film as the rig feels it: its active, sensing and passive parts in series; `electrical`: under voltage."""
        own = self.deviations
        simple = own.active_springs == 1 and not own.constrained_length_mm and "sensing_length_mm" not in self.geometry
        if not electrical and simple:
            return Film((self.model,), pretension_n=own.pretension_n)
        sizes = self.sizes
        if electrical and not sizes.active_length_mm:
            raise UsageError("active_length_mm is missing", where=f"specimens.{self.name}", expected="an electrode")
        free = sizes.total_length_mm - own.constrained_length_mm
        shared = self.geometry.get("sensing_region") == "active"
        sensing_mm = 0.0 if shared else sizes.sensing_length_mm
        rest = free - sizes.active_length_mm - sensing_mm
        if rest < -1e-9:
            raise UsageError(f"the parts are {-rest:.3g} mm longer than the film", where=f"specimens.{self.name}")
        force = 0.0
        if electrical:
            force = sizes.layers * self.permittivity * EPSILON_0_N_PER_KV2 * sizes.active_width_mm / sizes.thickness_mm
        if own.active_springs == 1 and not sizes.sensing_length_mm:
            # One relaxation everywhere: the share that reaches the ends is that of the lengths, at every frequency.
            whole, share = scaled(self.model, sizes.total_length_mm / free), sizes.active_length_mm / free
            return Film((whole,), 0 if electrical else None, force * share, own.pretension_n)
        lengths = {"active": sizes.active_length_mm, "sensing": sensing_mm, "rest": max(rest, 0.0)}
        parts = {
            name: scaled(self.model, sizes.total_length_mm / length)
            for name, length in lengths.items()
            if length > 1e-9
        }
        if "active" in parts:
            springs = tuple(k * own.active_springs for k in parts["active"].k)
            parts["active"] = dataclasses.replace(parts["active"], k=springs)
        names = list(parts)
        watched = names.index("active" if shared else "sensing") if sizes.sensing_length_mm else None
        return Film(
            tuple(parts.values()),
            active=0 if electrical else None,
            force_per_voltage_squared=force,
            pretension_n=own.pretension_n,
            sensing=watched,
            sensing_length_mm=sizes.active_length_mm if shared else sizes.sensing_length_mm,
            rest_capacitance_pf=0.0 if watched is None else self._rest_capacitance(sizes),
            shared=shared,
            permittivity_per_kv2=own.permittivity_per_kv2,
            permittivity_time_s=own.permittivity_time_s,
        )

    def _rest_capacitance(self, sizes: Sizes) -> float:
        if self.deviations.rest_capacitance_pf is not None:
            return self.deviations.rest_capacitance_pf
        area = sizes.sensing_length_mm * sizes.sensing_width_mm
        return sizes.layers * EPSILON_0_PF_PER_MM * self.permittivity * area / sizes.thickness_mm


@dataclass(frozen=True)
class Sizes:
    """Sizes in mm in the stretched state; 0 for a region that is not there. `thickness_mm` is that of one of the `layers`."""

    layers: int
    thickness_mm: float
    total_length_mm: float
    active_length_mm: float
    active_width_mm: float
    sensing_length_mm: float
    sensing_width_mm: float

    @classmethod
    def of(cls, specimen: Specimen) -> Sizes:
        """Sizes of a specimen; `UsageError` where the geometry does not give them."""
        where = f"specimens.{specimen.name}"
        geometry = specimen.geometry

        def size(key: str) -> float:
            if key not in geometry:
                raise UsageError(f"{key} is missing", where=where, expected="the size in mm")
            return float(geometry[key])

        stretch_1 = float(geometry.get("stretch_1", 1.0))
        stretch_2 = float(geometry.get("stretch_2", stretch_1**-0.5))
        drawn = geometry.get("active_drawn", "stretched") == "undeformed"
        along, across = (stretch_1, stretch_2) if drawn else (1.0, 1.0)
        total = geometry.get("total_length_mm")
        layers = int(geometry.get("layers", 1))
        return cls(
            layers=layers,
            thickness_mm=size("film_thickness_mm") / layers / (stretch_1 * stretch_2),
            total_length_mm=float(total) if total is not None else size("film_length_mm") * stretch_1,
            active_length_mm=float(geometry.get("active_length_mm", 0.0)) * along,
            active_width_mm=float(geometry.get("active_width_mm", 0.0)) * across,
            sensing_length_mm=float(geometry.get("sensing_length_mm", 0.0)) * along,
            sensing_width_mm=float(geometry.get("sensing_width_mm", 0.0)) * across,
        )


def checked_geometry(geometry: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Geometry keys of a campaign, held against the rules of the recording's metadata. Raises `UsageError`."""
    parsers = {f.name: f.metadata["parser"] for f in dataclasses.fields(RecordingMetadata) if "parser" in f.metadata}
    for key, value in geometry.items():
        try:
            parsers[key](value)
        except ValueError as error:
            raise UsageError(f"{key} is {value!r}", where=where, expected=str(error)) from None
    return dict(geometry)
