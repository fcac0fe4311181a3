"""Every table of `results.duckdb`, once.

From one `Table` come the arrow schema that workers fill, the DDL with its comments, and the table reference in the
README (`dealab schema`). Views are in `schemas.views`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pyarrow as pa

TEXT, REAL, WHOLE, TRUTH, TIME, LIST = "VARCHAR", "DOUBLE", "BIGINT", "BOOLEAN", "TIMESTAMPTZ", "VARCHAR[]"
ARMS = 8
"""Most arms of a stored relaxation model."""


@dataclass(frozen=True)
class Column:
    """A column: name, SQL type, unit ("" for text and pure numbers) and meaning."""

    name: str
    type: str
    unit: str
    meaning: str
    required: bool = False

    @property
    def comment(self) -> str:
        return f"{self.meaning} [{self.unit}]" if self.unit else self.meaning


@dataclass(frozen=True)
class Table:
    """A table: its rows' meaning, its columns, and the columns by which rows are ordered when published."""

    name: str
    meaning: str
    columns: tuple[Column, ...]
    order: tuple[str, ...]
    internal: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.columns)

    @functools.cached_property
    def arrow_schema(self) -> pa.Schema:
        import pyarrow as pa

        types = {
            TEXT: pa.string(),
            REAL: pa.float64(),
            WHOLE: pa.int64(),
            TRUTH: pa.bool_(),
            TIME: pa.timestamp("us", tz="UTC"),
            LIST: pa.list_(pa.string()),
        }
        return pa.schema([pa.field(c.name, types[c.type], nullable=not c.required) for c in self.columns])

    def ddl(self) -> str:
        """CREATE TABLE and COMMENT statements."""
        body = ",\n".join(f'    "{c.name}" {c.type}{" NOT NULL" if c.required else ""}' for c in self.columns)
        lines = [f"CREATE TABLE {self.name} (\n{body}\n);", f"COMMENT ON TABLE {self.name} IS {_quoted(self.meaning)};"]
        lines += [f'COMMENT ON COLUMN {self.name}."{c.name}" IS {_quoted(c.comment)};' for c in self.columns]
        return "\n".join(lines)

    def rows(self, rows: Iterable[Mapping[str, Any]]) -> pa.Table:
        """An arrow table from dictionaries. Absent keys are NULL; a key that is no column raises `KeyError`."""
        import pyarrow as pa

        rows = list(rows)
        unknown = {key for row in rows for key in row} - set(self.names)
        if unknown:
            raise KeyError(f"{self.name} has no column {sorted(unknown)}")
        return pa.Table.from_pylist(
            [{n: _plain(row.get(n)) for n in self.names} for row in rows], schema=self.arrow_schema
        )

    def arrays(self, length: int, **columns: Any) -> pa.Table:
        """An arrow table of `length` rows from arrays or scalars by column. NaN becomes NULL in real columns."""
        import pyarrow as pa

        unknown = set(columns) - set(self.names)
        if unknown:
            raise KeyError(f"{self.name} has no column {sorted(unknown)}")
        fields = []
        for column, kind in zip(self.columns, self.arrow_schema, strict=True):
            value = columns.get(column.name)
            if value is None:
                fields.append(pa.nulls(length, kind.type))
            elif isinstance(value, str | bytes) or (not isinstance(value, Sequence) and not hasattr(value, "__len__")):
                fields.append(pa.repeat(pa.scalar(_plain(value), kind.type), length))
            else:
                fields.append(pa.array(value, kind.type, from_pandas=True))
        return pa.Table.from_arrays(fields, schema=self.arrow_schema)

    def empty(self) -> pa.Table:
        return self.arrow_schema.empty_table()


def _plain(value: Any) -> Any:
    """NaN and infinity become NULL, numpy scalars become Python's."""
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, tuple):
        return list(value)
    return value


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _t(name: str, meaning: str, **kw: Any) -> Column:
    return Column(name, TEXT, "", meaning, **kw)


def _r(name: str, unit: str, meaning: str) -> Column:
    return Column(name, REAL, unit, meaning)


def _n(name: str, meaning: str) -> Column:
    return Column(name, WHOLE, "", meaning)


def _with_sd(name: str, unit: str, meaning: str) -> tuple[Column, Column]:
    return _r(name, unit, meaning), _r(
        f"{name}_sd", unit, f"standard deviation of {name}; NULL where unresolved or at a bound"
    )


def _with_bounds(name: str, unit: str, meaning: str) -> tuple[Column, Column, Column]:
    return (
        _r(name, unit, meaning),
        _r(f"{name}_lower", unit, f"lower 95 % limit of {name}"),
        _r(f"{name}_upper", unit, f"upper 95 % limit of {name}"),
    )


def _measured(name: str, unit: str, meaning: str) -> tuple[Column, ...]:
    """Value, standard deviation and 95 % limits."""
    value, lower, upper = _with_bounds(name, unit, meaning)
    return value, _r(f"{name}_sd", unit, f"standard deviation of {name}"), lower, upper


_RECORDING = _t("recording_id", "the recording")
_SPECIMEN = _t("specimen_id", "the specimen")
_STEP_DETAILS = (
    _r("start_s", "s", "on-edge since the recording's first sample"),
    _r("end_s", "s", "off-edge since the recording's first sample"),
    _r("force_rest_n", "N", "tension before the step"),
    _r("force_step_sd_n", "N", "standard deviation of force_step_n: noise and the slow change beside it"),
    _r("capacitance_rest_pf", "pF", "capacitance before the step"),
    _r("capacitance_step_sd_pf", "pF", "standard deviation of capacitance_step_pf, likewise"),
    _r("capacitance_mean_fraction", "", "mean of the capacitance's course while the voltage is on, over the step"),
    _n("spikes", "samples of the capacitance left out near edges"),
    _t("warnings", "what could not be computed and why"),
)
_CONFIGURATION = _t("configuration", "how the specimen is built: the group it is compared in")

