"""SQL over time: what changed from night to night, and control charts of rigs, batches, operators and nights.

Limits of a point are the 99.73 % prediction interval from the other points of its chart (Student's t with their number
less two degrees of freedom), so they hold for few points as well and a point does not widen its own limits. They are
never narrower than the point's own standard deviation asks for. Besides, eight points in a row on one side of the
median are an alarm (one of Western Electric's rules; by chance once in 128 runs of eight).
"""

from __future__ import annotations

FEWEST = 4
"""Points from which a chart has limits: three others give two degrees of freedom."""
ROW = 8
"""Points in a row on one side of the median that are an alarm."""

STUDENT = (
    235.8015, 19.2067, 9.2189, 6.6202, 5.5071, 4.9041, 4.5300, 4.2766, 4.0943, 3.9569,
    3.8499, 3.7643, 3.6942, 3.6358, 3.5864, 3.5441, 3.5075, 3.4755, 3.4472, 3.4222,
    3.3997, 3.3796, 3.3613, 3.3448, 3.3296, 3.3158, 3.3030, 3.2913, 3.2804, 3.2703,
)  # fmt: skip
"""Quantiles of Student's t for 1 to 30 degrees of freedom at the probability that 3 has for the normal distribution."""


def quantile(freedom: str) -> str:
    """SQL for that quantile at any number of degrees of freedom (beyond the table: Abramowitz and Stegun, eq 26.7.5)."""
    listed = ", ".join(map(str, STUDENT))
    return (
        f"CASE WHEN {freedom} <= {len(STUDENT)} THEN [{listed}][{freedom}]"
        f" ELSE 3 + 7.5 / {freedom} + 17.25 / ({freedom} * {freedom}) END"
    )


QUANTITIES = """
WITH best AS (SELECT * FROM best_models),
electrical AS (
    SELECT specimen_id, force_per_voltage_squared_n_per_kv2 AS value, force_per_voltage_squared_n_per_kv2_sd AS sd
    FROM model_fits
    WHERE selected AND coalesce(extension, '') = '' AND force_per_voltage_squared_n_per_kv2 IS NOT NULL
    QUALIFY row_number() OVER (PARTITION BY specimen_id ORDER BY loading, method, model_order) = 1
),
groups AS (
    SELECT *, concat(coalesce(configuration, 'no configuration'), ', ' || voltage_kv || ' kV',
        CASE WHEN count(*) OVER (PARTITION BY configuration, voltage_kv) > 1 THEN ', ' || coalesce(campaign, 'no campaign') END) AS name
    FROM survival_summaries
)
SELECT * FROM (
    SELECT 'specimen' AS item_kind, specimen_id AS item, 'k0_n_per_mm' AS quantity, 'N/mm' AS unit,
        k0_n_per_mm AS value, k0_n_per_mm_sd AS sd, NULL::VARCHAR AS words FROM best
    UNION ALL SELECT 'specimen', specimen_id, 'modulus_mpa', 'MPa', modulus_mpa,
        modulus_mpa * k0_n_per_mm_sd / nullif(k0_n_per_mm, 0), NULL FROM best
    UNION ALL SELECT 'specimen', specimen_id, 'model_order', '', model_order, NULL, NULL FROM best
    UNION ALL SELECT 'specimen', specimen_id, 'load_cell_stiffness_n_per_mm', 'N/mm', load_cell_stiffness_n_per_mm,
        load_cell_stiffness_n_per_mm_sd, NULL FROM best
    UNION ALL SELECT 'specimen', specimen_id, 'clamp_mass_kg', 'kg', clamp_mass_kg, clamp_mass_kg_sd, NULL FROM best
    UNION ALL SELECT 'specimen', specimen_id, 'force_per_voltage_squared_n_per_kv2', 'N/kV²', value, sd, NULL
        FROM electrical
    UNION ALL SELECT 'specimen', specimen_id, 'force_per_capacitive_strain_n', 'N', force_per_capacitive_strain_n,
        force_per_capacitive_strain_n_sd, NULL FROM sensing_fits
    UNION ALL SELECT 'specimen', specimen_id, 'verdict', '', NULL, NULL,
        concat_ws(': ', coalesce(verdict, 'could not be asked'), nullif(array_to_string(mechanisms, ', '), '')) FROM diagnoses
    UNION ALL SELECT 'configuration', name, 'restricted_mean_s', 's', restricted_mean_s,
        (restricted_mean_s_upper - restricted_mean_s_lower) / 3.92, NULL FROM groups
    UNION ALL SELECT 'configuration', name, 'median_s', 's', median_s, (median_s_upper - median_s_lower) / 3.92, NULL
        FROM groups
)
WHERE value IS NOT NULL OR words IS NOT NULL
ORDER BY item_kind, item, quantity"""
"""What is followed from night to night, as it is now."""

