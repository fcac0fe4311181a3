"""Campaign files of the virtual rig: a TOML file that says what is tested, and how, becomes a plan.

    name = "thesis"                        seed = 1            started_at = 2024-03-04T08:00:00+00:00
    pause_s = 60                           between recordings; operator, notes: text
    [noise]                                standard deviation of one raw sample by quantity, canonical units
    force = 0.001
    [rigs.shaker]                          what is true: clamp_mass_kg, load_cell_stiffness_n_per_mm,
    clamp_mass_kg = 0.187                  load_cell_damping_n_s_per_mm or damping_ratio, load_cell_range_n,
                                           amplifier_gain_kv_per_v, rise_time_constant_s, fall_time_constant_s
    [rigs.shaker.file]                     what the rig's file says where it differs, and the …_sd
    [rigs.shaker.channels.force]           sample_rate_hz, noise_sd, low, high, bits, filter_hz, delay_s, unit, sensor
    [rigs.shaker.spikes]                   height_pf, width_s: interference of the converter in the capacitance
    [materials.polyacrylate]               k0_n_per_mm, k_n_per_mm, tau_s or c_n_s_per_mm, c_inf_n_s_per_mm,
                                           relative_permittivity
    [specimens.PA-1]                       rig, material, stiffness_scale, time_scale, permittivity_scale, pretension_n, …
    [specimens.PA-1.geometry]              keys of the recording's metadata (film_length_mm, stretch_1, …)
    [specimens.PA-1.effects.rig_constants] a hidden effect: mechanism → parameters (see `effects`)
    [[recordings]]
    test = "chirp"                         chirp, chirp_electrical, sphs, cyclic, cycle, pull, creep, step_mechanical,
                                           step_electrical, step_closed_loop, isotonic, force_map, coating, tap, weight;
                                           parameters as the classes there have
    specimens = ["PA-1"]                   or rigs = ["shaker"] for tap and weight
    id = "{specimen}-chirp-{amplitude_mm}" braces hold a parameter, specimen, rig, test or n (number within the entry)
    sample_rate_hz = 2000                  of all channels of this test
    format = "mcap"                        or csv; folder: where the file goes (the specimen's name)
    night = 2                              the night before which it is recorded (1)
    [recordings.vary]                      every combination of these
    amplitude_mm = [0.5, 1.0]
    [[lifetimes]]                          a group (see `lifetime.LifetimeGroup`) with its [lifetimes.specimen]
    [[mishaps]]                            what went wrong with a file: recording and
    kind = "truncated"                     truncated (share), missing_key (key), duplicate, mislabelled (specimen), flipped (quantity),
                                           and for CSV files wrong_unit (quantity, unit; in the TOML) and unmapped (no TOML at all)

Does not belong here: simulating what is planned, which `campaign` does.
"""

from __future__ import annotations

import itertools
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from pipeline.simulate.effects import EFFECTS
from pipeline.simulate.lifetime import LifetimeGroup
from pipeline.simulate.procedures import calibration, electrical, mechanical
from pipeline.simulate.procedures.base import Procedure
from pipeline.simulate.rigs import RigSetup, read_rig
from pipeline.simulate.self_sensing import ClosedLoop
from pipeline.simulate.sensors import Sensor, random_stream
from pipeline.simulate.specimen import GEOMETRY, Deviations, Material, Specimen, checked_geometry
from pipeline.simulate.tables import choice, known_only, number, parse, shown, subtable, subtables, text, whole
from schemas.errors import UsageError
from schemas.metadata import RECORDING_ID, instant
from schemas.quantities import QUANTITIES

TESTS: Mapping[str, type[Procedure]] = {
    "chirp": mechanical.Chirp,
    "sphs": electrical.Sphs,
    "chirp_electrical": electrical.VoltageChirp,
    "cyclic": mechanical.Cyclic,
    "cycle": mechanical.Triangle,
    "pull": mechanical.Pull,
    "creep": mechanical.Creep,
    "step_mechanical": mechanical.Relaxation,
    "step_electrical": electrical.VoltageSteps,
    "step_closed_loop": ClosedLoop,
    "isotonic": electrical.Isotonic,
    "force_map": electrical.ForceMap,
    "coating": electrical.Coating,
    "tap": calibration.Tap,
    "weight": calibration.Weight,
}
_TOP = (
    "name", "seed", "started_at", "pause_s", "operator", "notes",
    "noise", "rigs", "materials", "specimens", "recordings", "lifetimes", "mishaps",
)  # fmt: skip
_ENTRY = ("test", "specimens", "rigs", "id", "sample_rate_hz", "format", "folder", "night", "notes", "vary")
REQUIRED_KEYS = ("recording_id", "protocol", "loading", "specimen_id", "started_at")
_FIELD = re.compile(r"\{(\w+)\}")
PACKAGED = Path(__file__).parent / "campaigns"


