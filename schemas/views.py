"""SQL views and macros of `results.duckdb`: the questions people ask, answered once, each with an example.

Does not belong here: tables (`schemas.tables`).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from schemas import control
from schemas.constraint import CONSTRAINT_GAINS
from schemas.tables import TABLES

WHY_NO_MODEL = "regexp_extract(coalesce(notes, ''), '(^|; )models: (.*?)(; expected |$)', 2)"
"""What the models of a specimen lacked, from the notes of its item; an empty text where nothing is said."""


@dataclass(frozen=True)
class View:
    """A view, or a table macro when it has parameters."""

    name: str
    meaning: str
    sql: str
    parameters: tuple[str, ...] = ()

    def ddl(self) -> str:
        """CREATE and COMMENT statements."""
        quoted = self.meaning.replace("'", "''")
        if self.parameters:
            return (
                f"CREATE OR REPLACE MACRO {self.name}({', '.join(self.parameters)}) AS TABLE {self.sql};\n"
                f"COMMENT ON MACRO TABLE {self.name} IS '{quoted}';"
            )
        return f"CREATE OR REPLACE VIEW {self.name} AS {self.sql};\nCOMMENT ON VIEW {self.name} IS '{quoted}';"


VIEWS: tuple[View, ...] = (
    View(
        "best_models",
        "one row per specimen: the fit to use (the chosen order, fitted forward where possible, mechanical first)",
        """
SELECT * FROM model_fits
WHERE selected
QUALIFY row_number() OVER (
    PARTITION BY specimen_id
    ORDER BY coalesce(extension, '') <> '', method = 'forward' DESC,
        CASE loading WHEN 'mechanical' THEN 0 WHEN 'joint' THEN 1 ELSE 2 END, model_order, extension
) = 1
ORDER BY specimen_id""",
    ),
    View(
        "survival_at",
        "survival of each campaign's configurations and voltages at a time in s; NULL beyond the end of their follow-up, and"
        " within an interval of inspection in which the curve falls",
        """
SELECT configuration, voltage_kv, at_s::DOUBLE AS time_s,
    CASE WHEN falling OR (at_s > last_s AND final > 0) THEN NULL ELSE coalesce(last_value.survival, 1.0) END AS survival,
    CASE WHEN falling OR at_s > last_s THEN NULL ELSE last_value.lower_95 END AS lower_95,
    CASE WHEN falling OR at_s > last_s THEN NULL ELSE last_value.upper_95 END AS upper_95, campaign
FROM (
    SELECT campaign, configuration, voltage_kv, max(time_s) AS last_s, min(survival) AS final,
        coalesce(bool_or(from_s < at_s AND at_s < time_s), false) AS falling,
        max_by({'survival': survival, 'lower_95': lower_95, 'upper_95': upper_95}, time_s)
            FILTER (WHERE time_s <= at_s) AS last_value
    FROM survival_curves
    GROUP BY campaign, configuration, voltage_kv
)
ORDER BY campaign, configuration, voltage_kv""",
        ("at_s",),
    ),
    View(
        "life_model",
        "the chosen life regression of each campaign: its coefficients with 95 % limits, beside those of Cox's model",
        """
SELECT c.campaign, r.family, r.stress_law, c.coefficient, c.value, c.value_lower, c.value_upper, c.p_value,
    -x.value * r.sigma AS value_by_cox, r.p_value AS p_value_of_the_laws, r.failures, r.specimens
FROM life_coefficients c
JOIN life_regressions r ON r.campaign IS NOT DISTINCT FROM c.campaign AND r.family = c.family
    AND r.stress_law IS NOT DISTINCT FROM c.stress_law
LEFT JOIN life_coefficients x ON x.campaign IS NOT DISTINCT FROM c.campaign AND x.family = 'cox'
    AND x.coefficient = c.coefficient