REMEMBER = """
INSERT INTO history (run_id, "at", item_kind, item, quantity, unit, value, sd, words)
WITH last AS (SELECT run_id, started_at FROM runs ORDER BY run_id DESC LIMIT 1),
known AS (
    SELECT * FROM history QUALIFY row_number() OVER (PARTITION BY item_kind, item, quantity ORDER BY run_id DESC) = 1
)
SELECT last.run_id, last.started_at, item_kind, item, quantity, coalesce(now.unit, known.unit), now.value, now.sd, now.words
FROM quantities AS now FULL JOIN known USING (item_kind, item, quantity) CROSS JOIN last
WHERE now.value IS DISTINCT FROM known.value OR now.sd IS DISTINCT FROM known.sd OR now.words IS DISTINCT FROM known.words
ORDER BY item_kind, item, quantity"""
"""Writes into `history` what the last run changed."""

MOVED = """
WITH last AS (SELECT run_id, code_version, settings FROM runs ORDER BY run_id DESC LIMIT 1),
earlier AS (
    SELECT code_version, settings FROM runs WHERE run_id < (SELECT run_id FROM last) ORDER BY run_id DESC LIMIT 1
),
before AS (
    SELECT * FROM history WHERE run_id < (SELECT run_id FROM last)
    QUALIFY row_number() OVER (PARTITION BY item_kind, item, quantity ORDER BY run_id DESC) = 1
),
arrived AS (
    SELECT item_kind, item, string_agg(concat(files, ' ', protocol, CASE WHEN status <> 'ok' THEN ' ' || status END), ', '
        ORDER BY protocol, status) AS text
    FROM (
        SELECT item_kind, item, protocol, status, count(*) AS files
        FROM (
            SELECT 'specimen' AS item_kind, specimen_id AS item, protocol, status, run_id FROM recordings
            UNION ALL SELECT 'configuration', configuration, protocol, status, run_id FROM recordings
        )
        WHERE run_id = (SELECT run_id FROM last) AND status IN ('ok', 'damaged', 'excluded')
        GROUP BY ALL
    )
    GROUP BY item_kind, item
)
SELECT now.item_kind, now.item, now.quantity, now.unit, before.value AS before, before.sd AS before_sd,
    before.words AS before_words, now.value AS after, now.sd AS after_sd, now.words AS after_words,
    abs(now.value - before.value) / nullif(sqrt(coalesce(before.sd, 0)**2 + coalesce(now.sd, 0)**2), 0) AS moved_sd,
    CASE WHEN arrived.text IS NOT NULL THEN arrived.text
        WHEN last.code_version IS DISTINCT FROM earlier.code_version THEN 'another version of the code'
        WHEN last.settings IS DISTINCT FROM earlier.settings THEN 'other settings'
        ELSE 'recordings of its rig or its group' END AS because
FROM history AS now
JOIN last ON now.run_id = last.run_id
JOIN before ON (before.item_kind, before.item, before.quantity) = (now.item_kind, now.item, now.quantity)
CROSS JOIN earlier
LEFT JOIN arrived ON arrived.item_kind = now.item_kind
    AND (arrived.item = now.item OR (now.item_kind = 'configuration' AND starts_with(now.item, arrived.item || ',')))
WHERE now.words IS DISTINCT FROM before.words OR (now.value IS NULL) <> (before.value IS NULL)
    OR moved_sd > 2 OR now.sd > 3 * before.sd OR (moved_sd IS NULL AND abs(now.value - before.value) > 0.01 * abs(before.value))
ORDER BY now.quantity <> 'verdict', moved_sd DESC NULLS LAST, now.item_kind DESC, now.item, now.quantity"""