@dataclass(frozen=True)
class Mishap:
    """What happens to the file of a recording after the test."""

    recording: str = text()
    kind: str = choice("truncated", "wrong_unit", "missing_key", "duplicate", "mislabelled", "flipped", "unmapped")
    share: float = number(0.6, above=0, at_most=1)
    quantity: str = text("force")
    unit: str = text("mm")
    key: str = text("specimen_id")
    specimen: str = text("")


@dataclass(frozen=True)
class Planned:
    """One recording to be made. `specimen` is None for calibrations; `label` is the specimen that the file names by mistake, if any."""

    recording_id: str
    procedure: Procedure
    specimen: Specimen | None
    rig: RigSetup
    started_at: datetime
    sensors: Mapping[str, Sensor]
    format: str
    folder: str
    notes: str | None
    night: int
    label: Specimen | None = None


@dataclass(frozen=True)
class Campaign:
    """A checked campaign: every recording planned, nothing simulated yet."""

    name: str
    seed: int
    operator: str | None
    rigs: Mapping[str, RigSetup]
    specimens: Mapping[str, Specimen]
    planned: tuple[Planned, ...]
    mishaps: tuple[Mishap, ...]


def packaged_campaigns() -> dict[str, Path]:
    """Campaigns that come with the package, by name."""
    return {path.stem: path for path in sorted(PACKAGED.glob("*.toml"))}


