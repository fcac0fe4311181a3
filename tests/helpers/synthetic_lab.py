"""A lab's database without a lab: rows written straight into the tables, for tests of the pages.

The numbers are those of a plausible campaign and come from closed forms written here; nothing of the analysis is used but
for the regressions of lives.
"""

from __future__ import annotations

import json
from collections import defaultdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import duckdb
import numpy as np

from pipeline.analyse.survival import analyse_survival
from schemas.control import REMEMBER
from schemas.lifetimes import LifetimeRow
from schemas.tables import TABLES
from tests.helpers.empty_database import copy_empty_database

Rows = dict[str, list[dict[str, Any]]]

EVENING = datetime(2026, 11, 20, 18, 0, tzinfo=UTC)
HOSTILE_SPECIMEN = "<script>alert(1)</script>\"'../../etc/passwd"
HOSTILE_CAMPAIGN = "</style><img src=x onerror=alert(1)> \u202egnp.exe"
HOSTILE_NOTE = "</pre><script>alert('note')</script> javascript:alert(1) " + "long note " * 1000
POLYACRYLATE = (1.0, (1.5, 2.0, 30.0), (0.05, 0.02, 0.02))
SILICONE = (0.29, (0.30,), (1.4e-4,))
STACK = (0.40, (0.40, 1.00, 50.0), (1.00, 0.10, 0.05))
MASS_KG, CELL, DAMPING = 0.1874, 20.0, 6.1e-4
EARLIER, LAST = "000001", "000002"


def film(model: tuple[float, tuple[float, ...], tuple[float, ...]], f: np.ndarray) -> np.ndarray:
    """Stiffness of springs and dampers in N/mm: each arm is a spring in series with a damper."""
    w = 2j * np.pi * f
    k0, springs, dampers = model
    return k0 + sum(1 / (1 / k + 1 / (w * c)) for k, c in zip(springs, dampers, strict=True))


def cell(f: np.ndarray) -> np.ndarray:
    """Dynamic stiffness of load cell and clamp in N/mm."""
    w = 2 * np.pi * f
    return CELL - 1e-3 * MASS_KG * w**2 + 1j * w * DAMPING


