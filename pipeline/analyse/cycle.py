"""A large load-unload cycle as stretch and nominal stress over time, whatever the machine gave, its fits, and what each cycle takes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pipeline.fit.relaxation.metrics import Geometry
from pipeline.fit.relaxation.time_domain import HELD_OUT, WORTH, CycleFit, CycleFits, fit_cycle
from pipeline.physics.hyperelastic import LINEAR, NON_AFFINE
from pipeline.transform.loops import Loop, find_loops, measure_modulus, retell
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata
from schemas.recording import Channel, Recording
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

MOST_SAMPLES = 1000
"""Samples that are fitted; of more, equally spaced ones: a cycle is smooth, and its law is exact between them."""
MOST_POINTS = 400
"""Points of a curve that are kept for the pages."""
_KPA_PER_MPA = 1000.0


@dataclass(frozen=True)
class Cycle:
    """One cycle and its fits.

    Parameters
    ----------
    time_s, stretch, stress : (m,) s since the recording's first sample, stretch, nominal stress in kPa
    fits : on the law that the recording gives, where it does, and with the law fitted
    """

    time_s: Float
    stretch: Float
    stress: Float
    fits: tuple[CycleFits, ...]


def cycle_fits(recording: Recording) -> Cycle:
    """Equilibrium law and branches of one cycle. Raises `NotIdentifiableError` where it cannot carry them."""
    about = recording.metadata
    found = stretch_and_stress(recording)
    every = max(1, found[0].size // MOST_SAMPLES)
    time, stretch, stress = (values[::every] for values in found)
    given = given_law(about)
    fit = partial(
        fit_cycle,
        time,
        stretch,
        stress,
        recording_id=about.recording_id,
        specimen_id=about.specimen_id,
        section_over_length_mm=_taken_section_over_length_mm(recording),
    )
    fitted = _fit_without_stretch(fit, stretch) if lacks_stretch(recording) else fit()
    fits = (fitted,) if given is None else (fit(equilibrium=given), fitted)
    return Cycle(time, stretch, stress, fits)


def _fit_without_stretch(fit: Callable[..., CycleFits], stretch: Float) -> CycleFits:
    """The fit of a film whose length is not known: a spring about any level, unless the law of a film 1 mm long predicts better what is left
    out."""
    spring = fit(law=LINEAR)
    if np.nanmin(stretch) <= 0:
        return spring
    film = fit(law=NON_AFFINE)
    better = film.selected.held_out_rmse < (1 - WORTH) * spring.selected.held_out_rmse
    return film if better else spring


def cycle_tables(cycle: Cycle) -> dict[str, pa.Table]:
    """Tables `cycle_fits` and `cycle_curves` of one cycle."""
    good = np.isfinite(cycle.time_s) & np.isfinite(cycle.stretch) & np.isfinite(cycle.stress)
    time, stretch, stress = cycle.time_s[good], cycle.stretch[good], cycle.stress[good]
    fits, curves = TABLES["cycle_fits"], TABLES["cycle_curves"]
    shown = np.unique(np.linspace(0, time.size - 1, min(time.size, MOST_POINTS)).astype(int))
    return {
        "cycle_fits": fits.stack(_fit_rows(group, time) for group in cycle.fits),
        "cycle_curves": curves.stack(
            curves.arrays(
                shown.size,
                recording_id=group.recording_id,
                law_given=group.fixed,
                model_order=fit.order,
                time_s=time[shown],
                stretch=stretch[shown],
                measured_kpa=stress[shown],
                modelled_kpa=group.stress(fit, time, stretch)[shown],
            )
            for group in cycle.fits
            for fit in group.fits
        ),
    }


def cycle_loops(recording: Recording) -> pa.Table:
    """Table `cycle_loops` of one recording. Raises `NotIdentifiableError` where no cycle closes."""
    about = recording.metadata
    has_stress = {"stretch", "stress"} <= recording.channels.keys()
    time, lengths, stretches = _pairs(recording)
    pair = stretches if has_stress else lengths
    assert pair is not None  # a cycle is recorded as one of the two
    found = find_loops(time, *pair)
    rows = [
        (loop, *(None if pair is None else retell(time, *pair, loop) for pair in (lengths, stretches)))
        for loop in found
    ]

    return TABLES["cycle_loops"].from_objects(
        enumerate(rows, 1),
        recording_id=about.recording_id,
        specimen_id=about.specimen_id,
        cycle=lambda one: one[0],
        unclosed=lambda one: one[1][0].unclosed,
        start_s=lambda one: float(time[one[1][0].first]),
        end_s=lambda one: float(time[one[1][0].last]),
        loss_share=lambda one: one[1][0].loss_share,
        **{
            name: partial(_tell, place=place, attribute=attribute)
            for place, of_pair in ((1, _OF_LENGTHS), (2, _OF_STRETCHES))
            for name, attribute in of_pair.items()
        },
        modulus_kpa=lambda one: None if stretches is None else measure_modulus(*stretches, one[1][0]),
    )


_OF_LENGTHS = {
    "displacement_low_mm": "low",
    "displacement_high_mm": "high",
    "force_low_n": "least",
    "force_high_n": "most",
    "loss_mj": "loss",
    "steady_loss_mj": "steady_loss",
    "secant_n_per_mm": "secant",
}
"""Columns of `cycle_loops` of displacement and force: what of a loop each is."""
_OF_STRETCHES = {
    "stretch_low": "low",
    "stretch_high": "high",
    "stress_low_kpa": "least",
    "stress_high_kpa": "most",
    "loss_kj_per_m3": "loss",
    "steady_loss_kj_per_m3": "steady_loss",
    "secant_kpa": "secant",
}
"""The same of stretch and nominal stress."""


def _tell(one: tuple[int, tuple[Loop | None, ...]], place: int, attribute: str) -> float | None:
    """What one of the loops of a cycle is; None where there is none."""
    loop = one[1][place]
    value: float | None = None if loop is None else getattr(loop, attribute)
    return value


def _pairs(recording: Recording) -> tuple[Float, tuple[Float, Float] | None, tuple[Float, Float] | None]:
    """Time in s since the first sample, displacement in mm with force in N, and stretch with nominal stress in kPa, (n,) each, at the samples
    at which all that is recorded is known.

    Each as the machine gives it, else by the film's sizes; None where these are not all known.
    """
    about, channels = recording.metadata, recording.channels
    has = {names: set(names) <= channels.keys() for names in _PAIRS}
    driven = channels["stretch" if has["stretch", "stress"] else "displacement"]
    read = {n: _at(channels[n], driven) for names in _PAIRS if has[names] for n in names}
    good = np.all([np.isfinite(values) for values in read.values()], axis=0)
    read = {name: values[good] for name, values in read.items()}
    zero, length, section = _sizes(about)
    is_known = section_over_length_mm(about) is not None
    lengths = (read["displacement"], read["force"]) if has["displacement", "force"] else None
    stretches = (read["stretch"], read["stress"]) if has["stretch", "stress"] else None
    if is_known and stretches is None and lengths is not None:
        stretches = zero + lengths[0] / length, lengths[1] / section
    elif is_known and lengths is None and stretches is not None:
        lengths = (stretches[0] - zero) * length, stretches[1] * section
    time = np.asarray((driven.time_ns - recording.start_ns) * 1e-9)[good]
    return time, lengths, stretches


_PAIRS = ("displacement", "force"), ("stretch", "stress")
"""What is driven and what answers, as machines give it."""


def _fit_rows(group: CycleFits, time_s: Float) -> pa.Table:
    """Rows of the fits on one law; `time_s` (m,) are the times of the cycle's samples."""
    return TABLES["cycle_fits"].from_objects(
        group.fits,
        recording_id=group.recording_id,
        specimen_id=group.specimen_id,
        law=group.law,
        law_given=group.fixed,
        model_order=lambda fit: fit.order,
        rmse_kpa=lambda fit: fit.rmse,
        held_out_rmse_kpa=lambda fit: fit.held_out_rmse,
        held_out_from_s=time_s[0] + (1 - HELD_OUT) * (time_s[-1] - time_s[0]),
        residual_correlation=lambda fit: fit.correlation,
        selected=lambda fit: fit.order == group.selected_order,
        equilibrium=lambda fit: json.dumps(dict(fit.equilibrium)),
        branches=lambda fit: json.dumps(_branches(fit)),
        warnings=lambda fit: "; ".join(dict.fromkeys((*fit.warnings, *group.warnings))),
    )


