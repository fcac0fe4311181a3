"""Actuators of a fitted film in words, or for a program: what one would do, and the sizes that a requirement needs."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from pipeline.commands.show.rows import as_csv, as_finite_json, in_plain
from pipeline.fit.actuator.known import (
    Driven,
    KnownFilm,
    Limit,
    Scatter,
    allow_for_form,
    drive_design,
    find_sizes,
    know_film,
)
from pipeline.fit.actuator.search import Design, Found, Space, fewest_films, search_designs
from pipeline.fit.actuator.specification import Asked, Requirement, draw_force_stroke, specify
from pipeline.fit.force.permittivity import SPHS
from pipeline.fit.relaxation.stored import read_fit, read_following
from pipeline.lab.lab import Lab
from pipeline.lab.query import Query
from pipeline.lab.reader import Reader
from pipeline.physics.actuator import Sizes, lateral_stretch
from schemas.errors import RefusedError, UsageError
from schemas.metadata import RecordingMetadata
from schemas.numbers import ABSENT, compact, counted, significant
from schemas.units import conversion

_NORMAL_95 = 1.959964
_STATED_SD = 0.1
"""Of a permittivity that the metadata state without standard deviation."""
_FEWEST_BREAKDOWNS = 3
_SHOWN = 14
"""Most designs of a front that are printed as text."""
_UNITS = {"force": "N", "stroke": "mm", "bandwidth": "Hz"}


@dataclass(frozen=True)
class DesignAsked:
    """The arguments of `dealab design`; None where they were not given."""

    specimen: str
    voltage_kv: float | None
    length_mm: float | None
    width_mm: float | None
    thickness_mm: tuple[float, ...] | None
    stretch: float | None
    stretch_2: float | None
    active_length_mm: float | None
    active_width_mm: float | None
    layers: int | None
    strips: int
    mass_g: float
    modulus_scatter: float
    thickness_scatter: float
    breakdown_mv_per_m: float | None
    require: str | None
    most_layers: int
    most_strips: int


@dataclass(frozen=True)
class _Source:
    """What the lab knows of a specimen: its film, its own sizes, the voltage it was driven with, and what was
    assumed."""

    film: KnownFilm
    about: RecordingMetadata
    sizes: Sizes | None
    highest_hz: float
    driven_kv: float | None
    breakdown: Limit | None
    assumed: tuple[str, ...]


def design_actuator(lab: Lab, asked: DesignAsked, form: str) -> tuple[str, str]:
    """The sheet of one actuator, or with a requirement the front of those that meet it.

    Parameters
    ----------
    lab : where the film was measured
    asked : the arguments
    form : `text`, `csv` or `json`

    Returns
    -------
    What is asked for, and what a reader of a table has to be told beside it

    Raises
    ------
    UsageError, LabError
        The specimen has no model, a size is not known, the arguments contradict each other, or there is no database.
    """
    source = _read_source(lab, asked)
    return _find(source, asked, form) if asked.require is not None else _specify(source, asked, form)


def parse_requirement(text: str) -> tuple[Asked, tuple[str, ...]]:
    """Force, stroke and frequency of `force=0.4N,stroke=1mm,bandwidth=10Hz`, and which of them it leaves to the
    tremor's.

    Raises
    ------
    UsageError : a part cannot be read, its unit is none of that quantity, or a quantity is there twice
    """
    expected = "force=0.4N,stroke=1mm,bandwidth=10Hz"
    found: dict[str, float] = {}
    for part in text.split(","):
        name, _, value = (piece.strip() for piece in part.partition("="))
        if name not in _UNITS or name in found:
            raise UsageError(
                f'--require "{part.strip()[:40]}"', expected=f"each of force, stroke, bandwidth once: {expected}"
            )
        number = value.rstrip("".join(c for c in set(value) if c.isalpha() or c in "µ "))
        unit = value[len(number) :].strip() or _UNITS[name]
        try:
            found[name] = float(number) * conversion(unit, _UNITS[name], where=f"--require {name}").scale
        except (ValueError, RefusedError):
            raise UsageError(
                f'--require {name}="{value[:40]}"', expected=f"a number with a unit of {_UNITS[name]}, as in {expected}"
            ) from None
        if not 0 < found[name] < math.inf:
            raise UsageError(f"--require {name}={value[:40]}", expected="a number above 0")
    tremor = Asked()
    names = {"force": "force_n", "stroke": "stroke_mm", "bandwidth": "frequency_hz"}
    left = tuple(f"{name} {getattr(tremor, names[name]):g} {_UNITS[name]}" for name in names if name not in found)
    return replace(tremor, **{names[name]: value for name, value in found.items()}), left


def _read_source(lab: Lab, asked: DesignAsked) -> _Source:
    lab.require_database()
    name = asked.specimen
    with Query(lab) as query:
        best = [r for r in query.run("SELECT * FROM best_models").to_pylist() if r["specimen_id"] == name]
    with Reader(lab.database) as reader:
        rows = reader.rows("model_fits", None, "specimen_id", [name])
        values = reader.rows("permittivities", None, "specimen_id", [name])
        recordings = reader.rows(
            "recordings", None, "specimen_id", [name], "status IN ('ok', 'damaged') AND metadata IS NOT NULL"
        )
        lives = (
            reader.rows("lifetimes", None, where="breakdown_voltage_kv IS NOT NULL")
            if asked.breakdown_mv_per_m is None
            else []
        )
        broken = reader.rows(
            "recordings",
            ["recording_id", "material", "metadata"],
            "recording_id",
            [r["recording_id"] for r in lives if r["recording_id"]],
        )
    if not best:
        raise UsageError(
            f'there is no model of "{name[:80]}" in this lab',
            remedy=lab.spell_command('sql "SELECT specimen_id FROM best_models"') + " lists those with a model",
        )
    row, fit = best[0], read_fit(best[0])
    if fit is None or row["frequency_low_hz"] is None:
        raise UsageError(
            f"the model of {name[:80]} keeps no covariance of springs and relaxation times ({row['method']})",
            expected="a model of responses: sweeps, sinusoids, relaxation",
        )
    abouts = [
        RecordingMetadata.parse(json.loads(r["metadata"])["recording"])
        for r in sorted(recordings, key=lambda r: r["loading"] == "mechanical")
    ]
    merged = {k: v for one in abouts for k, v in one.to_text().items()}
    if not merged:
        raise UsageError(
            f"no recording of {name[:80]} with metadata is in use",
            expected="the sizes of the film, from its recordings",
        )
    about = RecordingMetadata.parse(merged)
    permittivity, sd, said = _choose_permittivity(values, about, name)
    lowest, highest = float(row["frequency_low_hz"]), float(row["frequency_high_hz"])
    formed = allow_for_form(fit, read_following(row, rows), row["warnings"] or "", lowest)
    film = know_film(formed, about, (permittivity, sd), lowest)
    if film is None:
        raise UsageError(
            f"the stiffness of {name[:80]} is known in N/mm alone",
            expected="the film's length, width, thickness and pre-stretch in the metadata of its recordings",
        )
    drives = [m.drive_kv for m in abouts if m.drive_kv is not None]
    alike = {r["material"] for r in recordings if r["material"]}
    same = [r for r in broken if r["material"] in alike]
    limit, where = _find_breakdown(asked.breakdown_mv_per_m, lives, same)
    model = (
        f"stiffness: {row['loading']} model of order {row['model_order']}, {row['method']}, recorded from"
        f" {lowest:.3g} to {highest:.3g} Hz"
    )
    return _Source(film, about, find_sizes(about), highest, max(drives, default=None), limit, (model, said, where))


def _choose_permittivity(
    values: Sequence[dict[str, Any]], about: RecordingMetadata, name: str
) -> tuple[float, float, str]:
    """Permittivity, standard deviation of its logarithm, and where it is from."""
    if values:
        best = min(values, key=lambda v: (v["method"] != SPHS, v["voltage_kv"] is not None, -(v["voltage_kv"] or 0.0)))
        low, value, high = (best[f"relative_permittivity{end}"] for end in ("_lower", "", "_upper"))
        how = "harmonic sequences" if best["method"] == SPHS else "steps"
        return (
            value,
            (high - low) / (2 * _NORMAL_95 * value),
            f"relative permittivity {value:.3g} ({low:.3g} to {high:.3g}) from its {how}",
        )
    stated = about.relative_permittivity
    if stated is None:
        raise UsageError(
            f"the permittivity of {name[:80]} is not known",
            expected="recordings under voltage with the electrodes' sizes, or relative_permittivity in the metadata",
        )
    sd = (about.relative_permittivity_sd or _STATED_SD * stated) / stated
    return (
        stated,
        sd,
        f"relative permittivity {stated:.3g} ± {100 * sd:.2g} % as the metadata state it: no voltage was on this film",
    )


def _find_breakdown(
    stated: float | None, lives: Sequence[dict[str, Any]], broken: Sequence[dict[str, Any]]
) -> tuple[Limit | None, str]:
    """Field at breakdown as stated, or of films whose voltage was raised until they broke down; and what it rests on.

    A film that failed while its voltage was held says how long it lives at that voltage, and not what it bears.
    """
    if stated is not None:
        return Limit(stated, 0.0), f"breakdown at {stated:.3g} MV/m as given, taken as exact"
    told = {r["recording_id"]: json.loads(r["metadata"] or "{}").get("recording", {}) for r in broken}
    abouts = {name: RecordingMetadata.parse(one) for name, one in told.items() if "protocol" in one}
    fields = []
    for life in lives:
        film, volts = abouts.get(life["recording_id"]), life["breakdown_voltage_kv"]
        if film is not None and volts and film.layer_thickness_mm and film.pre_stretch:
            fields.append(volts * film.pre_stretch * (film.lateral_stretch or 1.0) / film.layer_thickness_mm)
    if len(fields) < _FEWEST_BREAKDOWNS:
        return (
            None,
            "no breakdown margin: of fewer than three films of this material the voltage was raised until they broke"
            " down here; films that failed while it was held tell a life (--breakdown-mv-per-m)",
        )
    logs = np.log(fields)
    sd = float(np.std(logs, ddof=1)) * math.sqrt(1 + 1 / logs.size)
    middle = float(np.exp(logs.mean()))
    said = (
        f"breakdown at {middle:.3g} MV/m, {100 * sd:.2g} % from film to film: {counted(len(fields), 'film')} of this"
        " material whose voltage was raised until they broke down"
    )
    return Limit(middle, sd), said


def _lay_out(
    source: _Source, asked: DesignAsked, thickness_mm: float | None
) -> tuple[Sizes, tuple[float, float | None], float, list[str]]:
    """Stretched sizes, pre-stretch and undeformed thickness of the actuator that is asked for, and what was assumed."""
    own, assumed = source.sizes, []
    stretch = (asked.stretch or source.film.stretch_1, asked.stretch_2 or source.film.stretch_2)
    layer = thickness_mm or source.about.layer_thickness_mm
    length = asked.length_mm or (own.length_mm if own else None)
    width = asked.width_mm or (own.width_mm if own else None)
    if layer is None or length is None or width is None:
        raise UsageError(
            "a size of the actuator is not known",
            expected="--length-mm, --width-mm and --thickness-mm, as the specimen's metadata lack them",
        )
    fresh = asked.length_mm is not None or asked.width_mm is not None or own is None
    if fresh and not (asked.active_length_mm and asked.active_width_mm):
        assumed.append("the electrodes cover the whole length and width where their sizes are not given")
    active_length = asked.active_length_mm or (length if fresh or own is None else own.active_length_mm)
    active_width = asked.active_width_mm or (width if fresh or own is None else own.active_width_mm)
    try:
        sizes = Sizes(
            length, width, layer / (stretch[0] * lateral_stretch(*stretch)), active_length, active_width,
            asked.layers or (own.layers if own else 1), asked.strips, asked.mass_g,
        )  # fmt: skip
    except ValueError:
        raise UsageError(
            f"electrodes of {active_length:g} × {active_width:g} mm on a film of {length:g} × {width:g} mm",
            expected="electrodes within the film",
        ) from None
    if stretch != (source.film.stretch_1, source.film.stretch_2):
        assumed.append(
            f"another pre-stretch than the {source.film.stretch_1:g} that was measured: stiffness anywhere between the"
            " thesis' law of large strain and the neo-Hookean one; relaxation times and permittivity as measured"
        )
    return sizes, stretch, layer, assumed


def _tell_electrode(sizes: Sizes) -> str:
    """The electrode, where it is less than the film."""
    if (sizes.active_length_mm, sizes.active_width_mm) == (sizes.length_mm, sizes.width_mm):
        return ""
    return f", {sizes.active_length_mm:.4g} × {sizes.active_width_mm:.4g} mm of it under the electrode"


def _assume(source: _Source, asked: DesignAsked, own: Sequence[str]) -> list[str]:
    scatter = (
        f"{100 * asked.modulus_scatter:g} % of stiffness and {100 * asked.thickness_scatter:g} % of thickness from film"
        " to film"
    )
    this = "the film of this specimen: no scatter from film to film (--modulus-scatter, --thickness-scatter)"
    mass = f"{asked.mass_g:g} g move with the end" if asked.mass_g else "nothing but film moves (--mass-g)"
    return [
        *source.assumed,
        *own,
        scatter if asked.modulus_scatter or asked.thickness_scatter else this,
        f"{mass}; the film's own mass is not counted",
        "sizes are exact; small strains about the pre-stretch; the voltage follows without lag, electrodes have no"
        " resistance",
        "the load moves with the film's own phase; fit and permittivity are independent",
    ]


def _drive(
    source: _Source, asked: DesignAsked, sizes: Sizes, stretch: tuple[float, float | None], voltage_kv: float
) -> Driven:
    scatter = Scatter(asked.modulus_scatter, asked.thickness_scatter)
    return drive_design(source.film, sizes, stretch, voltage_kv, scatter=scatter, breakdown=source.breakdown)


def _choose_voltage(source: _Source, asked: DesignAsked) -> float:
    voltage = asked.voltage_kv or source.driven_kv
    if voltage is None:
        raise UsageError(
            "--voltage-kv is missing", expected="the voltage across a layer: this specimen was never driven"
        )
    return voltage


def _specify(source: _Source, asked: DesignAsked, form: str) -> tuple[str, str]:
    if asked.thickness_mm is not None and len(asked.thickness_mm) > 1:
        raise UsageError("several --thickness-mm", expected="one thickness; several with --require")
    sizes, stretch, layer, own = _lay_out(source, asked, asked.thickness_mm[0] if asked.thickness_mm else None)
    voltage = _choose_voltage(source, asked)
    driven = _drive(source, asked, sizes, stretch, voltage)
    sheet = specify(driven, source.highest_hz, sizes.length_mm * sizes.strips)
    tremor = Asked()
    lines = [p for hz in (driven.lowest_hz, tremor.frequency_hz) for p in draw_force_stroke(driven, hz)]
    assumed = _assume(source, asked, own)
    if form == "csv":
        return as_csv(_table(sheet)), in_plain("\n".join(assumed))
    one = _drive(source, asked, replace(sizes, layers=1, strips=1, mass_g=0.0), stretch, voltage)
    few = fewest_films(one, tremor)
    if form == "json":
        films = None if few is None else {"layers": few[0], "strips": few[1]}
        return as_finite_json({
            "specimen_id": asked.specimen, "sizes": asdict(sizes), "undeformed_thickness_mm": layer, "stretch": stretch,
            "voltage_kv": voltage, "sheet": [asdict(r) for r in sheet], "force_stroke": [asdict(p) for p in lines],
            "films_for_tremor": films, "assumptions": assumed,
        }), ""  # fmt: skip
    heads = ("", "value", "90 %", "95 %", "for tremor", "meets it")
    rows = [
        (
            f"{r.quantity}{', ' + r.unit if r.unit else ', %'}", _show(r, r.value), _range(r, "_90"), _range(r, ""),
            ABSENT if r.required is None else compact(r.required),
            ABSENT if r.meets is None else "yes" if r.meets else "no",
        )
        for r in sheet
    ]  # fmt: skip
    title = (
        f"{asked.specimen}: {_count(sizes.layers, 'layer')} side by side, {_count(sizes.strips, 'strip')} behind each"
        f" other, each {sizes.length_mm:.4g} × {sizes.width_mm:.4g} mm stretched{_tell_electrode(sizes)},"
        f" {layer:.3g} mm undeformed, at {voltage:.3g} kV"
    )
    many = "no number of such films gives 0.4 N at 1 mm and 10 Hz at once"
    if few is not None:
        many = (
            f"0.4 N at 1 mm and 10 Hz at once (tremor, 95 %): {_count(few[0], 'layer')} × {_count(few[1], 'strip')}"
            f" of this film at this voltage, {few[0] * few[1]} films"
        )
    notes = [f"  {r.quantity}: {r.note}" for r in sheet]
    return in_plain(
        "\n".join(
            [
                title,
                "",
                *_align(heads, rows),
                "",
                many,
                "",
                "How it is meant",
                *notes,
                "Assumed",
                *(f"  {a}" for a in assumed),
            ]
        )
    ), ""


def _find(source: _Source, asked: DesignAsked, form: str) -> tuple[str, str]:
    if asked.layers is not None or asked.strips != 1:
        raise UsageError(
            "--layers or --strips with --require",
            expected="neither: they are what is searched (--most-layers, --most-strips)",
        )
    wanted, left = parse_requirement(asked.require or "")
    sizes, stretch, layer, own = _lay_out(source, asked, None)
    space = Space(asked.thickness_mm or (layer,), _choose_voltage(source, asked), asked.most_layers, asked.most_strips)
    across = stretch[0] * lateral_stretch(*stretch)

    def one(thickness: float, voltage: float) -> Driven:
        return _drive(
            source, asked, replace(sizes, thickness_mm=thickness / across, layers=1, strips=1), stretch, voltage
        )

    found = search_designs(one, space, wanted)
    thick = ", ".join(f"{t:.3g}" for t in space.thicknesses_mm)
    searched = (
        f"searched: voltages up to {space.highest_kv:.3g} kV, layers up to {space.most_layers}, strips up to"
        f" {space.most_strips}, each {sizes.length_mm:.4g} × {sizes.width_mm:.4g} mm stretched{_tell_electrode(sizes)},"
        f" undeformed {thick} mm thick"
    )
    assumed = _assume(source, asked, own)
    assumed.append(
        "bandwidth is the frequency up to which force and stroke are there at once: how much a film stiffens is no"
        " matter of its sizes"
    )
    if left:
        assumed.append(f"not given, taken from a tremor: {', '.join(left)}")
    tally = (
        f"{found.tried} designs tried, {found.unsafe} too near pull-in or breakdown, {found.met} meet the requirement,"
        f" {len(found.front)} that no other betters"
    )
    if form == "csv":
        return as_csv(_table(found.front)), in_plain("\n".join([searched, tally, *assumed]))
    if form == "json":
        return as_finite_json({
            "specimen_id": asked.specimen, "asked": asdict(wanted), "front": [asdict(d) for d in found.front],
            "tried": found.tried, "met": found.met, "unsafe": found.unsafe, "searched": searched,
            "assumptions": assumed,
        }), ""  # fmt: skip
    return in_plain(
        "\n".join(
            [*_describe_front(asked, wanted, found), "", tally, searched, "Assumed", *(f"  {a}" for a in assumed)]
        )
    ), ""


def _describe_front(asked: DesignAsked, wanted: Asked, found: Found) -> list[str]:
    title = (
        f"{asked.specimen}: {wanted.force_n:.3g} N at {wanted.stroke_mm:.3g} mm, at once and up to"
        f" {wanted.frequency_hz:.3g} Hz, with 95 %"
    )
    if not found.front:
        return [
            title,
            "",
            "no design of those searched meets it: allow more voltage, layers, strips, or thinner or larger films",
        ]
    chosen = _thin(found.front)
    heads = (
        "kV",
        "mm thick",
        "layers",
        "strips",
        "films",
        "force left, N",
        "stroke left, mm",
        "field, MV/m",
        "margin",
        "by",
    )
    rows = [
        (
            f"{d.voltage_kv:.3g}", f"{d.thickness_mm:.3g}", str(d.layers), str(d.strips), str(d.films),
            f"{d.force_n:.3g} (>{d.force_n_lower:.3g})", f"{d.stroke_mm:.3g} (>{d.stroke_mm_lower:.3g})",
            f"{d.field_mv_per_m:.3g}",
            ABSENT if d.margin is None else f"{d.margin:.3g} (>{d.margin_lower:.3g})", d.limited_by or ABSENT,
        )
        for d in chosen
    ]  # fmt: skip
    more = (
        []
        if len(chosen) == len(found.front)
        else [f"{len(found.front) - len(chosen)} more of the front: --format csv or json"]
    )
    return [title, "", *_align(heads, rows), *more]


def _thin(front: Sequence[Design]) -> list[Design]:
    """Some of a front, spread over it, with the one of fewest films among them; those with least to spare at each
    voltage."""
    lean: dict[tuple[float, float], Design] = {}
    for one in front:
        key = (one.voltage_kv, one.thickness_mm)
        if key not in lean or one.films < lean[key].films:
            lean[key] = one
    kept = list(lean.values())
    few = min(kept, key=lambda d: d.films)
    places = np.unique(np.round(np.linspace(0, len(kept) - 1, _SHOWN)).astype(int))
    return [d for i, d in enumerate(kept) if i in places or d is few]


def _table(records: Sequence[Requirement] | Sequence[Design]) -> Any:
    import pyarrow as pa

    return pa.Table.from_pylist([asdict(r) for r in records])


def _show(r: Requirement, value: float) -> str:
    return significant(value if r.unit else 100 * value)


def _range(r: Requirement, level: str) -> str:
    return f"{_show(r, getattr(r, f'value_lower{level}'))} to {_show(r, getattr(r, f'value_upper{level}'))}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _align(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(line[i]) for line in (heads, *rows)) for i in range(len(heads))]
    return [
        "  ".join([line[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True))]).rstrip()
        for line in (heads, *rows)
    ]
