"""A large load-unload cycle as stretch and nominal stress over time, whatever the machine gave, its fits, and what each cycle takes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.fit.relaxation.metrics import Geometry
from pipeline.fit.relaxation.time_domain import HELD_OUT, CycleFit, CycleFits, fit_cycle
from pipeline.transform.loops import find_loops
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
    laws = (None,) if given is None else (given, None)
    fits = tuple(
        fit_cycle(
            time,
            stretch,
            stress,
            equilibrium=law,
            recording_id=about.recording_id,
            specimen_id=about.specimen_id,
            section_over_length_mm=_taken_section_over_length_mm(recording),
        )
        for law in laws
    )
    return Cycle(time, stretch, stress, fits)


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
    driven, answer = (
        recording.channels[n] for n in (("stretch", "stress") if has_stress else ("displacement", "force"))
    )
    time, x, y = np.asarray((driven.time_ns - recording.start_ns) * 1e-9), driven.values, _at(answer, driven)
    good = np.isfinite(x) & np.isfinite(y)
    time, x, y = time[good], x[good], y[good]
    section = about.undeformed_section_mm2
    volume = None if section is None or about.film_length_mm is None else section * about.film_length_mm

    def energy(value: float | None) -> float | None:
        """A loss in mJ: N mm as recorded, or kJ/m³ of the film's volume."""
        if value is None or not has_stress:
            return value
        return None if volume is None else value * volume / _KPA_PER_MPA

    def density(value: float | None) -> float | None:
        """A loss in kJ/m³ of undeformed film."""
        if value is None or has_stress:
            return value
        return None if volume is None else value / volume * _KPA_PER_MPA

    def only(value: float, is_there: bool) -> float | None:
        return value if is_there else None

    return TABLES["cycle_loops"].from_objects(
        enumerate(find_loops(time, x, y), 1),
        recording_id=about.recording_id,
        specimen_id=about.specimen_id,
        cycle=lambda one: one[0],
        unclosed=lambda one: one[1].unclosed,
        start_s=lambda one: float(time[one[1].first]),
        end_s=lambda one: float(time[one[1].last]),
        displacement_low_mm=lambda one: only(one[1].low, not has_stress),
        displacement_high_mm=lambda one: only(one[1].high, not has_stress),
        stretch_low=lambda one: only(one[1].low, has_stress),
        stretch_high=lambda one: only(one[1].high, has_stress),
        force_low_n=lambda one: only(one[1].least, not has_stress),
        force_high_n=lambda one: only(one[1].most, not has_stress),
        stress_low_kpa=lambda one: only(one[1].least, has_stress),
        stress_high_kpa=lambda one: only(one[1].most, has_stress),
        loss_mj=lambda one: energy(one[1].loss),
        loss_kj_per_m3=lambda one: density(one[1].loss),
        steady_loss_mj=lambda one: energy(one[1].steady_loss),
        steady_loss_kj_per_m3=lambda one: density(one[1].steady_loss),
        loss_share=lambda one: one[1].loss_share,
        secant_n_per_mm=lambda one: only(one[1].secant, not has_stress),
        secant_kpa=lambda one: only(one[1].secant, has_stress),
    )


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