_POINTS = """
WITH places AS (
    SELECT specimen_id, min(started_at) AS "at", arg_max(rig_id, started_at) AS rig_id,
        arg_max(operator, started_at) AS operator, any_value(material ORDER BY started_at) AS material,
        any_value(configuration ORDER BY started_at) AS configuration
    FROM recordings
    WHERE status IN ('ok', 'damaged') AND loading = 'mechanical' AND specimen_id IS NOT NULL
    GROUP BY specimen_id
),
fits AS (
    SELECT f.*, p.* EXCLUDE (specimen_id), concat_ws(', ', p.material, nullif(p.configuration, '')) AS batch,
        f.modulus_mpa * f.k0_n_per_mm_sd / nullif(f.k0_n_per_mm, 0) AS modulus_sd
    FROM best_models AS f JOIN places AS p USING (specimen_id)
),
ratios AS (
    SELECT *, modulus_mpa / median(modulus_mpa) OVER b AS ratio, modulus_sd / median(modulus_mpa) OVER b AS ratio_sd
    FROM fits
    WHERE modulus_mpa > 0
    WINDOW b AS (PARTITION BY batch)
    QUALIFY count(*) OVER b > 1
),
taps AS (
    SELECT c.*, r.rig_id, r.started_at AS "at" FROM calibrations AS c JOIN recordings AS r USING (recording_id)
    WHERE r.status IN ('ok', 'damaged')
),
points AS (
    SELECT 'rig' AS grouped_by, rig_id AS name, 'load_cell_stiffness_n_per_mm' AS quantity, 'N/mm' AS unit,
        'specimen' AS point_kind, specimen_id AS point, "at", load_cell_stiffness_n_per_mm AS value,
        load_cell_stiffness_n_per_mm_sd AS sd, load_cell_stiffness_n_per_mm AS z, load_cell_stiffness_n_per_mm_sd AS z_sd,
        rig_id AS pool
    FROM fits
    UNION ALL SELECT 'rig', rig_id, 'clamp_mass_kg', 'kg', 'specimen', specimen_id, "at", clamp_mass_kg, clamp_mass_kg_sd,
        clamp_mass_kg, clamp_mass_kg_sd, rig_id FROM fits
    UNION ALL SELECT 'rig', rig_id, quantity, unit, 'recording', recording_id, "at", value, sd, value, sd, rig_id FROM taps
    UNION ALL SELECT 'rig', rig_id, 'modulus_over_batch', '', 'specimen', specimen_id, "at", ratio, ratio_sd, ratio, ratio_sd,
        'all' FROM ratios
    UNION ALL SELECT 'operator', operator, 'modulus_over_batch', '', 'specimen', specimen_id, "at", ratio, ratio_sd, ratio,
        ratio_sd, 'all' FROM ratios
    UNION ALL SELECT 'batch', batch, 'modulus_mpa', 'MPa', 'specimen', specimen_id, "at", modulus_mpa, modulus_sd,
        modulus_mpa, modulus_sd, batch FROM fits WHERE batch <> ''
    UNION ALL SELECT 'night', 'all', 'refused_share', '', 'run', run_id, started_at, quarantined / found, NULL,
        asin(sqrt((quarantined + 0.375) / (found + 0.75))), 0.5 / sqrt(found + 0.5), 'all' FROM runs
    WHERE found > coalesce(reused, 0)
)
"""
"""Points of all charts. `z` is what limits are computed in: for shares their arcsine (Anscombe), else the value itself. A night with
nothing new says nothing of its own: it is no point."""

CONTROL_POINTS = f"""{_POINTS},
centred AS (
    SELECT *, avg(z) OVER p AS mean, z - mean AS d, count(*) OVER p AS points, sign(z - median(z) OVER p) AS side
    FROM points WHERE value IS NOT NULL AND name IS NOT NULL
    WINDOW p AS (PARTITION BY grouped_by, quantity, pool)
),
compared AS (
    SELECT *, mean - d / (points - 1) AS others,
        sqrt(greatest(0, sum(d * d) OVER p - d * d - d * d / (points - 1)) / (points - 2)) AS scatter
    FROM centred WHERE points > 2
    WINDOW p AS (PARTITION BY grouped_by, quantity, pool)
    UNION ALL SELECT *, NULL, NULL FROM centred WHERE points <= 2
),
limited AS (
    SELECT *, CASE WHEN points >= {FEWEST} THEN
        {quantile("(points - 2)")} * greatest(scatter, coalesce(z_sd, 0)) * sqrt(1 + 1 / (points - 1)) END AS half,
        abs(sum(side) OVER r) = {ROW} AS in_a_row
    FROM compared
    WINDOW r AS (PARTITION BY grouped_by, name, quantity ORDER BY "at", point ROWS {ROW - 1} PRECEDING)
)
SELECT grouped_by, name, quantity, unit, point_kind, point, "at", value, sd, points,
    CASE quantity WHEN 'refused_share' THEN sin(others)**2 ELSE others END AS expected,
    CASE quantity WHEN 'refused_share' THEN sin(greatest(others - half, 0))**2 ELSE others - half END AS lower,
    CASE quantity WHEN 'refused_share' THEN sin(least(others + half, pi() / 2))**2 ELSE others + half END AS upper,
    CASE WHEN abs(z - others) > half THEN 'beyond its limits'
        WHEN in_a_row THEN 'the last of {ROW} in a row on one side of the median' END AS alarm
FROM limited
ORDER BY grouped_by, name, quantity, "at", point"""

OUT_OF_CONTROL = """
SELECT * FROM control_points WHERE alarm IS NOT NULL ORDER BY "at" DESC, grouped_by, name, quantity, point"""