WHERE r.chosen
ORDER BY c.campaign, c.coefficient = 'intercept' DESC, c.coefficient""",
    ),
    View(
        "needs_attention",
        "recordings that were refused, are damaged, are waiting or led to no result, analyses that failed, specimens without"
        " a model, and rigs without constants that recordings need, with the reason",
        f"""
SELECT 'recording' AS what, recording_id AS name, status, problem, source_path, source_present, run_id
FROM recordings
WHERE status IN ('quarantined', 'damaged', 'pending') OR (problem IS NOT NULL AND status <> 'duplicate')
UNION ALL
SELECT stage, item_id, outcome, split_part(error, chr(10), 1), NULL, NULL, run_id
FROM items
WHERE outcome = 'failed'
UNION ALL
SELECT 'recording', recording_id, 'without result', what_was_missing, source_path, NULL, NULL
FROM without_result
WHERE status <> 'quarantined'
UNION ALL
SELECT 'specimen', specimen_id, 'without model', concat('no model: ', {WHY_NO_MODEL}), NULL, NULL, run_id
FROM items JOIN (
    SELECT DISTINCT specimen_id FROM recordings
    WHERE recording_id NOT IN (SELECT recording_id FROM without_result WHERE recording_id IS NOT NULL)
        AND specimen_id NOT IN (SELECT specimen_id FROM model_fits WHERE specimen_id IS NOT NULL)
        AND status IN ('ok', 'damaged')
) ON item_id = concat('specimen:', specimen_id)
WHERE outcome <> 'failed' AND {WHY_NO_MODEL} <> ''
UNION ALL
SELECT 'rig', rig_id, 'without constants', format(
    'rig file rigs/{{0}}.toml is not there or gives no load_cell_stiffness_n_per_mm: no resonance correction of {{1}} of its'
    ' recordings; expected below the folder given to the nightly, beside them or above. Write it, or give its folder with'
    ' --rigs', rig_id, count(*)), NULL, NULL, NULL
FROM recordings JOIN assumptions USING (recording_id)
WHERE kind = 'recording' AND status IN ('ok', 'damaged') AND rig_id IS NOT NULL AND what = 'clamp and load cell'
GROUP BY rig_id
ORDER BY ALL""",
    ),
    View(
        "tonight",
        "what came in, or changed, in the last run",
        """
SELECT recording_id, specimen_id, campaign, protocol, status, problem, source_path
FROM recordings
WHERE run_id = (SELECT max(run_id) FROM runs)
ORDER BY started_at, recording_id, source_path""",
    ),
    View(
        "nights",
        "each run against the one before it",
        """
SELECT run_id, started_at, round(epoch(finished_at - started_at), 3) AS seconds, found, ingested, reused,
    quarantined, damaged, failed,
    found - lag(found) OVER by_number AS more_found,
    quarantined - lag(quarantined) OVER by_number AS more_quarantined,
    CASE WHEN lag(run_id) OVER by_number IS NOT NULL THEN code_version IS DISTINCT FROM lag(code_version) OVER by_number
        END AS code_changed
FROM runs
WINDOW by_number AS (ORDER BY run_id)
ORDER BY run_id DESC""",
    ),
    View(
        "specimens",
        "one row per specimen: what it is and what was measured on it",
        """
SELECT specimen_id, any_value(campaign) AS campaign, any_value(material) AS material,
    any_value(configuration) AS configuration, count(*) AS recordings,
    count(*) FILTER (WHERE status = 'damaged') AS damaged, count(*) FILTER (WHERE status = 'excluded') AS excluded,
    list_sort(list(DISTINCT protocol)) AS protocols, min(started_at) AS first_started_at,
    max(started_at) AS last_started_at
FROM recordings
WHERE specimen_id IS NOT NULL AND status IN ('ok', 'damaged', 'excluded')
GROUP BY specimen_id
ORDER BY specimen_id""",
    ),
    View(
        "exclusions",
        "recordings that are out of the analysis now: who took them out, when and why",
        """