_ALL: tuple[Table, ...] = (
    Table(
        "recordings",
        "one row per file that was found as a recording or refused as one",
        (
            _t("recording_id", "identity of the recording; NULL where a refused file's cannot be read"),
            _t("campaign", "the campaign"),
            _SPECIMEN,
            _t("material", "the film's material"),
            _CONFIGURATION,
            _t("protocol", "kind of test"),
            _t("loading", "mechanical, electrical, calibration or other"),
            _t("rig_id", "the rig"),
            _t("operator", "who measured"),
            Column("started_at", TIME, "", "start of the test, UTC"),
            _r("duration_s", "s", "first to last sample"),
            _n("sample_count", "samples of all channels together"),
            _t("source_path", "file it was read from, absolute"),
            _t(
                "source_sha256",
                "SHA-256 of that file; where mappings read the same bytes in different ways, further ones have a mark",
            ),
            _t("samples_path", "samples Parquet, relative to the lab"),
            _t("status", "ok, damaged (usable in part), quarantined, duplicate, pending or excluded"),
            _t("problem", "what is lost, wrong or refused, and what was expected; NULL when nothing is"),
            _t("notes", "what is worth knowing and no fault: jitter, gaps"),
            _t("kind", "recording, lifetimes or frequency_response"),
            _t("metadata", "all keys of the recording and its rig, JSON"),
            _t("software_version", "version that read it"),
            _t("run_id", "run in which it came in or last changed"),
            Column("source_present", TRUTH, "", "the source file was still there in the last run that looked for it"),
        ),
        ("started_at", "recording_id", "source_path"),
    ),
    Table(
        "annotations",
        "recordings taken out of the analysis or back in, by whom and why",
        (
            _RECORDING,
            _t("action", "exclude or include"),
            _t("why", "the reason given"),
            _t("author", "who"),
            Column("at", TIME, "", "when, UTC"),
        ),
        ("at", "recording_id"),
    ),
    Table(
        "previews",
        "envelope of each channel for the pages, at most 2000 points",
        (
            _RECORDING,
            _t("quantity", "the channel"),
            _r("time_s", "s", "since the recording's first sample"),
            _r("low", "canonical unit", "least value in the interval that begins here"),
            _r("high", "canonical unit", "largest value in that interval"),
        ),
        ("recording_id", "quantity", "time_s"),
    ),
    Table(
        "frequency_responses",
        "response of a recording, or averaged over a specimen's recordings, by frequency",
        (
            _t("recording_id", "the recording; NULL for averaged rows"),
            _SPECIMEN,
            _t("loading", "mechanical, electrical or other"),
            _t("quantity", "stiffness_n_per_mm, force_per_voltage_squared_n_per_kv2, or output_per_input"),
            _t("stage", "measured, corrected (clamp and load cell taken out) or averaged (corrected, over recordings)"),
            _r("frequency_hz", "Hz", "frequency"),
            _r("real", "unit of quantity", "real part"),
            _r("imag", "unit of quantity", "imaginary part"),
            _r("magnitude", "unit of quantity", "magnitude"),
            _r("phase_deg", "deg", "phase; a delayed output has negative phase"),
            _r("standard_error", "unit of quantity", "square root of E|dH|^2, both components together"),
            _r("coherence", "", "magnitude-squared coherence; NULL where one sweep cannot give it"),
            _r("amplification", "", "factor from relative noise of the measured to that of the corrected response"),
            Column("usable", TRUTH, "", "amplification at most 5 and enough excitation and coherence"),
            _t("unusable_because", "why usable is false"),
            _r("amplitude", "input unit", "amplitude of the input, where one is defined (strain for cyclic tests)"),
            _r(
                "between_spread",
                "unit of quantity",
                "averaged rows: standard deviation between recordings beyond noise",
            ),
        ),
        ("specimen_id", "recording_id", "quantity", "stage", "frequency_hz"),
    ),
    Table(
        "distortions",
        "harmonics and lines that a linear system would leave empty",
        (
            _RECORDING,
            _r("frequency_hz", "Hz", "frequency of the line"),
            _t("kind", "even, odd or noise"),
            _r("level", "see unit", "amplitude at that line"),
            _t("unit", "unit of level"),
            _n("harmonic", "order of the harmonic for cyclic tests"),
        ),
        ("recording_id", "kind", "frequency_hz"),
    ),
    Table(
        "model_fits",
        "Maxwell-Wiechert models, a row per specimen, loading, method and order",
        (
            _SPECIMEN,
            _t("loading", "mechanical, electrical or joint"),
            _t("method", "forward (rig inside the model), corrected (divided response) or time_domain (large cycles)"),
            _n("model_order", "number of arms, pure dashpots included"),
            *_with_sd("k0_n_per_mm", "N/mm", "main spring"),
            *(
                c
                for i in range(1, ARMS + 1)
                for c in (
                    *_with_sd(
                        f"k{i}_n_per_mm",
                        "N/mm",
                        f"spring of arm {i}, longest relaxation first; NULL for a pure dashpot",
                    ),
                    *_with_sd(f"c{i}_n_s_per_mm", "N s/mm", f"damper of arm {i}"),
                )
            ),
            _r(
                "magnitude_error_n_per_mm",
                "N/mm",
                "mean | |k_model| - |k_measured| | over the usable lines (thesis, eq 4.14)",
            ),
            _r("phase_error_deg", "deg", "mean |arg(k_model/k_measured)| over the usable lines (thesis, eq 4.14)"),
            *_with_sd("clamp_mass_kg", "kg", "fitted clamp mass"),
            *_with_sd("load_cell_stiffness_n_per_mm", "N/mm", "fitted load-cell stiffness"),
            *_with_sd("load_cell_damping_n_s_per_mm", "N s/mm", "fitted load-cell damping"),
            *_with_sd("force_per_voltage_squared_n_per_kv2", "N/kV^2", "fitted actuation force over voltage squared"),
            _t("extension", "mechanisms in the model; empty for the plain one"),
            _n("frequency_lines", "complex values fitted"),
            _r("reduced_chi2", "", "chi-squared over degrees of freedom"),
            _r("bic", "", "Bayesian information criterion, -2 ln L + p ln N"),
            Column("selected", TRUTH, "", "this row's order is the chosen one for specimen, loading and method"),
            _t("warnings", "what limits the fit: active bounds, unresolved arms, positivity; empty when nothing does"),
            _r("order_p_value", "", "p of this order against the next: small means that the next is needed"),
            _r("held_out_error", "SD of the noise", "root mean square error on recordings left out"),
            _r("frequency_low_hz", "Hz", "lowest fitted frequency"),
            _r("frequency_high_hz", "Hz", "highest fitted frequency"),
            _r("positivity_chi2", "", "chi-squared per line of the best relaxation of any order"),
            _r("modulus_mpa", "MPa", "k0 times stretched length over stretched area"),
            _t("covariance", "covariance of the parameters at the solution, JSON {names, matrix}"),
            _t("intervals", "95 % limits, JSON {parameter: {lower, upper, method}}; null: no limit on that side"),
            _t("choices", "order that each rule would choose, JSON {test, bic, held_out}"),
            _t("spread", "differences between the recordings, JSON {gain_sd, relative_sd, gains}; NULL for none"),
        ),
        ("specimen_id", "loading", "method", "extension", "model_order"),
    ),
    Table(
        "order_ladders",
        "responses over many decades: what each number of arms reaches, a row per specimen and number",
        (
            _SPECIMEN,
            _n("model_order", "number of arms asked for"),
            _n("resolved_arms", "arms that the data carry of them, a pure dashpot included"),
            _r("relative_error", "", "root mean square of |model/measured - 1| over all lines and times"),
            _r("r_squared_storage", "", "coefficient of determination of the real part; NULL without responses"),
            _r("r_squared_loss", "", "coefficient of determination of the imaginary part; NULL without responses"),
            _r("r_squared_relaxation", "", "coefficient of determination of relaxation in time; NULL without curves"),
            _r("order_p_value", "", "p of this number against one more: small means that one more is needed"),
        ),
        ("specimen_id", "model_order"),
    ),
    Table(
        "cycle_fits",
        "a large load-unload cycle as an equilibrium stress with relaxation branches, a row per recording, law and order",
        (
            _RECORDING,
            _SPECIMEN,
            _t("law", "equilibrium stress: non-affine (crosslinks and entanglements)"),
            Column(
                "law_given",
                TRUTH,
                "",
                "the recording's metadata give the law's parameters; false: fitted with the branches",
            ),
            _n("model_order", "number of branches asked for"),
            _r("rmse_kpa", "kPa", "root mean square error of the nominal stress over the whole cycle"),
            _r("relative_rmse", "", "the same over the largest stress"),
            _r(
                "held_out_rmse_kpa",
                "kPa",
                "root mean square error on the last part of the cycle, after a fit to the rest",
            ),
            _r("held_out_from_s", "s", "where that part begins, since the recording's first sample"),
            _r("residual_correlation", "", "correlation of neighbouring residuals: near 1 it is no noise that is left"),
            _n("samples", "samples fitted"),
            Column("selected", TRUTH, "", "the order chosen for this law, by the error on the part left out"),
            _t("equilibrium", "parameters of the law, moduli in kPa, JSON"),
            _t("branches", "JSON list of {gamma_kpa, tau_s, eta_kpa_s} with _sd (null: not resolved), longest first"),
            _t("warnings", "what limits the fit"),
        ),
        ("recording_id", "law_given", "model_order"),
    ),
    Table(
        "cycle_curves",
        "measured and modelled nominal stress of a large cycle, thinned for the pages",
        (
            _RECORDING,
            Column("law_given", TRUTH, "", "as in cycle_fits"),
            _n("model_order", "number of branches asked for"),
            _r("time_s", "s", "since the recording's first sample"),
            _r("stretch", "", "length over undeformed length"),
            _r("measured_kpa", "kPa", "measured nominal stress"),
            _r("modelled_kpa", "kPa", "modelled nominal stress"),
        ),
        ("recording_id", "law_given", "model_order", "time_s"),
    ),
    Table(
        "predictions",
        "the model of one loading or protocol against recordings of another",
        (
            _SPECIMEN,
            _t("fitted_on", "what the model was fitted on"),
            _t("predicted", "what it was asked to predict"),
            _r("magnitude_error", "unit of the response", "mean absolute error of the magnitude"),
            _r("phase_error_deg", "deg", "mean absolute error of the phase"),
            _r("relative_error", "", "root mean square of |error|/|measured|"),
        ),
        ("specimen_id", "fitted_on", "predicted"),
    ),
    Table(
        "step_responses",
        "one row per step of a recording",
        (
            _RECORDING,
            _SPECIMEN,
            _n("cycle", "number of the step, from 1"),
            _r("voltage_kv", "kV", "voltage of the step"),
            _r("force_step_n", "N", "drop of tension"),
            _r("capacitance_step_pf", "pF", "change of capacitance"),
            _r("capacitive_strain", "", "|change| over rest capacitance"),
            _r("force_instant_fraction", "", "share of the step 0.1 s after the voltage has reached 90 %"),
            _r("capacitance_instant_fraction", "", "the same of the capacitance"),
            _r("rise_time_s", "s", "10 to 90 % of the step"),
            _r("overshoot_percent", "%", "above the final level"),
            _r("settling_time_s", "s", "last exit from +-5 %, or from the reach of the noise if wider"),
            _r("recovery_time_s", "s", "after the fall, until 90 % of the step is gone; NULL if longer than recorded"),
            Column("wrinkled", TRUTH, "", "capacitance step no longer grows with voltage and recovery is delayed"),
            *_STEP_DETAILS,
        ),
        ("recording_id", "cycle"),
    ),
    Table(
        "slow_changes",
        "slow change of a channel beside its steps, from the rest levels of a recording",
        (
            _RECORDING,
            _SPECIMEN,
            _t("quantity", "force or capacitance"),
            *_with_sd("change", "unit of quantity", "from the first to the last rest level"),
            _r("duration_s", "s", "between those"),
            _t("shape", "line b t/T, logarithm b log10(1 + t/T) or exponential b (1 - exp(-t/T))"),
            _r("bend_s", "s", "T of that"),
            *_with_sd("unrecovered", "", "share of a step that is still there at the rest level after it"),
            _r("fading", "", "share of a step that goes in the second half of the rest after it"),
        ),
        ("recording_id", "quantity"),
    ),
    Table(
        "sensing_fits",
        "self-sensing of a specimen",
        (
            _SPECIMEN,
            _t("sensing_region", "separate, or active: one region actuates and senses"),
            *_measured("force_per_capacitive_strain_n", "N", "slope of force against capacitive strain"),
            _r("r_squared", "", "of that line; NULL for one level of voltage"),
            *_measured("nonlinearity", "", "departure of a parabola from the line at the largest strain, as a share"),
            *_measured("modulus_mpa", "MPa", "modulus that the slope implies"),
            *_with_sd("mechanical_modulus_mpa", "MPa", "modulus of the mechanical model for the same creep"),
            *_measured("modulus_ratio", "", "modulus_mpa over mechanical_modulus_mpa"),
            *_measured("sensitivity", "", "change of capacitive strain per stretch of the active region"),
            _r("predicted_sensitivity", "", "the same from the geometry"),
            *_measured("drift_pf_per_hour", "pF/h", "drift of the capacitance at given force"),
            *_measured("wrinkling_onset_kv", "kV", "voltage above which the film wrinkles; NULL where none was seen"),
            *_measured("force_exponent", "", "exponent of the force step in the voltage; 2 for Maxwell stress"),
            _n("steps", "steps in the fit"),
            _t("warnings", "what limits the fit"),
        ),
        ("specimen_id",),
    ),
    Table(
        "loop_responses",
        "closed loops: response to the first change of the demand",
        (
            _RECORDING,
            _SPECIMEN,
            _r("proportional_gain", "V/pF", "gain of the controller"),
            _r("integral_gain", "V/pF/s", "gain of its integral"),
            _r("start_s", "s", "change of the demand since the recording's first sample"),
            _r("hold_s", "s", "until the next change or the end"),
            _r("demand_step_pf", "pF", "change of the demand; NULL where it was not recorded"),
            _r("capacitance_rest_pf", "pF", "capacitance before"),
            _r("capacitance_step_pf", "pF", "change of the capacitance at the end of the hold"),
            _r("rise_time_s", "s", "10 to 90 % of the demanded step"),
            _r("overshoot_percent", "%", "capacitance beyond the demand; 0 where noise explains it"),
            _r(
                "settling_time_s",
                "s",
                "last exit from +-5 % around the demand, or from the reach of the noise if wider",
            ),
            _r("error_rms_pf", "pF", "root mean square of capacitance less demand once settled"),
            _r("force_step_n", "N", "drop of tension at the end of the hold"),
            _r("force_overshoot_percent", "%", "largest drop of tension beyond that"),
            _r("peak_kv", "kV", "largest voltage"),
            _r("final_kv", "kV", "voltage at the end of the hold"),
            _n("error_sign", "1: the voltage rose because the capacitance was above the demand; -1: because below"),
            *_with_sd("relation_drift_percent", "%", "change of the force at given capacitance from 20 s to the end"),
            _t("warnings", "what could not be computed and why"),
        ),
        ("recording_id",),
    ),
    Table(
        "controller_gains",
        "gains proposed for a specimen's controller, from the closed loops that were tried on it",
        (
            _SPECIMEN,
            _r("demand_step_pf", "pF", "change of the demand"),
            _n("tried", "pairs of gains"),
            _n("kept", "pairs with a rise within 0.5 s and an overshoot within 10 %"),
            _t("recording_id", "the proposed loop: of those, the one whose force overshoots least; NULL for none"),
            _r("proportional_gain", "V/pF", "its gain"),
            _r("integral_gain", "V/pF/s", "its gain of the integral"),
            _t("gentle_recording_id", "the quickest loop whose force overshoots by 10 % at most; NULL for none"),
            _t("statement", "the proposal in words and numbers"),
        ),
        ("specimen_id", "demand_step_pf"),
    ),
    Table(
        "electrode_coats",
        "capacitance at rest after each coat of electrode",
        (
            _RECORDING,
            _SPECIMEN,
            _n("coats", "coats so far"),
            *_with_sd("capacitance_pf", "pF", "capacitance at rest"),
        ),
        ("specimen_id", "coats"),
    ),
    Table(
        "coverage_fits",
        "how coats of electrode cover a sensing region",
        (
            _SPECIMEN,
            _n("coats", "most coats measured"),
            *_measured("full_pf", "pF", "capacitance of the covered region"),
            *_measured("first_share", "", "share that the first coat covers"),
            *_measured("coats_to_cover", "", "coats that cover 99 %"),
            _t("form", "likeliest form of the rise; the numbers are averages over three"),
            _t("warnings", "what limits the fit"),
        ),
        ("specimen_id",),
    ),
    Table(
        "electrode_cycles",
        "wave of a capacitance under cyclic strain, cycle by cycle",
        (
            _RECORDING,
            _SPECIMEN,
            _n("cycle", "number of the cycle, from 1"),
            _r("mean_pf", "pF", "mean"),
            _r("amplitude_pf", "pF", "amplitude of the fundamental"),
            _r("distortion", "", "root sum of squares of the harmonics over the fundamental"),
            _r("second_harmonic", "", "second harmonic over the fundamental"),
            _r("third_harmonic", "", "third harmonic over the fundamental"),
        ),
        ("recording_id", "cycle"),
    ),
    Table(
        "electrode_migrations",
        "from which cycle on a sensing electrode migrates",
        (
            _RECORDING,
            _SPECIMEN,
            _n("cycles", "cycles measured"),
            *_with_bounds("onset_cycle", "", "cycle from which the wave distorts; NULL where it does not"),
            _r("p_value", "", "of a wave that does not change"),
            _r("distortion_before", "", "harmonics over the fundamental before the onset"),
            _r("distortion_after", "", "the same at the end"),
            _t("warnings", "what limits the onset"),
        ),
        ("recording_id",),
    ),
    Table(
        "force_maps",
        "static actuation force by pre-stretch",
        (
            _SPECIMEN,
            _CONFIGURATION,
            _r("stretch_1", "", "pre-stretch in direction 1"),
            _r("stretch_2", "", "pre-stretch in direction 2"),
            _n("direction", "1 or 2"),
            _r("force_n", "N", "mean drop of tension"),
            _r("force_sd_n", "N", "standard deviation of the repeats"),
            _n("repeats", "number of repeats"),
            _r("predicted_n", "N", "force from thesis, eq 3.7, with the metadata's permittivity"),
            *_with_sd("relative_permittivity", "", "permittivity that makes eq 3.7 meet the measurement"),
            _r("voltage_kv", "kV", "voltage"),
            _r("relative_permittivity_lower", "", "lower 95 % limit of relative_permittivity, from the repeats"),
            _r("relative_permittivity_upper", "", "upper 95 % limit of relative_permittivity, from the repeats"),
            _t("warnings", "what limits the point"),
        ),
        ("specimen_id", "direction", "stretch_1", "stretch_2"),
    ),
    Table(
        "force_map_fits",
        "one permittivity for all points of a specimen's force map, and whether it is one",
        (
            _SPECIMEN,
            _CONFIGURATION,
            _n("points", "points: stretches, directions and voltages"),
            *_with_bounds("relative_permittivity", "", "permittivity that meets all points best"),
            _r("stated_permittivity", "", "permittivity of the metadata"),
            _r("p_value", "", "of one permittivity against one for each point; NULL without repeats"),
            *_with_bounds("slope", "1 per area stretch", "change of the permittivity with stretch_1 x stretch_2"),
            _r("direction_p_value", "", "of equal permittivity in both directions"),
            _t("statement", "in words and numbers"),
            _t("warnings", "what limits these numbers"),
        ),
        ("specimen_id", "configuration"),
    ),
    Table(
        "force_comparisons",
        "static force of two configurations at one pair of pre-stretches",
        (
            _t("configuration_a", "first"),
            _t("configuration_b", "second"),
            _r("stretch_1", "", "pre-stretch in direction 1"),
            _r("stretch_2", "", "pre-stretch in direction 2"),
            _n("direction", "1 or 2"),
            _r("voltage_kv", "kV", "voltage"),
            _n("specimens_a", "specimens of the first"),
            _n("specimens_b", "specimens of the second"),
            *_with_bounds("difference_n", "N", "force of the second less that of the first"),
            *_with_bounds("ratio", "", "force of the second over that of the first"),
            _r("p_value", "", "of equal forces (Welch)"),
            _t("warnings", "what limits the comparison"),
        ),
        ("configuration_a", "configuration_b", "direction", "stretch_1", "stretch_2"),
    ),
    Table(
        "lifetimes",
        "life of each specimen under voltage",
        (
            _RECORDING,
            _SPECIMEN,
            _CONFIGURATION,
            _t("campaign", "the campaign"),
            _r("voltage_kv", "kV", "voltage set"),
            _r("lifetime_s", "s", "from 95 % of the set voltage to breakdown, or the time survived"),
            Column("failed", TRUTH, "", "broke down within the test"),
            _t("censored_because", "why the life is only known to be longer; NULL for a failure"),
            _n("glitches", "collapses that recovered within 0.5 s"),
            _r(
                "breakdown_voltage_kv",
                "kV",
                "voltage at breakdown where the voltage was being raised, after a fixed test as well",
            ),
            _t("failure_site", "rod, lead, active, edge, none or unknown"),
            _t("failure_region", "left, centre or right"),
            _t("warnings", "contradictions and what could not be decided"),
            Column(
                "decided", TRUTH, "", "the record tells a breakdown from other causes; false: see evidence and warnings"
            ),
            _r("probability_failed", "", "that a breakdown made the voltage fall in the end; NULL where nothing fell"),
            _r("probability_switched_off", "", "that the end of the test or the operator did"),
            _r("probability_supply", "", "that the supply sagged or tripped"),
            _r("probability_monitor", "", "that only the monitor lost the voltage"),
            _t("evidence", "what the record shows around that fall, each with its log odds for a breakdown"),
            _t("contradiction", "what in the record speaks against the verdict: failure_site, current or force"),
            _r("test_duration_s", "s", "planned duration of the test"),
            Column("staircase", TRUTH, "", "voltage raised before a fixed test was over: no life at one voltage"),
        ),
        ("configuration", "voltage_kv", "lifetime_s", "specimen_id", "recording_id"),
    ),
    Table(
        "survival_curves",
        "Kaplan-Meier curve per configuration and voltage",
        (
            _CONFIGURATION,
            _r("voltage_kv", "kV", "voltage"),
            _r("time_s", "s", "time"),
            _n("at_risk", "at risk just before"),
            _n("failures", "failures at this time"),
            _n("censored", "censored at this time"),
            *(
                _r(n, "", m)
                for n, m in (
                    ("survival", "probability to live longer"),
                    ("lower_95", "lower limit, log-log band; NULL where undefined"),
                    ("upper_95", "upper limit, log-log band; NULL where undefined"),
                )
            ),
        ),
        ("configuration", "voltage_kv", "time_s"),
    ),
    Table(
        "survival_summaries",
        "survival in numbers per configuration and voltage",
        (
            _CONFIGURATION,
            _r("voltage_kv", "kV", "voltage"),
            _n("specimens", "specimens"),
            _n("failures", "failures"),
            *_with_bounds("restricted_mean_s", "s", "mean life up to restricted_to_s"),
            _r("restricted_to_s", "s", "shortest common follow-up"),
            *_with_bounds("median_s", "s", "median life; NULL when not reached"),
            *_with_bounds("survival_at_end", "", "survival at the end of the follow-up"),
            *_with_bounds("weibull_shape", "", "Weibull shape; NULL when the data cannot carry it"),
            *_with_bounds("weibull_scale_s", "s", "Weibull scale"),
            _t("warnings", "what limits these numbers"),
            _t("campaign", "the campaigns of the specimens"),
        ),
        ("configuration", "voltage_kv"),
    ),
    Table(
        "survival_comparisons",
        "tests between configurations",
        (
            _t("configuration_a", "first"),
            _t("configuration_b", "second"),
            _r("voltage_kv", "kV", "voltage"),
            _t("test", "name of the test"),
            _r(
                "statistic",
                "see test",
                "its statistic; the hazard ratio (b over a) or the difference of restricted means (b - a, s)",
            ),
            _r("statistic_lower", "see test", "lower 95 % limit of a ratio or difference"),
            _r("statistic_upper", "see test", "upper 95 % limit of a ratio or difference"),
            _r("p_value", "", "its p-value, of this pair alone"),
            _r("p_value_holm", "", "p-value corrected for the number of pairs (Holm)"),
            _t("warnings", "what limits the comparison"),
        ),
        ("configuration_a", "configuration_b", "voltage_kv", "test"),
    ),
    Table(
        "lifetime_distributions",
        "lifetime distributions fitted by censored likelihood, a row per parameter",
        (
            _CONFIGURATION,
            _r("voltage_kv", "kV", "voltage"),
            _t("distribution", "weibull, exponential or log-normal"),
            _t("parameter", "shape, scale_s, mean_s, median_s or log_sd"),
            _r("value", "see parameter", "maximum-likelihood estimate"),
            _r("lower_95", "see parameter", "lower profile-likelihood limit"),
            _r("upper_95", "see parameter", "upper profile-likelihood limit"),
            _r("log_likelihood", "", "of the times in s"),
            _r("aic", "", "Akaike's criterion, smaller is better"),
            _r("distance", "", "largest distance between its curve and Kaplan-Meier"),
            _r("p_value", "", "share of groups simulated from the fit with at least that distance"),
            _t("statement", "goodness of fit in words and numbers"),
        ),
        ("configuration", "voltage_kv", "distribution", "parameter"),
    ),
    Table(
        "failure_causes",
        "probability of having failed by each cause (Aalen-Johansen)",
        (
            _CONFIGURATION,
            _r("voltage_kv", "kV", "voltage"),
            _t("failure_site", "the cause; unknown sites are one of their own"),
            _r("time_s", "s", "time"),
            _n("failures", "failures by this cause at this time"),
            _r("probability", "", "probability to have failed by this cause"),
            _r("standard_error", "", "its standard error"),
            _r("lower_95", "", "lower limit, log-log band; NULL where undefined"),
            _r("upper_95", "", "upper limit, log-log band; NULL where undefined"),
        ),
        ("configuration", "voltage_kv", "failure_site", "time_s"),
    ),
    Table(
        "voltage_life",
        "inverse power law with Weibull scatter, ln t = intercept + exponent ln V + sigma w, per configuration",
        (
            _CONFIGURATION,
            _n("specimens", "specimens"),
            _n("failures", "failures"),
            *_with_bounds("intercept", "ln s", "a of ln t = a + n ln V"),
            *_with_bounds("exponent", "", "n, negative when life falls with voltage"),
            *_with_bounds("sigma", "", "scatter; the Weibull shape is 1/sigma"),
            _r("log_likelihood", "", "of the times in s"),
            _r("p_value", "", "of the law against a free Weibull at each voltage"),
            Column("holds", TRUTH, "", "the law is not rejected at 5 %; NULL where two voltages cannot test it"),
            _t("statement", "whether it holds and where not, in words and numbers"),
            _t("warnings", "what limits these numbers"),
        ),
        ("configuration",),
    ),
    Table(
        "voltage_residuals",
        "each voltage against the inverse power law",
        (
            _CONFIGURATION,
            _r("voltage_kv", "kV", "voltage"),
            _n("specimens", "specimens"),
            _n("failures", "failures"),
            _r("scale_s", "s", "Weibull scale at this voltage, with the shape common to all"),
            _r("law_scale_s", "s", "scale by the law"),
            _r("residual", "", "ln(scale / scale by the law)"),
            _r("standardised_residual", "", "residual over its standard deviation"),
            _r("p_value_without", "", "lack of fit of the law without this voltage"),
        ),
        ("configuration", "voltage_kv"),
    ),
    Table(
        "weak_regions",
        "where the film fails: expected and found",
        (
            _CONFIGURATION,
            _t("region", "left, centre or right third along the rods"),
            _r("predicted_share", "", "share of the failures expected here, from the film's thickness"),
            _r("predicted_share_lower", "", "least expected share over the plausible exponents of the power law"),
            _r("predicted_share_upper", "", "largest expected share over these exponents"),
            _r("observed_share", "", "share of the failures found here"),
            _r("observed_share_lower", "", "lower 95 % limit of observed_share, exact binomial"),
            _r("observed_share_upper", "", "upper 95 % limit of observed_share, exact binomial"),
            _n("failures", "failures found here"),
        ),
        ("configuration", "region"),
    ),
    Table(
        "electrode_layouts",
        "electrodes on the film over its rods: how much of them lies on thin film",
        (
            _CONFIGURATION,
            _t("scheme", "continuous (hyperelastic) or incremental (the thesis' steps, corrected)"),
            _r("thickness_limit", "", "film thinner than this share of the median thickness counts as thin"),
            _r("thin_share", "", "share of the active area on thin film"),
            _r("thinnest", "", "smallest thickness under an electrode over the median thickness"),
            _r("predicted_rod_share", "", "share of the failures expected within 1 mm of a rod"),
            _r("observed_rod_share", "", "share of the failures found at a rod"),
            _r("peak_field_mv_per_m", "MV/m", "field at the thinnest place under an electrode"),
        ),
        ("configuration", "scheme"),
    ),
    Table(
        "film_maps",
        "thickness of the film over its rods on a grid",
        (
            _CONFIGURATION,
            _t("scheme", "continuous or incremental"),
            _r("x_mm", "mm", "along the rods, the middle of the film at 0"),
            _r("y_mm", "mm", "across the rods"),
            _r("thickness", "", "thickness over undeformed thickness"),
            _r("relative_thickness", "", "thickness over the median of the film"),
            Column("active", TRUTH, "", "under an electrode"),
        ),
        ("configuration", "scheme", "y_mm", "x_mm"),
    ),
    Table(
        "discrepancies",
        "what the simulation of a recording gets wrong",
        (
            _SPECIMEN,
            _RECORDING,
            _t("where_found", "band, decade of time, cycle"),
            _r("chi2", "", "chi-squared of the block"),
            _r("degrees_of_freedom", "", "its degrees of freedom"),
            _r("p_value", "", "calibrated under the null"),
            _t("statement", "in words and numbers"),
        ),
        ("specimen_id", "recording_id", "where_found"),
    ),
    Table(
        "diagnoses",
        "why a specimen's simulation is wrong, and what mending it gains",
        (
            _SPECIMEN,
            _t("verdict", "none, named, ambiguous or unknown; NULL where nothing could be asked (see could_not_ask)"),
            _t("mechanism", "the strongest; NULL for none and unknown"),
            Column("mechanisms", LIST, "", "all that are named together"),
            Column(
                "also_possible", LIST, "", "what cannot be told apart from the strongest; unlisted: a cause in no list"
            ),
            _r("p_value", "", "of any discrepancy, calibrated under the null"),
            _t(
                "severity",
                "JSON: mechanism, parameter, {value, sd, lower, upper}: standard deviation and 90 % interval",
            ),
            Column("supported_by", LIST, "", "protocols that show it"),
            _r(
                "held_out_error_before", "SD of the noise", "root mean square error of the plain model on held-out data"
            ),
            _r("held_out_error_after", "SD of the noise", "the same of the extended model"),
            *_with_bounds("gain", "", "share of the removable held-out error that the extension removes"),
            _t("next_recording", "what to measure to tell the remaining causes apart"),
            _t("smallest_detectable", "JSON: mechanism, parameter, severity found with 80 % probability"),
            Column("invisible", LIST, "", "mechanisms that these recordings cannot show"),
            Column("could_not_ask", LIST, "", "questions that these recordings cannot answer, and why"),
            Column("unexplained", LIST, "", "what the best extension leaves, where and growing with what"),
            _n("recordings", "recordings in the session, calibrations of the rig included"),
            _n("feature_count", "numbers compared: bands, lines, windows, harmonics"),
            _r("chi2", "", "chi-squared of the plain model over all of them"),
            _r("chi2_extended", "", "the same of the extended model"),
            _t("held_out_parts", "JSON: part left out, {before, after}, root mean square error in SD of the noise"),
            _t(
                "next_design",
                "JSON: metadata keys of each recording that next_recording proposes; warmer_k: room warmer by",
            ),
            _r("next_separation", "", "expected difference in chi-squared of the two closest causes after it"),
        ),
        ("specimen_id",),
    ),
    Table(
        "diagnosis_candidates",
        "each cause that was tried",
        (
            _SPECIMEN,
            _t("mechanism", "the cause"),
            _r("likelihood_ratio", "", "2 x gain in log-likelihood"),
            _r("bic", "", "Bayesian information criterion with the effective number of data"),
            _r("probability", "", "among the listed causes"),
            _r("severity", "see mechanism", "estimate"),
            _r("severity_sd", "see mechanism", "standard deviation"),
            *_with_bounds("gain", "", "share of the removable held-out error; limits where each cause was asked alone"),
            _r("held_out_error", "", "root mean square error on data that were left out, in units of the noise"),
            _r("explained", "", "share of the plain model's misfit that it explains alone"),
            _t("form", "form of the mechanism that does best, where it has several"),
            _t("equation", "what it does"),
        ),
        ("specimen_id", "mechanism", "form"),
    ),
    Table(
        "diagnosis_parameters",
        "how far the extension moves the parameters of the film",
        (
            _SPECIMEN,
            _t("parameter", "k0, k1, ... springs; tau1, ... relaxation times; c_inf a pure dashpot"),
            _t("unit", "of the values"),
            *_with_sd("plain", "see unit", "in the plain model of all recordings of the specimen"),
            *_with_sd("extended", "see unit", "in the extended model"),
            _r("moved_sd", "", "|extended - plain| over extended_sd"),
        ),
        ("specimen_id", "parameter"),
    ),
    Table(
        "diagnosis_blocks",
        "residuals of the plain and of the extended model, block by block",
        (
            _SPECIMEN,
            _RECORDING,
            _t("kind", "what was compared: <protocol>.<what>"),
            _t("block", "sweep, cycles, edges: place within the recording"),
            _n("position", "order within the recording"),
            _n("feature_count", "numbers in the block"),
            _r("plain_rms", "SD of the noise", "root mean square residual of the plain model"),
            _r("extended_rms", "SD of the noise", "the same of the extended model; NULL where there is none"),
        ),
        ("specimen_id", "recording_id", "position"),
    ),
    Table(
        "diagnosis_curves",
        "the most telling blocks: measured, and simulated by the plain and by the extended model",
        (
            _SPECIMEN,
            _RECORDING,
            _t("kind", "what was compared: <protocol>.<what>"),
            _t("block", "sweep, cycles, edges: place within the recording"),
            _n("position", "order within the block"),
            _t("component", "real or imaginary; empty for real quantities"),
            _r("frequency_hz", "Hz", "of the value; NULL where it has none"),
            _r("amplitude", "", "strain amplitude of the driven end"),
            _r("voltage_kv", "kV", "largest voltage, or that of the plateau"),
            _r("cycle", "", "cycle, sweep or period, mean of the group, from 1"),
            _r("time_s", "s", "since the start of the recording"),
            _r("measured", "see kind", "N/mm for responses to displacement, N/kV^2 to voltage, N for forces, pF, kV/V"),
            _r("plain", "see kind", "simulated by the plain model"),
            _r("extended", "see kind", "simulated by the extended model; NULL where there is none"),
            _r("sd", "see kind", "standard deviation of the noise of measured"),
        ),
        ("specimen_id", "recording_id", "kind", "block", "position"),
    ),
    Table(
        "calibrations",
        "what the calibrations of a rig gave",
        (
            _RECORDING,
            _t(
                "quantity",
                "clamp_frequency_hz, damping_ratio, force_gain or force_offset_n; with a further mass on the clamp loaded_clamp_frequency_hz, loaded_damping_ratio",
            ),
            _t("unit", "unit of value"),
            _r(
                "value",
                "see unit",
                "the clamp alone: undamped frequency, damping; recorded = gain x true force + offset",
            ),
            _r("sd", "see unit", "standard deviation of value"),
            _n("repeats", "taps or plateaus"),
            _t("warnings", "what limits these numbers"),
        ),
        ("recording_id", "quantity"),
    ),
    Table(
        "history",
        "followed quantities (view quantities) after each run in which they changed; all NULL from then on: gone",
        (
            _t("run_id", "the run"),
            Column("at", TIME, "", "start of the run, UTC"),
            _t("item_kind", "specimen or configuration"),
            _t("item", "which one"),
            _t("quantity", "name of the column it comes from"),
            _t("unit", "unit of value"),
            _r("value", "see unit", "value after the run"),
            _r("sd", "see unit", "its standard deviation; NULL where there is none"),
            _t("words", "the value of quantities in words, such as the verdict"),
        ),
        ("item_kind", "item", "quantity", "run_id"),
    ),
    Table(
        "runs",
        "one row per nightly run",
        (
            _t("run_id", "number of the run, in the order of the runs"),
            Column("started_at", TIME, "", "start, UTC"),
            Column("finished_at", TIME, "", "end, UTC"),
            _t("software_version", "version of dealab"),
            _n("found", "files found"),
            _n("ingested", "recordings and tables taken in"),
            _n("reused", "recordings and tables unchanged since an earlier run"),
            _n("quarantined", "files refused"),
            _n("failed", "items that failed"),
            _n("damaged", "recordings used in part"),
            _n("duplicates", "files with content seen before"),
            _n("pending", "files left for the next run"),
            _n("unmapped", "files without a mapping"),
            _t("notes", "what was passed over, JSON list"),
            _t("settings", "settings in use, JSON"),
            _t("code_version", "hash of the code that analysed"),
        ),
        ("run_id",),
    ),
    Table(
        "items",
        "bookkeeping: what each result was made from (fresh = same input, code and settings)",
        (
            _t(
                "item_id",
                "recording:<sha256 of the file>, specimen:<id>, diagnosis:<id> or group:<name>",
                required=True,
            ),
            _t("stage", "recording, specimen, diagnosis or group"),
            _t("input_hash", "hash of everything it was made from"),
            _t("code_version", "hash of the code of its stage"),
            _t("settings_hash", "hash of the settings of its stage"),
            _t("outcome", "ok, damaged, quarantined, failed, ..."),
            _r("seconds", "s", "time it took"),
            _t("error", "why it failed"),
            _t("notes", "what the data could not carry, and numerical warnings"),
            _t("run_id", "run that made it"),
        ),
        ("item_id",),
        internal=True,
    ),
    Table(
        "files",
        "bookkeeping: raw files as they were last seen, so that only changed ones are read again",
        (
            _t("path", "the file, absolute", required=True),
            _n("size", "bytes"),
            _n("mtime_ns", "time of the last change, ns since 1970"),
            _n("inode", "number of the file in its file system"),
            _t("sha256", "SHA-256 of its content"),
        ),
        ("path",),
        internal=True,
    ),
    Table(
        "carried",
        "bookkeeping: results of a recording that later stages take in full",
        (
            _RECORDING,
            _t("kind", "name of the result's type"),
            _n("position", "order among the recording's results"),
            _t("payload", "the result, JSON with arrays in base64"),
        ),
        ("recording_id", "position"),
        internal=True,
    ),
    Table(
        "lab",
        "bookkeeping: the database itself",
        (
            _t(
                "key",
                "schema: hash of all table and view definitions; row_group: rows that are compressed together",
                required=True,
            ),
            _t("value", "its value"),
        ),
        ("key",),
        internal=True,
    ),
)
TABLES: dict[str, Table] = {t.name: t for t in _ALL}


def reference() -> str:
    """The table reference in Markdown, for the README and `dealab schema`."""
    parts = []
    for table in _ALL:
        parts.append(f"### `{table.name}`\n{table.meaning[0].upper()}{table.meaning[1:]}.\n")
        parts.append("| column | type | unit | meaning |\n|---|---|---|---|")
        parts += [f"| `{c.name}` | {c.type} | {c.unit} | {c.meaning.replace('|', '&#124;')} |" for c in table.columns]
        parts.append("")
    return "\n".join(parts)
