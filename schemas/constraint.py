"""SQL of the view `constraint_gains`: what holding the passive part of a self-sensing film rigid adds to its outputs.

A film of one section in series (thesis, eq 5.20 corrected): with the active share l_AR/(l_tot − l_held) of the free length, force and
capacitive strain both grow by l_tot/(l_tot − l_held), not by the factor 3 of the thesis' figure 5-11.
"""

from __future__ import annotations

CONSTRAINT_GAINS = """
WITH measured AS (
    SELECT r.campaign, r.specimen_id, r.material, round(2 * s.voltage_kv) / 2 AS voltage_kv,
        TRY_CAST(r.metadata ->> '$.recording.total_length_mm' AS DOUBLE) AS total_mm,
        TRY_CAST(r.metadata ->> '$.recording.active_length_mm' AS DOUBLE) AS active_mm,
        TRY_CAST(r.metadata ->> '$.recording.sensing_length_mm' AS DOUBLE) AS sensing_mm,
        coalesce(TRY_CAST(r.metadata ->> '$.recording.constrained_length_mm' AS DOUBLE), 0) AS held_mm,
        avg(s.force_step_n) AS force_n, sqrt(sum(s.force_step_sd_n ** 2)) / count(*) AS force_sd_n,
        avg(s.capacitive_strain) AS strain,
        sqrt(sum((s.capacitance_step_sd_pf / s.capacitance_rest_pf) ** 2)) / count(*) AS strain_sd
    FROM step_responses s JOIN recordings r USING (recording_id)
    WHERE s.capacitive_strain > 0 AND s.force_step_n > 0 AND NOT coalesce(s.wrinkled, false)
        AND coalesce(r.metadata ->> '$.recording.controller', 'open') = 'open'
        AND coalesce(r.metadata ->> '$.recording.sensing_region', 'separate') = 'separate'
    GROUP BY ALL
)
SELECT f.campaign, f.specimen_id AS free_specimen, c.specimen_id AS constrained_specimen, f.voltage_kv,
    f.force_n AS free_force_n, c.force_n AS constrained_force_n, c.force_n / f.force_n AS force_gain,
    c.force_n / f.force_n * sqrt((c.force_sd_n / c.force_n) ** 2 + (f.force_sd_n / f.force_n) ** 2) AS force_gain_sd,
    f.strain AS free_capacitive_strain, c.strain AS constrained_capacitive_strain, c.strain / f.strain AS capacitance_gain,
    c.strain / f.strain * sqrt((c.strain_sd / c.strain) ** 2 + (f.strain_sd / f.strain) ** 2) AS capacitance_gain_sd,
    (f.total_mm - f.held_mm) / (c.total_mm - c.held_mm) AS expected_gain
FROM measured f JOIN measured c ON c.campaign IS NOT DISTINCT FROM f.campaign
    AND c.material IS NOT DISTINCT FROM f.material AND c.voltage_kv = f.voltage_kv AND c.total_mm = f.total_mm
    AND c.active_mm = f.active_mm AND c.sensing_mm = f.sensing_mm AND c.held_mm > f.held_mm
ORDER BY f.campaign, free_specimen, constrained_specimen, f.voltage_kv"""