SELECT recording_id, why, author, "at"
FROM (SELECT * FROM annotations QUALIFY row_number() OVER (PARTITION BY recording_id ORDER BY "at" DESC) = 1)
WHERE action = 'exclude'
ORDER BY "at"
""",
    ),
    View(
        "verdicts",
        "how many specimens were diagnosed with which verdict; without one: nothing could be asked",
        """
SELECT verdict, count(*) AS specimens, list(specimen_id ORDER BY specimen_id) AS names
FROM (SELECT specimen_id, coalesce(verdict, 'could not be asked') AS verdict FROM diagnoses)
GROUP BY verdict
ORDER BY list_position(['named', 'ambiguous', 'unknown', 'none', 'could not be asked'], verdict)""",
    ),
    View(
        "causes",
        "diagnoses with what mending them gains, the largest gain first",
        """
SELECT specimen_id, verdict, mechanism, mechanisms, also_possible, round(100 * gain, 1) AS gain_percent,
    round(100 * gain_lower, 1) AS gain_percent_lower, round(100 * gain_upper, 1) AS gain_percent_upper,
    held_out_error_before, held_out_error_after, next_recording
FROM diagnoses
ORDER BY gain DESC NULLS LAST, specimen_id""",
    ),
    View(
        "constraint_gains",
        "force and capacitive strain of a self-sensing film whose passive part is held rigid over those of a free one of the same"
        " sizes, by voltage; ± one standard deviation of the steps, differences between specimens not counted",
        CONSTRAINT_GAINS,
    ),
    View("quantities", "what is followed from night to night, as it is now", control.QUANTITIES),
    View(
        "moved",
        "what the last run moved by more than twice the uncertainty, or made three times as uncertain, changed verdicts first, and why",
        control.MOVED,
    ),
    View(
        "control_points",
        "control charts of rigs, batches, operators and nights: each point with its limits, 99.73 % prediction from the"
        " others of its chart; NULL with fewer than four points",
        control.CONTROL_POINTS,
    ),
    View("out_of_control", "points of the control charts that leave their limits", control.OUT_OF_CONTROL),
)

EXAMPLES: tuple[tuple[str, str], ...] = (
    ("Which order was chosen for each specimen?", "SELECT specimen_id, model_order, warnings FROM best_models"),
    (
        "Which relaxation times has each film, and what stays?",
        "SELECT specimen_id, k0_n_per_mm, k1_n_per_mm, c1_n_s_per_mm / k1_n_per_mm AS tau1_s, k2_n_per_mm,"
        " c2_n_s_per_mm / k2_n_per_mm AS tau2_s FROM best_models",
    ),
    (
        "What does a load-unload cycle take?",
        "SELECT recording_id, cycle, loss_mj, steady_loss_mj, steady_loss_kj_per_m3, secant_n_per_mm FROM cycle_loops",
    ),
    (
        "How are the temperatures of a master curve shifted, and by which law?",
        "SELECT specimen_id, temperature_c, log10_a, log10_a_lower, log10_a_upper FROM shift_factors ORDER BY ALL",
    ),
    (
        "Which constants has that law?",
        "SELECT specimen_id, law, reference_c, c1, c1_lower, c1_upper, c2_k, c2_k_lower, c2_k_upper, energy_kj_per_mol"
        " FROM shift_laws WHERE selected",
    ),
    (
        "How much force does a voltage give near 1 Hz?",
        "SELECT recording_id, frequency_hz, 1000 * magnitude AS mn_per_kv2, phase_deg FROM frequency_responses"
        " WHERE quantity = 'force_per_voltage_squared_n_per_kv2' AND stage = 'measured' AND frequency_hz BETWEEN 0.8 AND 1.2",
    ),
    (
        "How much force does a film give per squared voltage, driven slowly?",
        "SELECT recording_id, drop_n_per_kv2, drop_n_per_kv2_lower, drop_n_per_kv2_upper, exponent FROM voltage_cycles",
    ),
    ("How many live longer than 60 s, per configuration?", "SELECT * FROM survival_at(60)"),
    (
        "How long do films live at each voltage?",
        "SELECT configuration, voltage_kv, specimens, failures, median_s, weibull_shape, weibull_scale_s"
        " FROM survival_summaries",
    ),
    (
        "With which power of the voltage do lives fall?",
        "SELECT configuration, exponent, exponent_lower, exponent_upper, holds, statement FROM voltage_life",
    ),
    (
        "What was refused, and why?",
        "SELECT source_path, problem FROM recordings WHERE status = 'quarantined'",
    ),
    ("Which recordings led to no result, and what was missing?", "SELECT * FROM without_result"),
    ("What needs attention?", "SELECT what, name, status, problem FROM needs_attention"),
    ("What does holding the passive part of a sensing film add?", "SELECT * FROM constraint_gains"),
    (
        "How would designed controllers settle, and how far would the force overshoot, beside the thesis' gains?",
        "SELECT specimen_id, goal, controller, settling_time_s, force_overshoot_percent FROM controller_designs",
    ),
    (
        "Which electrodes would live longer at the same force, and by how much?",
        "SELECT configuration, design, life_ratio, life_ratio_lower, life_ratio_upper FROM electrode_designs",
    ),
    ("What came in last night?", "SELECT * FROM tonight"),
    ("Was last night like the night before?", "SELECT * FROM nights LIMIT 2"),
    (
        "Which results did last night move?",
        "SELECT * EXCLUDE (before_words, after_words) FROM moved WHERE moved_sd > 2",
    ),
    (
        "Does a rig, a batch or an operator leave its limits?",
        "SELECT grouped_by, name, quantity, point, value, lower, upper, alarm FROM out_of_control",
    ),
    (
        "How has a rig's load cell been from specimen to specimen?",
        "SELECT point, value, sd, lower, upper FROM control_points"
        " WHERE grouped_by = 'rig' AND quantity = 'load_cell_stiffness_n_per_mm'",
    ),
    ("How many specimens does the simulation get right?", "SELECT verdict, specimens, names FROM verdicts"),
    ("Which cause explains the error, and what does mending it gain?", "SELECT * FROM causes"),
    (
        "Where is the simulation most wrong?",
        "SELECT specimen_id, recording_id, statement FROM discrepancies JOIN diagnoses USING (specimen_id)"
        " WHERE verdict <> 'none' AND discrepancies.p_value < 0.0001"
        " ORDER BY discrepancies.chi2 / degrees_of_freedom DESC LIMIT 10",
    ),
    (
        "How far does ignoring the cause move the film's parameters?",
        "SELECT specimen_id, parameter, plain, extended, unit, moved_sd FROM diagnosis_parameters WHERE moved_sd > 2",
    ),
    (
        "Which life test tells most next?",
        "SELECT campaign, configuration, voltage_kv, duration_s, limits_ratio FROM life_plans WHERE plan = 'next test'",
    ),
    (
        "The raw samples of one recording",
        "SELECT time_ns, force FROM samples('RECORDING_ID') WHERE force IS NOT NULL LIMIT 10",
    ),
    (
        "What does a column mean?",
        "SELECT column_name, comment FROM duckdb_columns() WHERE table_name = 'model_fits'",
    ),
)
"""Questions with the query that answers them, for `dealab sql --examples` and the README."""


def view_reference() -> str:
    """The views and macros in Markdown, for the README and `dealab schema`."""
    rows = [
        f"| `{view.name}{'(' + ', '.join(view.parameters) + ')' if view.parameters else ''}` | {view.meaning} |"
        for view in VIEWS
    ]
    return "\n".join(["### Views\n", "| view | answers |\n|---|---|", *rows, ""])


def fingerprint() -> str:
    """SHA-256 over every table's and view's definition: two databases with the same one hold the same columns."""
    text = "\n".join([table.ddl() for table in TABLES.values()] + [view.ddl() for view in VIEWS])
    return hashlib.sha256(text.encode()).hexdigest()