def _branches(fit: CycleFit) -> list[dict[str, float | None]]:
    names = ("gamma_kpa", "gamma_kpa_sd", "tau_s", "tau_s_sd", "eta_kpa_s", "eta_kpa_s_sd")
    columns = (fit.gamma, fit.gamma_sd, fit.tau, fit.tau_sd, fit.eta, fit.eta_sd)
    return [dict(zip(names, values, strict=True)) for values in zip(*columns, strict=True)]


def given_law(about: RecordingMetadata) -> dict[str, float] | None:
    """The film's equilibrium stress as the metadata give it, moduli in kPa; None where they do not.

    Raises `NotIdentifiableError` where they give a part of it.
    """
    given = {
        "crosslink_modulus": about.crosslink_modulus_kpa,
        "entanglement_modulus": about.entanglement_modulus_kpa,
        "largest_stretch": about.largest_stretch,
    }
    values = {name: value for name, value in given.items() if value is not None}
    if values and len(values) < len(given):
        raise NotIdentifiableError(
            f"of the equilibrium stress only {', '.join(values)} is given",
            where=about.recording_id,
            expected="crosslink_modulus_kpa, entanglement_modulus_kpa and largest_stretch, or none of them",
        )
    return values or None


def stretch_and_stress(recording: Recording) -> tuple[Float, Float, Float]:
    """Time in s, stretch and nominal stress in kPa (n,), at the samples of the stretch.

    Force and displacement become stress and stretch with the film's sizes; without sizes they are those of a 1 mm cube.
    """
    if {"stretch", "stress"} <= recording.channels.keys():
        driven, answer = recording.channels["stretch"], recording.channels["stress"]
        zero, length, section = 0.0, 1.0, 1.0
    else:
        driven, answer = recording.channels["displacement"], recording.channels["force"]
        zero, length, section = _sizes(recording.metadata)
    time = np.asarray((driven.time_ns - recording.start_ns) * 1e-9)
    return time, zero + driven.values / length, _at(answer, driven) / section


