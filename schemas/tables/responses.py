"""Responses over frequency and their distortions."""

from __future__ import annotations

from schemas.tables.table import RECORDING_ID, SPECIMEN_ID, MadeBy, Table, real, text, truth, whole

_FORM = text(
    "form",
    "recorded (H against a/(c + k/kL)), without_resonance (the clamp's inertia taken out: F_DE/V^2 of the thesis) or"
    " resonance_ignored (H against a model without clamp)",
)
_VOLTAGE = real("voltage_kv", "kV", "peak voltage")

TABLES: tuple[Table, ...] = (
    Table(
        "voltage_orders",
        "models of each order against the force under voltage: a row per recording, order and form",
        (
            SPECIMEN_ID,
            RECORDING_ID,
            _VOLTAGE,
            whole("model_order", "number of arms"),
            _FORM,
            real(
                "magnitude_error_n_per_kv2",
                "N/kV^2",
                "mean | |model| - |measured| | over the usable lines (thesis, eq 4.14)",
            ),
            real("relative_error", "", "root mean square of |model/measured - 1| over the usable lines"),
            real("phase_error_deg", "deg", "mean |arg(model/measured)| over the usable lines (thesis, eq 4.14)"),
            whole("frequency_lines", "usable lines"),
        ),
        key=("specimen_id", "form", "model_order", "voltage_kv", "recording_id"),
        made_by=(MadeBy("specimen"),),
        pages=("specimen",),
    ),
    Table(
        "voltage_curves",
        "force per voltage squared, measured and by the models of each order",
        (
            SPECIMEN_ID,
            RECORDING_ID,
            _VOLTAGE,
            _FORM,
            whole("model_order", "number of arms; NULL: measured"),
            real("frequency_hz", "Hz", "frequency"),
            real("real", "N/kV^2", "real part"),
            real("imag", "N/kV^2", "imaginary part"),
            real("standard_error", "N/kV^2", "standard error, both components together; NULL for a model"),
            truth("usable", "the recording is usable at this line"),
        ),
        key=("specimen_id", "recording_id", "form", "model_order", "frequency_hz"),
        made_by=(MadeBy("specimen"),),
        pages=("specimen",),
    ),
    Table(
        "frequency_responses",
        "response of a recording, or averaged over a specimen's recordings, by frequency",
        (
            text("recording_id", "the recording; NULL for averaged rows", refers_to="recording_id"),
            SPECIMEN_ID,
            text("loading", "mechanical, electrical or other"),
            text("quantity", "stiffness_n_per_mm, force_per_voltage_squared_n_per_kv2, or output_per_input"),
            text(
                "stage",
                "measured, corrected (clamp and load cell taken out) or averaged (corrected, over recordings; of several"
                " temperatures the master curve)",
            ),
            real("frequency_hz", "Hz", "frequency"),
            real("real", "unit of quantity", "real part"),
            real("imag", "unit of quantity", "imaginary part"),
            real("magnitude", "unit of quantity", "magnitude"),
            real("phase_deg", "deg", "phase; a delayed output has negative phase"),
            real("standard_error", "unit of quantity", "square root of E|dH|^2, both components together"),
            real("coherence", "", "magnitude-squared coherence; NULL where one sweep cannot give it"),
            real("amplification", "", "factor from relative noise of the measured to that of the corrected response"),
            truth("usable", "amplification at most 5 and enough excitation and coherence"),
            text("unusable_because", "why usable is false"),
            real("amplitude", "input unit", "amplitude of the input, where one is defined (strain for cyclic tests)"),
            real(
                "between_spread",
                "unit of quantity",
                "averaged rows: standard deviation between recordings beyond noise",
            ),
        ),
        key=("specimen_id", "recording_id", "quantity", "stage", "frequency_hz"),
        made_by=(
            MadeBy("recording", where="stage = 'measured'"),
            MadeBy("specimen", where="stage <> 'measured'"),
        ),
        pages=("index", "campaign", "specimen", "recording"),
        result_where="usable",
    ),
    Table(
        "relaxation_curves",
        "response to a step that is held: the change of the output over the step, as means over windows of time",
        (
            RECORDING_ID,
            SPECIMEN_ID,
            text("quantity", "stiffness_n_per_mm, or output_per_input for a system of another kind"),
            real("time_s", "s", "time since the ramp of the step began, mean of the window"),
            real(
                "value",
                "unit of quantity",
                "change of the output since before the first step over its height; the load cell included",
            ),
            real("standard_error", "unit of quantity", "its standard error, without what all windows share"),
            truth("usable", "not disturbed by the ringing of the clamp"),
            text("unusable_because", "why usable is false"),
            real("ramp_s", "s", "duration of the ramp, of a staircase of its first one"),
            real("step", "input unit", "height of the step, of a staircase of its first one"),
            whole("step_number", "number of the step that the window belongs to, from 1; more than one in a staircase"),
        ),
        key=("recording_id", "time_s"),
        made_by=(MadeBy("recording"),),
        pages=("specimen", "recording"),
        result_where="usable",
    ),
    Table(
        "distortions",
        "harmonics and lines that a linear system would leave empty",
        (
            RECORDING_ID,
            real("frequency_hz", "Hz", "frequency of the line"),
            text("kind", "even, odd or noise"),
            real("level", "see unit", "amplitude at that line"),
            text("unit", "unit of level"),
            whole("harmonic", "order of the harmonic for cyclic tests"),
        ),
        key=("recording_id", "kind", "frequency_hz"),
        made_by=(MadeBy("recording"),),
        pages=("specimen", "recording"),
    ),
)