def load_campaign(path: Path | str) -> Campaign:
    """A campaign from a TOML file, or one of the packaged ones by its name.

    Raises `UsageError` for a file that is missing, is no TOML or breaks the rules above.
    """
    packaged = packaged_campaigns()
    found = Path(path)
    if str(path) in packaged and not found.is_file():
        found = packaged[str(path)]
    try:
        table = tomllib.loads(found.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(
            f"cannot read the campaign: {error.strerror or error}",
            where=str(path),
            expected="a TOML file or one of " + ", ".join(packaged),
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"not a TOML file: {error}", where=str(path)) from None
    return read_campaign(table, where=found.name)


def read_campaign(table: Mapping[str, Any], *, where: str = "campaign") -> Campaign:
    """A campaign from its TOML table. Raises `UsageError`, see `load_campaign`."""
    known_only(table, _TOP, where)
    head = parse(
        _Head, {k: v for k, v in table.items() if k in ("name", "seed", "pause_s", "operator", "notes")}, where
    )
    try:
        clock = instant(table.get("started_at", ""))
    except ValueError as error:
        raise UsageError(f"started_at is {shown(table.get('started_at'))}", where=where, expected=str(error)) from None
    noise = subtable(table, "noise", where)
    known_only(noise, QUANTITIES, f"{where}: noise")
    rigs = {
        name: read_rig(name, subtable(subtable(table, "rigs", where), name, where), noise, f"{where}: rigs.{name}")
        for name in subtable(table, "rigs", where)
    }
    materials = {
        name: parse(Material, subtable(subtable(table, "materials", where), name, where), f"{where}: materials.{name}")
        for name in subtable(table, "materials", where)
    }
    reader = _Reader(where, head, rigs, materials)
    specimens = {
        name: reader.specimen(
            name, subtable(subtable(table, "specimens", where), name, where), f"{where}: specimens.{name}"
        )
        for name in subtable(table, "specimens", where)
    }
    drafts = []
    for i, entry in enumerate(subtables(table, "recordings", where)):
        drafts += reader.entry(entry, specimens, f"{where}: recordings[{i}]")
    for i, entry in enumerate(subtables(table, "lifetimes", where)):
        members, lives = reader.group(entry, f"{where}: lifetimes[{i}]")
        specimens |= members
        drafts += lives
    if not drafts:
        raise UsageError("the campaign has no recordings", where=where, expected="[[recordings]] or [[lifetimes]]")
    planned: dict[str, Planned] = {}
    clocks: dict[int, datetime] = {}
    for draft in drafts:
        if draft.recording_id in planned:
            raise UsageError(
                f'the id "{draft.recording_id}" occurs twice', where=where, expected="a varied parameter or {n} in id"
            )
        # What is recorded before another night begins with another day.
        started_at = clocks.setdefault(draft.night, clock + timedelta(days=draft.night - 1))
        planned[draft.recording_id] = replace(draft, started_at=started_at)
        clocks[draft.night] += timedelta(seconds=math.ceil(draft.procedure.duration_s + head.pause_s))
    mishaps = tuple(
        _mishap(entry, planned, specimens, f"{where}: mishaps[{i}]")
        for i, entry in enumerate(subtables(table, "mishaps", where))
    )
    for mishap in mishaps:
        if mishap.kind == "mislabelled":
            label = specimens[mishap.specimen]
            planned[mishap.recording] = replace(planned[mishap.recording], label=label, folder=label.name)
    return Campaign(head.name, head.seed, head.operator, rigs, specimens, tuple(planned.values()), mishaps)


@dataclass(frozen=True)
class _Head:
    name: str = text()
    seed: int = number(at_least=0)
    pause_s: float = number(60.0, at_least=0)
    operator: str | None = text(None)
    notes: str | None = text(None)

    def __post_init__(self) -> None:
        if self.seed != int(self.seed):
            raise ValueError(f"seed is {self.seed:g}, not a whole number")
        object.__setattr__(self, "seed", int(self.seed))


@dataclass(frozen=True)
class _Reader:
    """What the entries of a campaign refer to."""

    where: str
    head: _Head
    rigs: Mapping[str, RigSetup]
    materials: Mapping[str, Material]

    def specimen(self, name: str, table: Mapping[str, Any], where: str) -> Specimen:
        geometry = subtable(table, "geometry", where)
        effects = subtable(table, "effects", where)
        known_only(geometry, GEOMETRY, f"{where}.geometry")
        for mechanism in effects:
            values = subtable(effects, mechanism, f"{where}.effects")
            if mechanism not in EFFECTS:
                raise UsageError(
                    f'the virtual rig has no effect "{mechanism}"',
                    where=f"{where}.effects",
                    expected="one of " + ", ".join(EFFECTS),
                )
            parse(EFFECTS[mechanism].parameters, values, f"{where}.effects.{mechanism}")
        own = {k: v for k, v in table.items() if k not in ("rig", "material", "geometry", "effects")}
        return Specimen(
            name=name,
            rig_name=self._named(table, "rig", self.rigs, where),
            material_name=self._named(table, "material", self.materials, where),
            material=self.materials[table["material"]],
            deviations=parse(Deviations, own, where),
            geometry=checked_geometry(geometry, f"{where}.geometry"),
            effects=effects,
        )

    def _named(self, table: Mapping[str, Any], key: str, known: Mapping[str, Any], where: str) -> str:
        name = table.get(key)
        if not isinstance(name, str) or name not in known:
            raise UsageError(f"{key} is {shown(name)}", where=where, expected="one of " + ", ".join(known))
        return name

    def entry(self, table: Mapping[str, Any], specimens: Mapping[str, Specimen], where: str) -> list[Planned]:
        """The recordings of one `[[recordings]]` entry, one for each specimen or rig and combination of parameters."""
        test = self._named(table, "test", TESTS, where)
        parameters = {k: v for k, v in table.items() if k not in _ENTRY}
        vary = subtable(table, "vary", where)
        for key, values in vary.items():
            if not isinstance(values, list) or not values:
                raise UsageError(f"vary.{key} is {shown(values)}", where=where, expected="a list of values")
        subjects = self._subjects(table, specimens, where)
        combinations = list(itertools.product(*vary.values()))
        drafts: list[Planned] = []
        for specimen, rig in subjects:
            for combination in combinations:
                chosen = {**parameters, **dict(zip(vary, combination, strict=True))}
                procedure = parse(TESTS[test], chosen, where)
                procedure.check(specimen, where)
                names = {
                    **chosen,
                    "specimen": specimen.name if specimen else rig.name,
                    "rig": rig.name,
                    "test": test,
                    "n": len(drafts) + 1,
                }
                drafts.append(self._planned(table, procedure, specimen, rig, names, where))
        return drafts

    def _subjects(
        self, table: Mapping[str, Any], specimens: Mapping[str, Specimen], where: str
    ) -> list[tuple[Specimen | None, RigSetup]]:
        chosen = [key for key in ("specimens", "rigs") if key in table]
        if len(chosen) != 1:
            raise UsageError("an entry names its specimens, or its rigs for a calibration", where=where)
        known: Mapping[str, Any] = specimens if chosen == ["specimens"] else self.rigs
        names = table[chosen[0]]
        if not isinstance(names, list) or not names:
            raise UsageError(f"{chosen[0]} is {shown(names)}", where=where, expected="a list of names")
        for name in names:
            self._named({chosen[0]: name}, chosen[0], known, where)
        if chosen == ["specimens"]:
            return [(specimens[name], self.rigs[specimens[name].rig_name]) for name in names]
        return [(None, self.rigs[name]) for name in names]

    def _planned(
        self,
        table: Mapping[str, Any],
        procedure: Procedure,
        specimen: Specimen | None,
        rig: RigSetup,
        names: Mapping[str, Any],
        where: str,
    ) -> Planned:
        own = parse(
            _Entry,
            {k: table[k] for k in ("id", "sample_rate_hz", "format", "folder", "night", "notes") if k in table},
            where,
        )
        recording_id = _FIELD.sub(lambda m: _filled(m.group(1), names, where), own.id)
        if not RECORDING_ID.fullmatch(recording_id):
            raise UsageError(f'the id becomes "{recording_id}"', where=where, expected="1 to 80 of A-Z a-z 0-9 . _ -")
        sensors = {}
        for quantity in procedure.quantities:
            sensor = rig.sensors[quantity]
            rate = own.sample_rate_hz
            sensors[quantity] = sensor if rate is None else replace(sensor, sample_rate_hz=rate)
        has_sensing = specimen is not None and "sensing_length_mm" in specimen.geometry
        if not has_sensing:
            sensors.pop("capacitance", None)
        highest = max(s.sample_rate_hz for s in sensors.values())
        for quantity, sensor in sensors.items():
            ratio = highest / sensor.sample_rate_hz
            if abs(ratio - round(ratio)) > 1e-9:
                raise UsageError(
                    f"{quantity} has {sensor.sample_rate_hz:g} Hz",
                    where=where,
                    expected=f"a whole fraction of the highest rate, {highest:g} Hz",
                )
        if own.format == "csv" and any(s.sample_rate_hz != highest for s in sensors.values()):
            raise UsageError("a CSV has one clock", where=where, expected="one sample_rate_hz for all channels")
        folder = own.folder or (specimen.name if specimen else rig.name)
        if not RECORDING_ID.fullmatch(folder):
            raise UsageError(f'folder "{folder}"', where=where, expected="a plain name")
        return Planned(
            recording_id,
            procedure,
            specimen,
            rig,
            datetime.min.replace(tzinfo=UTC),
            sensors,
            own.format,
            folder,
            own.notes,
            own.night,
        )

    def group(self, table: Mapping[str, Any], where: str) -> tuple[dict[str, Specimen], list[Planned]]:
        """The specimens and recordings of one `[[lifetimes]]` group."""
        group = parse(LifetimeGroup, {k: v for k, v in table.items() if k not in ("specimen", "sample_rate_hz")}, where)
        like = subtable(table, "specimen", where)
        members: dict[str, Specimen] = {}
        lives: list[Planned] = []
        fates = group.fates(random_stream(self.head.seed, "lifetimes", group.prefix))
        options = {"id": "{specimen}-lifetime", "folder": group.prefix}
        if "sample_rate_hz" in table:
            options["sample_rate_hz"] = table["sample_rate_hz"]
        for number_, life in enumerate(fates, start=1):
            specimen = self.specimen(f"{group.prefix}-{number_:02d}", like, f"{where}.specimen")
            life.check(specimen, where)
            members[specimen.name] = specimen
            rig = self.rigs[specimen.rig_name]
            lives.append(self._planned(options, life, specimen, rig, {"specimen": specimen.name}, where))
        return members, lives


@dataclass(frozen=True)
class _Entry:
    id: str = text("{specimen}-{test}-{n}")
    sample_rate_hz: float | None = number(None, above=0)
    format: str = choice("mcap", "csv", default="mcap")
    folder: str | None = text(None)
    night: int = whole(1)
    notes: str | None = text(None)


def _filled(name: str, names: Mapping[str, Any], where: str) -> str:
    if name not in names or not isinstance(names[name], str | int | float):
        raise UsageError(f"id has {{{name}}}", where=where, expected="one of " + ", ".join(names))
    value = names[name]
    return value if isinstance(value, str) else f"{value:g}"


def _mishap(
    entry: Mapping[str, Any], planned: Mapping[str, Planned], specimens: Mapping[str, Specimen], where: str
) -> Mishap:
    mishap = parse(Mishap, entry, where)
    if mishap.recording not in planned:
        raise UsageError(f'recording "{mishap.recording}" is not in the campaign', where=where)
    draft = planned[mishap.recording]
    if mishap.kind in ("unmapped", "wrong_unit") and draft.format != "csv":
        raise UsageError(f"{mishap.kind} is an accident of mapped files", where=where, expected='format = "csv"')
    if mishap.kind == "missing_key" and mishap.key not in REQUIRED_KEYS:
        raise UsageError(f"key is {shown(mishap.key)}", where=where, expected="one of " + ", ".join(REQUIRED_KEYS))
    if mishap.kind in ("wrong_unit", "flipped") and mishap.quantity not in draft.sensors:
        raise UsageError(f"the recording has no {mishap.quantity}", where=where, expected=", ".join(draft.sensors))
    if mishap.kind == "mislabelled" and (draft.specimen is None or mishap.specimen not in specimens):
        raise UsageError(
            f"a recording of {draft.specimen.name if draft.specimen else draft.rig.name} cannot be filed under {shown(mishap.specimen)}",
            where=where,
            expected="a recording of a specimen, and another specimen of the campaign",
        )
    return mishap