def lacks_stretch(recording: Recording) -> bool:
    """Whether a large cycle has no stretch but that of a cube of 1 mm: a law that holds there holds nowhere in the film."""
    return not {"stretch", "stress"} <= recording.channels.keys() and recording.metadata.film_length_mm is None


def section_over_length_mm(about: RecordingMetadata) -> float | None:
    """Section over length of the undeformed film; None where one of its sizes is not known."""
    if about.film_length_mm is None or about.undeformed_section_mm2 is None:
        return None
    _, length, section = _sizes(about)
    return section * _KPA_PER_MPA / length


def _taken_section_over_length_mm(recording: Recording) -> float | None:
    """Section over length that made stretch and stress of a recording; None where that was a cube of 1 mm.

    Of force and displacement a size that is not known goes out again where moduli become the stiffness that was measured.
    """
    about = recording.metadata
    ratio = section_over_length_mm(about)
    if ratio is not None or {"stretch", "stress"} <= recording.channels.keys():
        return ratio
    _, length, section = _sizes(about)
    ratio = section * _KPA_PER_MPA / length
    return None if ratio == 1.0 else ratio


def _sizes(about: RecordingMetadata) -> tuple[float, float, float]:
    """Stretch at displacement 0, length in mm, section in mm² per N/kPa, of the undeformed film.

    What of its sizes is not known is that of a 1 mm cube.
    """
    whole, stretch = Geometry.of(about), about.pre_stretch or 1.0
    length = about.film_length_mm if whole is None else whole.length_mm / stretch
    return stretch, length or 1.0, (about.undeformed_section_mm2 or 1.0) / _KPA_PER_MPA


def _at(channel: Channel, other: Channel) -> Float:
    """A channel's values at another's times, by straight lines; NaN outside of it."""
    if channel.time_ns.size == other.time_ns.size and np.array_equal(channel.time_ns, other.time_ns):
        return channel.values
    good = np.isfinite(channel.values)
    if good.sum() < 2:
        raise NotIdentifiableError("no usable force", where=channel.quantity, expected="at least two finite samples")
    start = other.time_ns[0]
    times, wanted = (channel.time_ns[good] - start).astype(float), (other.time_ns - start).astype(float)
    return np.asarray(np.interp(wanted, times, channel.values[good], left=np.nan, right=np.nan))
