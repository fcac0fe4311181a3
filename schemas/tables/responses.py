"""Responses over frequency and their distortions."""

from __future__ import annotations

from schemas.tables.table import RECORDING_ID, SPECIMEN_ID, MadeBy, Table, real, text, truth, whole

TABLES: tuple[Table, ...] = (
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
                "value", "unit of quantity", "change of the output over the height of the step; the load cell included"
            ),
            real("standard_error", "unit of quantity", "its standard error, without what all windows share"),
            truth("usable", "not disturbed by the ringing of the clamp"),
            text("unusable_because", "why usable is false"),
            real("ramp_s", "s", "duration of the ramp"),
            real("step", "input unit", "height of the step"),
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