class Story:
    """Rows for all tables, added piece by piece."""

    def __init__(self, seed: int = 11) -> None:
        self.rows: Rows = defaultdict(list)
        self.random = np.random.default_rng(seed)
        self.clock = EVENING - timedelta(days=2)

    def recording(
        self, recording_id: str | None, specimen: str | None, protocol: str, loading: str, **more: Any
    ) -> None:
        self.clock += timedelta(minutes=7)
        key = recording_id or f"file{len(self.rows['recordings'])}"
        metadata = {
            "film_length_mm": "50.0", "film_width_mm": "50.0", "film_thickness_mm": "1.0", "stretch_1": "1.4",
            "active_length_mm": "40.0", "active_width_mm": "40.0", "active_drawn": "stretched", "relative_permittivity": "4.7",
        }  # fmt: skip
        metadata |= more.pop("keys", {})
        row = {
            "recording_id": recording_id, "campaign": "film-dynamics", "specimen_id": specimen, "material": "VHB 4910",
            "configuration": "single layer", "protocol": protocol, "loading": loading, "rig_id": "shaker",
            "operator": "A. Mills", "started_at": self.clock, "duration_s": 61.2, "sample_count": 120_000,
            "source_path": f"/data/2026-11-20/{key}.mcap", "source_sha256": f"{abs(hash_of(key)):064x}"[:64],
            "samples_path": f"samples/protocol={protocol}/month=2026-11/{key}.parquet", "status": "ok",
            "kind": "recording", "software_version": "0.1.0", "run_id": LAST, "source_present": True,
            "metadata": json.dumps(
                {"recording": metadata, "rig": {"clamp_mass_kg": "0.1874", "load_cell_stiffness_n_per_mm": "20.0"}}
            ),
        }  # fmt: skip
        self.rows["recordings"].append(row | more)

    def preview(self, recording_id: str, duration: float = 60.0, points: int = 400, gap: bool = False) -> None:
        t = np.linspace(0, duration, points)
        sweep = np.sin(2 * np.pi * 0.3 * t * (1 + t / 12))
        for quantity, size in (("displacement", 0.2), ("force", 0.4)):
            keep = (t < 0.4 * duration) | (t > 0.5 * duration) if gap else np.ones(points, bool)
            for x, y in zip(t[keep], size * sweep[keep], strict=True):
                self.rows["previews"].append(
                    {"recording_id": recording_id, "quantity": quantity, "time_s": x, "low": y - 0.05, "high": y + 0.05}
                )

    def responses(
        self, specimen: str, model: Any, recordings: list[str], *, noise: float = 0.006, wrong: float = 0.0
    ) -> None:
        f = np.geomspace(1, 100, 60)
        k = film(model, f)
        raw = k * CELL / (k + cell(f)) * (1 + wrong * np.exp(-(np.log(f / 60) ** 2) / 0.05))
        amplification = np.abs(1 + k / cell(f))
        total = np.zeros(f.size, complex)
        for recording in recordings:
            sd = noise * np.abs(raw) * (1 + f / 60)
            scatter = self.random.normal(size=(2, f.size)) @ np.eye(f.size)
            measured = raw + sd / np.sqrt(2) * (scatter[0] + 1j * scatter[1])
            a = 1 - 1e-3 * MASS_KG * (2 * np.pi * f) ** 2 / CELL + 2j * np.pi * f * DAMPING / CELL
            corrected = a * measured / (1 - measured / CELL)
            se = sd / np.abs(raw) * amplification * np.abs(corrected)
            for stage, value, error in (("measured", measured, sd), ("corrected", corrected, se)):
                self._lines(
                    recording, specimen, "mechanical", "stiffness_n_per_mm", stage, f, value, error, amplification
                )
            total += corrected / len(recordings)
        self._lines(
            None,
            specimen,
            "mechanical",
            "stiffness_n_per_mm",
            "averaged",
            f,
            total,
            se / np.sqrt(len(recordings)),
            amplification,
        )

    def electrical(self, specimen: str, model: Any, recordings: dict[str, float]) -> None:
        f = np.arange(1.0, 100.0, 2.0)
        k = film(model, f)
        force = 2.0e-3
        for recording, kv in recordings.items():
            h = force * CELL / (k + cell(f))
            sd = np.full(f.size, 4e-5 * 7 / kv)
            noise = self.random.normal(size=(2, f.size))
            measured = h + sd / np.sqrt(2) * (noise[0] + 1j * noise[1])
            blocked = measured * (cell(f) + k) / CELL
            amplification = np.abs((cell(f) + k) / CELL)
            name = "force_per_voltage_squared_n_per_kv2"
            self._lines(recording, specimen, "electrical", name, "measured", f, measured, sd, amplification)
            self._lines(
                recording, specimen, "electrical", name, "corrected", f, blocked, sd * amplification, amplification
            )
            for kind, level in (("even", 3e-5), ("odd", 1e-5), ("noise", 1e-5)):
                for i, x in enumerate(np.arange(2.0, 100.0, 4.0)):
                    strength = level * self.random.lognormal(0, 0.4) * (6 if kind == "even" and i < 4 else 1)
                    self.rows["distortions"].append(
                        {"recording_id": recording, "frequency_hz": x, "kind": kind, "level": strength, "unit": "N"}
                    )

    def _lines(
        self,
        recording: str | None,
        specimen: str,
        loading: str,
        quantity: str,
        stage: str,
        f: Any,
        value: Any,
        error: Any,
        amplification: Any,
    ) -> None:
        for i in range(f.size):
            usable = bool(amplification[i] <= 5) or stage == "measured"
            self.rows["frequency_responses"].append(
                {
                    "recording_id": recording, "specimen_id": specimen, "loading": loading, "quantity": quantity, "stage": stage,
                    "frequency_hz": f[i], "real": value[i].real, "imag": value[i].imag, "magnitude": abs(value[i]),
                    "phase_deg": np.degrees(np.angle(value[i])), "standard_error": error[i], "coherence": 0.999,
                    "amplification": amplification[i] if stage != "measured" else None, "usable": usable,
                    "unusable_because": None if usable else "correction amplifies the noise",
                }
            )  # fmt: skip

    def fits(
        self,
        specimen: str,
        model: Any,
        *,
        chi2: float = 1.02,
        order: int | None = None,
        extension: str = "",
        low: float = 1.0,
        high: float = 100.0,
        positivity: float = 0.98,
    ) -> None:
        k0, springs, dampers = model
        chosen = order or len(springs)
        for n in (1, 2, 3, 4):
            row: dict[str, Any] = {
                "specimen_id": specimen, "loading": "mechanical", "method": "forward", "model_order": n, "extension": extension,
                "k0_n_per_mm": k0 * (1 + 0.1 * (n < chosen)), "k0_n_per_mm_sd": 0.0009 * k0, "selected": n == chosen,
                "frequency_lines": 62, "frequency_low_hz": low, "frequency_high_hz": high, "positivity_chi2": positivity,
                "reduced_chi2": chi2 * (1 if n >= chosen else 4.2 * 95 ** (chosen - n - 1)),
                "bic": 1200.0 + (10 * (n - chosen) if n >= chosen else 2144 * 126 ** (chosen - n - 1)),
                "order_p_value": None if n == 4 else (0.48 if n >= chosen else 0.001),
                "magnitude_error_n_per_mm": 0.02 * (1 if n >= chosen else 6.0 ** (chosen - n)),
                "phase_error_deg": 0.25 * (1 if n >= chosen else 3.7 ** (chosen - n)), "held_out_error": 1.09 * (1 if n >= chosen else 5.0 ** (chosen - n)),
                "clamp_mass_kg": 0.1874, "clamp_mass_kg_sd": 0.0004, "load_cell_stiffness_n_per_mm": 20.0, "load_cell_stiffness_n_per_mm_sd": 0.06,
                "load_cell_damping_n_s_per_mm": DAMPING, "load_cell_damping_n_s_per_mm_sd": 4e-5, "modulus_mpa": 0.4 * k0,
                "warnings": "" if n <= chosen else f"arm {n} at the lower bound of the relaxation times",
            }  # fmt: skip
            for i in range(min(n, len(springs))):
                j = i if n >= len(springs) else i + len(springs) - n
                row |= {
                    f"k{i + 1}_n_per_mm": springs[j] * (1.6 if n < chosen else 1),
                    f"k{i + 1}_n_per_mm_sd": 0.02 * springs[j],
                }
                row |= {f"c{i + 1}_n_s_per_mm": dampers[j], f"c{i + 1}_n_s_per_mm_sd": 0.01 * dampers[j]}
            if n > len(springs):
                row |= {f"c{n}_n_s_per_mm": 1e-4}
            arms = range(1, min(n, len(springs)) + 1)
            names = ["log k0", *(f"log k{i}" for i in arms), *(f"log tau{i}" for i in arms)]
            row["covariance"] = json.dumps(
                {"names": names, "matrix": np.diag([1e-6] + [4e-4] * (len(names) - 1)).tolist()}
            )
            self.rows["model_fits"].append(row)

    def steps(self, specimen: str, recording: str, *, wrinkles_from: float = 99.0) -> None:
        voltages = (3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
        t = np.linspace(0, 20 * len(voltages) + 4, 1900)
        traces = {q: np.zeros(t.size) for q in ("voltage", "force", "capacitance")}
        traces["force"] += 0.45
        traces["capacitance"] += 28.6
        for i, kv in enumerate(voltages):
            start = 4 + 20 * i
            wrinkled = kv >= wrinkles_from
            force, cap = 0.69e-3 * kv**2, 0.0039 * kv**2 * (0.8 if wrinkled else 1)
            since = np.clip(t - start, 0, None)
            rise, fall = 1 - 0.1 * np.exp(-since / 0.8), 0.1 * np.exp(-np.clip(since - 10, 0, None) / 0.8)
            on = (t >= start) & (t < start + 10)
            after = (t >= start + 10) & (t < start + 20)
            traces["voltage"] += kv * on
            traces["force"] -= force * (rise * on + fall * after)
            traces["capacitance"] -= cap * (
                (1 - 0.5 * np.exp(-since / 1.5)) * on + 0.5 * np.exp(-np.clip(since - 10, 0, None) / 1.5) * after
            )
            self.rows["step_responses"].append(
                {
                    "recording_id": recording, "cycle": i + 1, "voltage_kv": kv, "force_step_n": force * (1 + 0.01 * self.random.normal()),
                    "capacitance_step_pf": -cap * (1 + 0.01 * self.random.normal()), "capacitive_strain": cap / 28.6, "force_instant_fraction": 0.9,
                    "capacitance_instant_fraction": 0.5, "rise_time_s": 0.09, "overshoot_percent": 0.0, "settling_time_s": 0.7,
                    "recovery_time_s": None if wrinkled else 0.8, "wrinkled": wrinkled, "start_s": float(start), "end_s": float(start + 10),
                }
            )  # fmt: skip
        spread = {"voltage": 0.004, "force": 0.002, "capacitance": 0.004}
        for quantity, y in traces.items():
            for x, v in zip(t, y, strict=True):
                self.rows["previews"].append(
                    {
                        "recording_id": recording,
                        "quantity": quantity,
                        "time_s": x,
                        "low": v - spread[quantity],
                        "high": v + spread[quantity],
                    }
                )

    def lifetimes(
        self,
        campaign: str,
        configuration: str,
        lives: list[float],
        *,
        end: float = 240.0,
        site: str = "rod",
        kv: float = 7.5,
    ) -> None:
        regions = ("left", "centre", "centre", "right", "left")
        order = sorted(lives)
        for i, life in enumerate(order):
            name = f"L-{configuration.replace(', ', '-').replace(' ', '')}-{kv:g}kV-{i + 1:02d}"
            failed = life < end
            self.recording(
                name, name, "lifetime", "electrical", campaign=campaign, configuration=configuration, rig_id="life", duration_s=min(life, end) + 3,
                keys={"voltage_setpoint_kv": str(kv), "test_duration_s": str(end)},
            )  # fmt: skip
            t = np.linspace(0, min(life, end) + 3, 240)
            on = (t > 1) & (t < 1 + min(life, end))
            for x, v in zip(t, kv * on, strict=True):
                self.rows["previews"].append(
                    {"recording_id": name, "quantity": "voltage", "time_s": x, "low": v - 0.01, "high": v + 0.01}
                )
            self.rows["lifetimes"].append(
                {
                    "recording_id": name, "specimen_id": name, "configuration": configuration, "campaign": campaign, "voltage_kv": kv,
                    "lifetime_s": min(life, end), "failed": failed, "censored_because": None if failed else "end of test", "glitches": int(i == 2),
                    "failure_site": site if failed else "none", "failure_region": regions[i % 5] if failed else None,
                }
            )  # fmt: skip
        self._survival(configuration, kv, np.minimum(order, end), np.array(order) < end, end, campaign)

    def _survival(
        self, configuration: str, kv: float, time: np.ndarray, failed: np.ndarray, end: float, campaign: str
    ) -> None:
        survival, variance, mean, previous, median = 1.0, 0.0, 0.0, 0.0, None
        for t in np.unique(time):
            at_risk, died = int((time >= t).sum()), int(((time == t) & failed).sum())
            mean += survival * (t - previous)
            previous = t
            survival *= 1 - died / at_risk
            variance += died / (at_risk * (at_risk - died)) if at_risk > died else np.inf
            low = high = None
            if 0 < survival < 1:
                width = 1.96 * np.sqrt(variance) / abs(np.log(survival))
                low, high = survival ** np.exp(width), survival ** np.exp(-width)
            if median is None and survival <= 0.5:
                median = t
            self.rows["survival_curves"].append(
                {
                    "campaign": campaign, "configuration": configuration, "voltage_kv": kv, "time_s": t, "at_risk": at_risk, "failures": died,
                    "censored": int(((time == t) & ~failed).sum()), "survival": survival, "lower_95": low, "upper_95": high,
                }
            )  # fmt: skip
        mean += survival * (end - previous)
        died, shape = int(failed.sum()), None
        if died:
            shape = 1.2 / np.std(np.log(time[failed]))
        bounds = {
            "restricted_mean_s": (mean, mean * 0.85, mean * 1.15),
            "median_s": (median, median and median * 0.7, median and median * 1.3),
        }
        bounds |= {
            "survival_at_end": (survival, 0.69 if survival == 1 else survival * 0.4, min(1.0, survival * 1.7 + 0.1))
        }
        if shape:
            bounds |= {
                "weibull_shape": (shape, shape * 0.7, shape * 1.3),
                "weibull_scale_s": (mean * 1.1, mean * 0.9, mean * 1.4),
            }
        row = {
            "configuration": configuration,
            "voltage_kv": kv,
            "specimens": time.size,
            "failures": died,
            "restricted_to_s": end,
            "campaign": campaign,
        }
        for key, values in bounds.items():
            row |= dict(zip((key, f"{key}_lower", f"{key}_upper"), values, strict=True))
        self.rows["survival_summaries"].append(row | {"warnings": "" if died else "no failure: no law can be fitted"})

    def run(self, run_id: str = LAST, **more: Any) -> None:
        start = EVENING + timedelta(hours=9) if run_id == LAST else EVENING - timedelta(hours=15)
        self.rows["runs"].append(
            {
                "run_id": run_id, "started_at": start, "finished_at": start + timedelta(minutes=23, seconds=8), "software_version": "0.1.0",
                "found": len(self.rows["recordings"]), "ingested": 40, "reused": 12, "quarantined": 3, "failed": 0, "damaged": 2, "duplicates": 1,
                "pending": 1, "unmapped": 2, "notes": json.dumps(["/data/readme.txt: without a mapping"]),
                "settings": json.dumps({"orders": [1, 2, 3, 4], "seed": 7}), "code_version": "9f3c1e2ab4",
            } | more
        )  # fmt: skip

    def write(self, lab: Path) -> Path:
        """LAB/results.duckdb with these rows."""
        lab.mkdir(parents=True, exist_ok=True)
        path = lab / "results.duckdb"
        path.unlink(missing_ok=True)
        copy_empty_database(path)
        with duckdb.connect(str(path)) as connection:
            for name, table in TABLES.items():
                if self.rows.get(name):
                    arrow = table.rows(self.rows[name])  # noqa: F841 - DuckDB finds it by name
                    order = ", ".join(f'"{c}"' for c in table.key)
                    connection.execute(f"INSERT INTO {name} SELECT * FROM arrow ORDER BY {order}")
            connection.execute(REMEMBER)
            connection.execute("CHECKPOINT")
        return lab


def hash_of(text: str) -> int:
    """A number that stands in for a file's hash."""
    return int.from_bytes(text.encode()[:24].ljust(24, b"x"), "big") * 0x9E3779B97F4A7C15


def named(story: Story) -> None:
    """P-07: the load cell is stiffer than its file says."""
    story.rows["diagnoses"].append(
        {
            "specimen_id": "P-07", "verdict": "named", "mechanism": "rig_constants", "mechanisms": ["rig_constants"], "also_possible": [],
            "p_value": 0.001, "severity": json.dumps({"rig_constants": {"stiffness_error": {"value": 0.063, "sd": 0.003}}}),
            "supported_by": ["chirp", "sphs"], "held_out_error_before": 2.85, "held_out_error_after": 1.04, "gain": 0.97, "gain_lower": 0.93,
            "gain_upper": 0.99, "next_recording": "SPHS, odd lines, 1 to 100 Hz, with 20.0 g added to the clamp.",
            "smallest_detectable": json.dumps({"rig_constants": {"stiffness_error": 0.012}, "sensor_delay": {"delay_s": 26e-6}, "drive_lag": {"rise_time_constant_s": 5e-5}}),
            "invisible": ["electrode_degradation", "thermal_softening"], "could_not_ask": ["No temperature was recorded <i>."],
            "held_out_parts": json.dumps({"chirp": {"before": 3.8, "after": 1.2}, "sphs": {"before": 2.5, "after": 1.0}}),
            "recordings": 12, "feature_count": 672, "chi2": 1917.0, "chi2_extended": 669.0, "next_separation": 40.0,
        }
    )  # fmt: skip
    compared(story)
    for mechanism, ratio, severity, sd, gain in (
        ("rig_constants", 1248.0, 0.063, 0.003, 0.97), ("sensor_delay", 726.0, 8.7e-5, 5e-6, 0.58), ("load_cell_damping", 395.0, 0.0, None, 0.32),
        ("frequency_dependent_permittivity", 130.0, 0.0134, 0.0012, 0.10), ("missing_relaxation", 15.0, 0.05, 0.04, 0.01), ("amplitude_softening", 0.2, 0.0, 0.002, 0.0),
    ):  # fmt: skip
        story.rows["diagnosis_candidates"].append(
            {"specimen_id": "P-07", "mechanism": mechanism, "likelihood_ratio": ratio, "bic": -ratio, "probability": 1.0 if ratio > 1000 else 1e-9, "severity": severity, "severity_sd": sd, "gain": gain}
        )  # fmt: skip
    for recording in ("P-07_chirp-1", "P-07_chirp-2", "P-07_chirp-3", "P-07_sphs-1", "P-07_sphs-2"):
        for i, band in enumerate(
            ("1-2 Hz", "2-5 Hz", "5-10 Hz", "10-20 Hz", "20-35 Hz", "35-55 Hz", "55-75 Hz", "75-100 Hz")
        ):
            rms = 1 + 0.15 * story.random.normal() + (0, 0, 0, 0, 0.6, 2.0, 2.9, 1.0)[i]
            wrong = rms > 1.6
            story.rows["discrepancies"].append(
                {
                    "specimen_id": "P-07", "recording_id": recording, "where_found": band, "chi2": 18 * rms**2, "degrees_of_freedom": 18.0,
                    "p_value": 0.001 if wrong else 0.4, "statement": f"the simulation is too low by {rms:.1f} SD from {band}" if wrong else None,
                }
            )  # fmt: skip


def compared(story: Story) -> None:
    """What P-07's diagnosis compared: sweeps that err at the resonance, cycles that do not, and how the film moved."""
    f = np.geomspace(1.0, 100.0, 37)
    k = film(POLYACRYLATE, f)
    off = k * (1 + 0.03 * np.exp(-((np.log(f / 55)) ** 2) / 0.1))
    for recording, kind, size in (("P-07_chirp-1", "chirp.response", 37), ("P-07_chirp-2", "chirp.response", 37), ("P-07_cyclic-0.1", "cyclic.response", 1)):  # fmt: skip
        rms = 3.1 if size > 1 else 1.1
        story.rows["diagnosis_blocks"].append(
            {"specimen_id": "P-07", "recording_id": recording, "kind": kind, "block": "sweep 1", "position": 0, "feature_count": 2 * size, "plain_rms": rms, "extended_rms": 1.0}
        )  # fmt: skip
        sd = 0.004 * np.abs(k[:size])
        noise = sd * (story.random.normal(size=size) + 1j * story.random.normal(size=size))
        parts = {"measured": off[:size] + noise, "plain": k[:size], "extended": off[:size]}
        for part, component in enumerate(("real", "imaginary")):
            story.rows["diagnosis_curves"] += [
                {
                    "specimen_id": "P-07", "recording_id": recording, "kind": kind, "block": "sweep 1", "position": part * size + i,
                    "component": component, "frequency_hz": f[i], "amplitude": 0.01, "cycle": 1.0, "time_s": float(i), "sd": sd[i],
                    **{name: (v[i].imag if part else v[i].real) for name, v in parts.items()},
                }
                for i in range(size)
            ]  # fmt: skip
    for parameter, unit, plain, extended, sd in (("k0", "N/mm", 1.003, 1.0, 0.001), ("k1", "N/mm", 27.1, 29.9, 0.2), ("tau1", "s", 0.03, 0.02, 0.05)):  # fmt: skip
        story.rows["diagnosis_parameters"].append(
            {"specimen_id": "P-07", "parameter": parameter, "unit": unit, "plain": plain, "plain_sd": sd, "extended": extended, "extended_sd": sd, "moved_sd": abs(plain - extended) / sd}
        )  # fmt: skip


def whole_story() -> Story:
    """A night with findings of every kind, refused, damaged, duplicate, excluded and hostile recordings."""
    story = Story()
    for specimen, model, material in (
        ("P-05", POLYACRYLATE, "VHB 4910"), ("P-06", POLYACRYLATE, "VHB 4910"), ("P-07", POLYACRYLATE, "VHB 4910"), ("P-11", POLYACRYLATE, "VHB 4910"),
        ("S-02", SILICONE, "silicone"), ("S-03", SILICONE, "silicone"), ("G-03", POLYACRYLATE, "acrylic, lot 3"),
    ):  # fmt: skip
        chirps = [f"{specimen}_chirp-{i}" for i in (1, 2, 3)]
        for i, name in enumerate(chirps):
            problem = "no end of file; last chunk cut at 83.2 s of 120 s" if name == "P-06_chirp-2" else None
            story.recording(
                name,
                specimen,
                "chirp",
                "mechanical",
                material=material,
                status="damaged" if problem else "ok",
                problem=problem,
            )
            story.preview(name, gap=i == 1)
        wrong = {"P-07": 0.05, "P-11": 0.03, "G-03": 0.08}.get(specimen, 0.0)
        story.responses(specimen, model, chirps, wrong=wrong)
        story.fits(specimen, model, chi2=2.85 if wrong else 1.02)
    drives = {"P-07_sphs-1": 3.0, "P-07_sphs-2": 5.0, "P-07_sphs-3": 7.0}
    for name, kv in drives.items():
        story.recording(name, "P-07", "sphs", "electrical", keys={"drive_kv": str(kv)})
    story.electrical("P-07", POLYACRYLATE, drives)
    story.fits("P-07", POLYACRYLATE, chi2=1.0, extension="rig_constants")
    for row in story.rows["model_fits"]:
        if row["extension"]:
            row |= {
                "load_cell_stiffness_n_per_mm": 21.27,
                "k3_n_per_mm": (row.get("k3_n_per_mm") or 30.0) * 1.02,
                "selected": False,
            }
    story.rows["predictions"] += [
        {"specimen_id": "P-07", "fitted_on": "mechanical", "predicted": "electrical", "magnitude_error": 3.1e-5, "phase_error_deg": 1.2, "relative_error": 0.034},
        {"specimen_id": "P-07", "fitted_on": "mechanical, amplitude 1", "predicted": "mechanical, amplitude 3", "magnitude_error": 0.021, "phase_error_deg": 0.3, "relative_error": 0.006},
    ]  # fmt: skip
    story.recording("P-07_step", "P-07", "step", "electrical", duration_s=124.0)
    story.steps("P-07", "P-07_step", wrinkles_from=7.0)
    story.rows["sensing_fits"].append(
        {"specimen_id": "P-07", "force_per_capacitive_strain_n": 5.03, "force_per_capacitive_strain_n_sd": 0.06, "r_squared": 0.9981, "modulus_mpa": 0.151, "modulus_mpa_sd": 0.002, "sensitivity": -0.36, "sensitivity_sd": 0.01, "predicted_sensitivity": -0.364, "drift_pf_per_hour": -0.2, "drift_pf_per_hour_sd": 0.03, "wrinkling_onset_kv": 6.7, "wrinkling_onset_kv_lower": 6.4, "wrinkling_onset_kv_upper": 7.0, "warnings": ""}
    )  # fmt: skip
    for specimen, verdict in (
        ("P-05", "none"),
        ("P-06", "none"),
        ("S-02", "none"),
        ("S-03", "none"),
        ("P-11", "ambiguous"),
        ("G-03", "unknown"),
    ):
        row = {
            "specimen_id": specimen,
            "verdict": verdict,
            "p_value": 0.42 if verdict == "none" else 2e-4,
            "mechanisms": [],
            "also_possible": [],
        }
        row["smallest_detectable"] = json.dumps({"rig_constants": {"stiffness_error": 0.009}})
        if verdict == "ambiguous":
            row |= {
                "mechanism": "slack",
                "mechanisms": ["slack"],
                "also_possible": ["strain_stiffening"],
                "next_recording": "Cyclic, 0.5 Hz, 20 % strain, pre-stretch raised from 1.10 to 1.25.",
                "severity": json.dumps({"slack": {"onset": {"value": 0.12, "sd": 0.03}}}),
            }
        story.rows["diagnoses"].append(row)
    named(story)
    f = np.array([0.01, 0.1, 0.5, 1.0, 5.0])
    for i, x in enumerate(f):
        name = f"K-01_cyclic-{i}"
        story.recording(
            name,
            "K-01",
            "cyclic",
            "mechanical",
            material="VHB 4910 stack",
            configuration="stack of ten",
            rig_id="hydraulic",
            keys={"layers": "10", "frequency_hz": str(x)},
        )
        k = film(STACK, np.array([x]))
        for stage in ("measured", "corrected"):
            story._lines(
                name,
                "K-01",
                "mechanical",
                "stiffness_n_per_mm",
                stage,
                np.array([x]),
                k * (1 + 0.004 * story.random.normal()),
                0.006 * np.abs(k),
                np.array([1.01]),
            )
    story.fits("K-01", STACK, low=0.01, high=5.0)
    lives = story.random.weibull(1.5, 20) * 44
    story.lifetimes("RP-DEA lifetime", "single AR", np.round(lives, 1).tolist())
    story.lifetimes(
        "RP-DEA lifetime", "separate ARs", np.round(226 * story.random.weibull(7, 20), 1).tolist(), site="lead"
    )
    story.lifetimes("RP-DEA lifetime", "separate ARs, lead outside", [500.0] * 10)
    for a, b, p in (
        ("separate ARs", "single AR", 1.0e-11),
        ("separate ARs", "separate ARs, lead outside", 3.6e-4),
        ("separate ARs, lead outside", "single AR", 1.08e-5),
    ):
        story.rows["survival_comparisons"].append(
            {
                "campaign": "RP-DEA lifetime",
                "configuration_a": a,
                "configuration_b": b,
                "voltage_kv": 7.5,
                "test": "log-rank, exact permutation",
                "statistic": 12.7,
                "p_value": p,
                "p_value_holm": 3 * p,
            }
        )
        story.rows["survival_comparisons"].append(
            {
                "campaign": "RP-DEA lifetime",
                "configuration_a": a,
                "configuration_b": b,
                "voltage_kv": 7.5,
                "test": "fisher exact",
                "statistic": None,
                "p_value": 4 * p,
                "p_value_holm": 12 * p,
            }
        )
    for region, share, found in (("left", 0.31, 8), ("centre", 0.42, 8), ("right", 0.27, 4)):
        story.rows["weak_regions"].append(
            {
                "campaign": "RP-DEA lifetime", "configuration": "single AR", "region": region, "predicted_share": share, "predicted_share_lower": share - 0.03,
                "predicted_share_upper": share + 0.04, "observed_share": found / 20, "observed_share_lower": found / 40,
                "observed_share_upper": found / 20 + 0.24, "failures": found,
                "unknown_site": 0, "other_failures": 2,
            }
        )  # fmt: skip
    film_maps(story)
    voltages(story)
    conditions(story)
    for direction in (1, 2):
        for stretch in np.arange(1.5, 3.05, 0.25):
            predicted = 2.0e-3 * 49 * stretch ** (2 if direction == 1 else 1)
            story.rows["force_maps"].append(
                {
                    "specimen_id": "F-01",
                    "configuration": "single layer",
                    "stretch_1": 1.2,
                    "stretch_2": stretch,
                    "direction": direction,
                    "force_n": predicted * 0.9,
                    "force_sd_n": 0.01,
                    "repeats": 5,
                    "predicted_n": predicted,
                    "relative_permittivity": 2.6,
                    "relative_permittivity_sd": 0.1,
                    "voltage_kv": 7.0,
                }
            )
    story.recording("F-01_map", "F-01", "force_map", "electrical", campaign="force map", configuration="single layer")
    story.recording(
        "hostile-1",
        HOSTILE_SPECIMEN,
        "chirp",
        "mechanical",
        campaign=HOSTILE_CAMPAIGN,
        material="<b>film</b>",
        operator="javascript:alert(1)",
        notes=HOSTILE_NOTE,
        keys={"notes": HOSTILE_NOTE, 'x"><script>': "'; DROP TABLE recordings; --"},
    )
    story.preview("hostile-1")
    story.responses(HOSTILE_SPECIMEN, POLYACRYLATE, ["hostile-1"])
    story.fits(HOSTILE_SPECIMEN, POLYACRYLATE)
    story.recording("P-11_chirp-9", "P-11", "chirp", "mechanical", status="excluded")
    story.rows["annotations"].append(
        {
            "recording_id": "P-11_chirp-9",
            "action": "exclude",
            "why": "clamp not tightened",
            "author": "A. Mills",
            "at": EVENING,
        }
    )
    story.rows["items"].append(
        {
            "item_id": "specimen:P-06", "stage": "specimen", "outcome": "failed", "seconds": 2.0, "run_id": LAST,
            "error": "models: the fit did not converge\nTraceback (most recent call last)",
        }
    )  # fmt: skip
    refused(story)
    earlier_nights(story)
    story.run(EARLIER, found=12, quarantined=0)
    story.run()
    return story


def earlier_nights(story: Story) -> None:
    """What the night before had found, and a clamp that was tapped before every session and came loose in the last."""
    at = {"run_id": EARLIER, "at": EVENING - timedelta(hours=15)}
    story.rows["history"] += [
        {**at, "item_kind": "specimen", "item": "P-07", "quantity": "k0_n_per_mm", "unit": "N/mm", "value": 0.981, "sd": 0.0031},
        {**at, "item_kind": "specimen", "item": "P-07", "quantity": "model_order", "unit": "", "value": 2.0},
        {**at, "item_kind": "specimen", "item": "P-07", "quantity": "verdict", "unit": "", "words": "none"},
        {**at, "item_kind": "configuration", "item": "single AR, 7.5 kV", "quantity": "median_s", "unit": "s", "value": 80.0, "sd": 4.0},
    ]  # fmt: skip
    for i in range(12):
        tap = f"shaker_tap-{i + 1}"
        story.recording(tap, "shaker-clamp", "tap", "calibration", duration_s=13.0, material=None, configuration=None)
        story.preview(tap, duration=13.0)
        story.rows["calibrations"] += [
            {"recording_id": tap, "quantity": "clamp_frequency_hz", "unit": "Hz", "value": 52.0 + 0.05 * story.random.normal() - (1.1 if i == 11 else 0), "sd": 0.03, "repeats": 3},
            {"recording_id": tap, "quantity": "damping_ratio", "unit": "", "value": 0.005 + 1e-4 * story.random.normal(), "sd": 8e-5, "repeats": 3},
        ]  # fmt: skip


def film_maps(story: Story) -> None:
    """Thickness over three rods, with one electrode or with separate ones."""
    for configuration in ("single AR", "separate ARs"):
        story.rows["electrode_layouts"].append(
            {
                "campaign": "RP-DEA lifetime", "configuration": configuration, "scheme": "continuous", "thickness_limit": 0.9, "thin_share": 0.41, "thinnest": 0.74,
                "predicted_rod_share": 0.8, "observed_rod_share": 0.95, "peak_field_mv_per_m": 34.2,
            }
        )  # fmt: skip
        for x in np.linspace(-19.5, 19.5, 40):
            for y in np.linspace(-19.5, 19.5, 40):
                rod = min(abs(y - r) for r in (-10, 0, 10))
                active = abs(x) < 15 and abs(y) < 15 and (configuration == "single AR" or rod > 2)
                thickness = 1 - 0.2 * np.exp(-(rod**2) / 6) - 0.05 * np.cos(x / 14)
                story.rows["film_maps"].append(
                    {
                        "campaign": "RP-DEA lifetime", "configuration": configuration, "scheme": "continuous", "x_mm": x, "y_mm": y, "thickness": 0.28 * thickness,
                        "relative_thickness": thickness, "active": active,
                    }
                )  # fmt: skip


def voltages(story: Story) -> None:
    """Lives at four voltages, with a power law that fails at the lowest, and causes that compete."""
    laws = {5.0: 9086.3, 7.0: 114.06, 10.0: 24.222, 15.0: 5.1935}
    for kv, scale in laws.items():
        story.lifetimes(
            "PET film",
            "PET film",
            np.round(scale * story.random.weibull(4.0, 8), 2).tolist(),
            end=9104.25,
            kv=kv,
            site="active",
        )
        law = 3.2e8 * kv**-6.88
        story.rows["voltage_residuals"].append(
            {
                "campaign": "PET film", "configuration": "PET film", "voltage_kv": kv, "specimens": 8, "failures": 8, "scale_s": scale, "law_scale_s": law,
                "residual": np.log(scale / law), "standardised_residual": 4 * np.log(scale / law), "p_value_without": 0.3 if kv == 5 else 1e-9,
            }
        )  # fmt: skip
    story.rows["voltage_life"].append(
        {
            "campaign": "PET film", "configuration": "PET film", "specimens": 32, "failures": 32, "intercept": 19.64, "intercept_lower": 17.9, "intercept_upper": 21.3,
            "exponent": -6.88, "exponent_lower": -7.6, "exponent_upper": -6.1, "sigma": 0.88, "sigma_lower": 0.7, "sigma_upper": 1.1,
            "log_likelihood": -240.183, "p_value": 2e-12, "holds": False, "statement": "the law fails at 5 kV: lives are longer there", "warnings": "",
        }
    )  # fmt: skip
    story.rows["failure_causes"].append(
        {"campaign": "RP-DEA lifetime", "configuration": "single AR", "voltage_kv": 7.5, "failure_site": "rod", "time_s": 60.0, "failures": 20, "probability": 1.0, "standard_error": 0.0, "lower_95": 0.83, "upper_95": None}
    )  # fmt: skip
    story.rows["lifetime_distributions"].append(
        {"campaign": "RP-DEA lifetime", "configuration": "single AR", "voltage_kv": 7.5, "distribution": "weibull", "parameter": "shape", "value": 1.57, "lower_95": 1.1, "upper_95": 2.2, "log_likelihood": -90.0, "aic": 184.0, "distance": 0.1, "p_value": 0.6, "statement": "describes the lives"}
    )  # fmt: skip


def conditions(story: Story) -> None:
    """Lives over voltage, temperature and electrode, inspected in part, with modes that compete and rows left out.

    The rows of the results are the pipeline's own: what belongs together in so many tables is too much to be made up.
    """
    story.recording("endurance", None, "lifetime", "electrical", campaign="Endurance", configuration=None)
    random = np.random.default_rng(37)
    rows = []
    for voltage in (4.0, 5.0, 6.0):
        for electrode, celsius in (("carbon grease", 23.0), ("silver", 23.0), ("carbon grease", 60.0)):
            for k in range(8):
                name = f"D-{voltage:g}-{electrode[:2]}-{celsius:g}-{k}"
                film = 16 - 6 * np.log(voltage) + 0.9 * (electrode == "silver") - 0.5 * (celsius > 50)
                lead = 10.6 - 1.5 * np.log(voltage) + 0.6 * np.log(random.exponential())
                life = min(film + 0.5 * np.log(random.exponential()), lead)
                failed = bool(life < np.log(2400))
                mode = ("lead" if life == lead else "film") if failed else None
                row = {
                    "specimen_id": name, "configuration": "patch", "campaign": "Endurance", "voltage_kv": voltage, "lifetime_s": float(min(np.exp(life), 2400)),
                    "failed": failed, "failure_mode": mode, "electrode": electrode, "temperature_c": celsius,
                }  # fmt: skip
                rows.append(LifetimeRow(**row))
                story.rows["lifetimes"].append({**row, "recording_id": None})
    rows.append(
        LifetimeRow(
            specimen_id="D-left-out",
            lifetime_s=-3.0,
            failed=True,
            configuration="patch",
            campaign="Endurance",
            voltage_kv=9.0,
        )
    )
    for name, table in analyse_survival(rows).joined().items():
        story.rows[name] += table.to_pylist()


def refused(story: Story) -> None:
    """What did not come in."""
    for name, problem in (
        ("sphs_P-11_b", 'channel voltage: unit is "mA", a current; expected a voltage. Correct the channel\'s unit on the rig and copy the file again'),
        ("step_S-04_01", "force is constant (0.000 N) for the whole 60 s. Check the connector of the load cell"),
        ("x<img src=x onerror=alert(2)>", 'recording_id is "../../x"; expected 1 to 80 of A-Z a-z 0-9 . _ -'),
    ):  # fmt: skip
        story.recording(
            None,
            None,
            "sphs",
            "electrical",
            source_path=f"/data/2026-11-20/{name}.mcap",
            status="quarantined",
            problem=problem,
            campaign=None,
            material=None,
        )
    story.recording(
        "P-05_chirp-1",
        "P-05",
        "chirp",
        "mechanical",
        source_path="/data/copy/chirp_P-05_copy.mcap",
        status="duplicate",
        problem="same bytes as P-05_chirp-1",
    )
    story.recording(
        None,
        None,
        "chirp",
        "mechanical",
        source_path="/data/2026-11-20/growing.mcap",
        status="pending",
        problem="still growing",
    )


def small_story() -> Story:
    """One specimen with two sweeps, and three lives."""
    story = Story()
    for name in ("A-1_chirp-1", "A-1_chirp-2"):
        story.recording(name, "A-1", "chirp", "mechanical")
        story.preview(name)
    story.responses("A-1", POLYACRYLATE, ["A-1_chirp-1", "A-1_chirp-2"])
    story.fits("A-1", POLYACRYLATE)
    story.lifetimes("lives", "single AR", [12.0, 31.0, 500.0])
    story.run()
    return story


def only_refused() -> Story:
    """A night in which nothing could be used."""
    story = Story()
    refused(story)
    story.rows["recordings"] = [r for r in story.rows["recordings"] if r["status"] == "quarantined"]
    story.run(found=3, ingested=0, reused=0, damaged=0, duplicates=0, pending=0, unmapped=0, notes=None)
    return story


def many(count: int, points: int = 2000) -> Story:
    """A campaign of `count` recordings, ten to a specimen, previews as long as they may be."""
    story = Story()
    for i in range(count):
        specimen = f"M-{i // 10:03d}"
        name = f"{specimen}_chirp-{i % 10}"
        story.recording(name, specimen, "chirp", "mechanical")
        if i % 10 == 9:
            story.responses(specimen, POLYACRYLATE, [f"{specimen}_chirp-{j}" for j in range(10)])
            story.fits(specimen, POLYACRYLATE)
    t = np.linspace(0, 60, points // 2)
    for row in story.rows["recordings"]:
        for quantity in ("displacement", "force"):
            y = np.sin(0.3 * t * (1 + t / 12))
            story.rows["previews"] += [
                {
                    "recording_id": row["recording_id"],
                    "quantity": quantity,
                    "time_s": a,
                    "low": b - 0.05,
                    "high": b + 0.05,
                }
                for a, b in zip(t.tolist(), y.tolist(), strict=True)
            ]
    story.run()
    return story
