"""Films at several temperatures: master curves, shifts, laws of the shifts, Prony series."""

from __future__ import annotations

from schemas.tables.table import SPECIMEN_ID, MadeBy, Table, real, text, truth, whole, with_bounds, with_uncertainty

_MADE_BY = (MadeBy("specimen"),)
_RECORDING_ID = text("recording_id", "the recording", refers_to="recording_id")

TABLES: tuple[Table, ...] = (
    Table(
        "master_curves",
        "time-temperature superposition of a specimen's recordings at several temperatures, a row per specimen",
        (
            SPECIMEN_ID,
            real("reference_c", "degC", "temperature at which the curve stands"),
            whole("temperatures", "recordings that were shifted together, the reference included"),
            real("frequency_low_hz", "Hz", "lowest reduced frequency; NULL where all are relaxations"),
            real("frequency_high_hz", "Hz", "highest reduced frequency; NULL where all are relaxations"),
            truth("vertical", "vertical shifts were used"),
            real("vertical_p", "", "p that no vertical shift is needed (score test); NULL where they were used"),
            real("p_value", "", "p that one curve is enough for all temperatures"),
            real("magnitude_noise", "", "noise of the magnitude about a curve of each temperature's own, relative"),
            real("phase_noise_deg", "deg", "noise of the phase likewise; NULL where all are relaxations"),
            text("unit", "unit of the values in the file: of a modulus, or N/mm of a stiffness"),
            real("n_per_mm_of_unit", "N/mm", "stiffness that one of this unit became"),
            text("warnings", "where the superposition does not hold; NULL where it holds"),
        ),
        key=("specimen_id",),
        made_by=_MADE_BY,
        pages=("specimen",),
    ),
    Table(
        "shift_factors",
        "the shifts of each temperature of a master curve, and how far the common curve is from it",
        (
            SPECIMEN_ID,
            _RECORDING_ID,
            real("temperature_c", "degC", "temperature of the recording, mean of its rows"),
            real("reference_c", "degC", "temperature at which the curve stands"),
            truth("fixed", "the reference itself, whose shifts are 0 and 1"),
            *with_uncertainty("log10_a", "", "horizontal shift: value(f, T) = b value(a f, reference), as log10 a"),
            *with_bounds("b", "", "vertical shift; 1 where none is used"),
            real("magnitude_misfit", "", "root mean square of |curve/measured| - 1"),
            real("phase_misfit_deg", "deg", "root mean square of the phase, curve less measured; NULL of a relaxation"),
            real(
                "van_gurp_palmen_sd",
                "SD of the noise",
                "root mean square distance from the common curve of phase over magnitude, which no horizontal shift"
                " changes; about 1 where the superposition holds, NULL of a relaxation",
            ),
            real("p_value", "", "p that the common curve leaves no more than noise at this temperature"),
        ),
        key=("specimen_id", "recording_id"),
        made_by=_MADE_BY,
        pages=("specimen",),
    ),
    Table(
        "shift_laws",
        "laws of the shifts over temperature, a row per specimen and law",
        (
            SPECIMEN_ID,
            text("law", "WLF: log10 a = -C1 (T - Tref)/(C2 + T - Tref); Arrhenius: ln a = E/R (1/T - 1/Tref)"),
            real("reference_c", "degC", "Tref"),
            *with_bounds("c1", "", "C1 of WLF; a limit is NULL where nothing limits it"),
            *with_bounds("c2_k", "K", "C2 of WLF"),
            *with_bounds("energy_kj_per_mol", "kJ/mol", "activation energy E of Arrhenius"),
            real("chi2", "", "what the law leaves of the shifts, in units of their own errors"),
            whole("degrees_of_freedom", "shifts less constants of the law"),
            real("p_value", "", "p that it leaves no more than these errors; NULL without degrees of freedom"),
            real("off_decades", "", "root mean square of what it leaves, in log10 a"),
            truth("selected", "describes the shifts better than the other (chi2 and number of constants)"),
        ),
        key=("specimen_id", "law"),
        made_by=_MADE_BY,
        pages=("specimen",),
    ),
    Table(
        "master_curve_points",
        "every point of a master curve, shifted, in the unit of its file",
        (
            SPECIMEN_ID,
            _RECORDING_ID,
            real("temperature_c", "degC", "temperature of the recording"),
            real("frequency_hz", "Hz", "frequency that was measured; NULL of a relaxation"),
            real("reduced_frequency_hz", "Hz", "a times that"),
            real("time_s", "s", "time since the step; NULL of a response"),
            real("reduced_time_s", "s", "that over a"),
            real("storage", "unit", "storage modulus or stiffness over b; of a relaxation its value over b"),
            real("loss", "unit", "loss modulus or stiffness over b; NULL of a relaxation"),
            real("tan_delta", "", "loss over storage"),
            real("curve_storage", "unit", "the common curve there"),
            real("curve_loss", "unit", "the common curve there"),
            text("unit", "unit of these values, as in the file"),
        ),
        key=("specimen_id", "recording_id", "frequency_hz", "time_s"),
        made_by=_MADE_BY,
        pages=("specimen",),
    ),
    Table(
        "prony_series",
        "models over wide bands term by term (Maxwell-Wiechert models as Prony series), a row per order and term",
        (
            SPECIMEN_ID,
            whole("model_order", "number of arms asked for"),
            whole("term", "0: the main spring; then the arms, longest relaxation first"),
            real("tau_s", "s", "relaxation time; NULL of the main spring and of a pure dashpot"),
            real("stiffness_n_per_mm", "N/mm", "spring; NULL of a pure dashpot"),
            real("share", "", "spring over the sum of all springs"),
            real("modulus", "unit", "spring in the unit of the file, where that is a modulus"),
            real("damper_n_s_per_mm", "N s/mm", "damper; NULL of the main spring"),
            text("unit", "unit of modulus; NULL where the file has a stiffness"),
            truth("enough", "the least order of which one more arm is no significant gain at 1 %"),
        ),
        key=("specimen_id", "model_order", "term"),
        made_by=_MADE_BY,
        pages=("specimen",),
    ),
)
