"""The whole nightly: its own cost per recording, nights with nothing or one thing new, memory, growth, two workers.

The recordings are small (a lifetime test of 60 samples), so that what the night does besides the numerical work shows:
the numerical work is what each recording's item says it took (`items.seconds`: reading, checking, samples, analysis).
Nights run in a process of their own. The report's pages are left out where it says so: they are work, not overhead.
The demonstration campaign shows what real recordings cost, in seconds and bytes.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from ingest.mcap_writer import RecordingWriter
from schemas.numbers import digits

TITLE = "Nightly: overhead, growth and workers"
_TURNS = 3
SIZES = tuple(int(n) for n in os.environ.get("DEALAB_BENCH_SIZES", "100,1000,10000").split(","))
ROOT = Path(__file__).resolve().parents[2]
_START = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)
_RATE_HZ = 20.0
_NIGHT = """
import json, sys, time
import pipeline.nightly.night
from pipeline import Lab
from tests.helpers.machine import peak_mb
if sys.argv[4] == "no pages":
    pipeline.nightly.night._write_report = lambda *_: None
begin, used = time.monotonic(), time.process_time()
summary = pipeline.nightly.night.nightly([sys.argv[1]], Lab(sys.argv[2]), jobs=int(sys.argv[3]))
print(json.dumps({
    "seconds": time.monotonic() - begin,
    "parent_s": time.process_time() - used,
    "peak_mb": peak_mb(),
    "exit": summary.exit_status,
    "analysed": summary.analysed,
}))
"""


def recording(path: Path, number: int) -> None:
    """A lifetime test of 3 s at 20 Hz; one in three breaks down."""
    t = np.arange(60) / _RATE_HZ
    voltage = np.where((t > 0.3) & (t < 2.5), 7500.0, 0.0)
    if number % 3 == 0:
        voltage[t > 0.8 + 0.001 * (number % 1000)] = 0.0
    voltage += np.random.default_rng(number).normal(0, 3.0, t.size)
    started = _START + timedelta(minutes=number)
    metadata = {
        "recording_id": f"B-{number:06d}",
        "protocol": "lifetime",
        "loading": "electrical",
        "specimen_id": f"S-{number:06d}",
        "configuration": "AB"[number % 2],
        "started_at": started.isoformat(),
        "voltage_setpoint_kv": 7.5,
        "test_duration_s": 2.2,
    }
    with RecordingWriter(path, metadata) as writer:
        writer.add_channel("voltage", "V")
        writer.append("voltage", int(started.timestamp() * 1e9), 1 / _RATE_HZ, voltage)


def campaign(raw: Path, numbers: Sequence[int]) -> None:
    """Recordings in folders of a thousand, as old as if they had been made yesterday."""
    old = time.time() - 86_400
    for number in numbers:
        folder = raw / f"{number // 1000:03d}"
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"B-{number:06d}.mcap"
        recording(path, number)
        os.utime(path, (old, old))


def night(raw: Path, lab: Path, jobs: int, *, pages: bool = False, expected: int = 0) -> dict[str, Any]:
    """One nightly in a process of its own: seconds, peak memory of the parent, what was done."""
    command = [sys.executable, "-c", _NIGHT, str(raw), str(lab), str(jobs), "pages" if pages else "no pages"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"the nightly failed: {done.stderr[-2000:]}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    if found["exit"] != expected:
        raise RuntimeError(f"the nightly ended with {found['exit']}")
    return found


def held(folder: Path) -> int:
    """Bytes of all files in a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def numerical_s(lab: Path) -> float:
    """Processor seconds that the items themselves took, as they say."""
    import duckdb

    with duckdb.connect(str(lab / "results.duckdb"), read_only=True) as connection:
        (total,) = connection.execute("SELECT sum(seconds) FROM items").fetchone() or (0.0,)
    return float(total)


def run(sizes: Sequence[int] = SIZES) -> list[dict[str, Any]]:
    """Rows for each size, then the fitted exponents of growth."""
    rows: list[dict[str, Any]] = []
    seconds, memory, overheads = [], [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for size in sizes:
            raw, lab = folder / f"raw-{size}", folder / f"lab-{size}"
            campaign(raw, range(size))
            first = night(raw, lab, jobs=1)
            work = numerical_s(lab)
            overhead = 1e3 * (first["seconds"] - work) / size
            seconds.append(first["seconds"])
            memory.append(first["peak_mb"])
            each = {"raw_bytes": held(raw) / size, "lab_bytes": held(lab) / size, "work_s": work / size}
            overheads.append(overhead)
            rows.append(
                {
                    "name": f"{size} recordings, first night, 1 worker",
                    "seconds": first["seconds"],
                    "note": f"{overhead:.2f} ms overhead and {1e3 * work / size:.2f} ms work each; "
                    f"parent's peak {first['peak_mb']:.0f} MB",
                    "measured": {"recordings": size, "overhead_s": overhead / 1e3, "peak_mb": first["peak_mb"], **each},
                }
            )
            pages = night(raw, lab, jobs=1, pages=True)
            rows.append(
                _row(f"{size} recordings, all pages of the report", pages, f"{held(lab) / size:.0f} B in the lab each")
            )
            rows[-1]["measured"] = {"recordings": size, "seconds": pages["seconds"], "lab_bytes": held(lab) / size}
            both = night(raw, folder / f"two-{size}", jobs=2)
            again, one = [], []
            for turn in range(_TURNS):
                again.append(night(raw, lab, jobs=1, pages=True))
                campaign(raw, [size + turn])
                one.append(night(raw, lab, jobs=1, pages=True))
            for what, found, note in (
                ("nothing new", again, "database and index published with the run's row"),
                ("one new", one, "survival, database and pages made again"),
            ):
                middle = sorted(found, key=lambda n: n["seconds"])[_TURNS // 2]
                rows.append(_row(f"{size} recordings, {what}", middle, f"{note}; median of {digits(_TURNS, 'night')}"))
                rows[-1]["measured"] = {"recordings": size, **{k: middle[k] for k in ("seconds", "peak_mb")}}
            rows.append(
                {
                    "name": f"{size} recordings, first night, 2 workers",
                    "seconds": both["seconds"],
                    "ratio": first["seconds"] / both["seconds"],
                    "note": "ratio: how much faster than 1 worker",
                    "measured": {"recordings": size, "speedup": first["seconds"] / both["seconds"]},
                }
            )
        rows += demonstration(folder)
    if len(sizes) > 1:
        for what, values in (("time", seconds), ("memory of the parent", memory)):
            exponent = np.polyfit([math.log(n) for n in sizes], [math.log(v) for v in values], 1)[0]
            rows.append(
                {
                    "name": f"growth of {what} with the number of recordings",
                    "ratio": float(exponent),
                    "note": "exponent",
                }
            )
    return rows


def demonstration(folder: Path) -> list[dict[str, Any]]:
    """The thesis campaign's recordings: all of a first night, pages included, with one worker and with two, in turn; medians."""
    raw = folder / "thesis"
    command = [sys.executable, "-m", "pipeline.cli", "simulate", "thesis", "--out", str(raw)]
    subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    count = sum(1 for path in raw.rglob("*") if path.is_file() and path.suffix != ".toml")
    seconds: dict[int, list[float]] = {1: [], 2: []}
    work: dict[int, list[float]] = {1: [], 2: []}
    for number in range(_TURNS):
        for jobs in (1, 2):
            lab = folder / f"thesis-{jobs}-{number}"
            seconds[jobs].append(night(raw, lab, jobs, pages=True, expected=3)["seconds"])
            work[jobs].append(numerical_s(lab))
    speedups, limits = _ratios(seconds[1], seconds[2]), [2 * r for r in _ratios(work[1], work[2])]
    measured = {
        "recordings": count,
        "seconds": float(np.median(seconds[1])),
        "work_s": float(np.median(work[1])) / count,
        "raw_bytes": held(raw) / count,
        "lab_bytes": held(folder / "thesis-1-0") / count,
        "speedup": float(np.median(speedups)),
    }
    return [
        {
            "name": f"demonstration campaign, {count} files, first night with report, 1 worker",
            "seconds": measured["seconds"],
            "note": f"{1e3 * measured['work_s']:.0f} ms work, {measured['raw_bytes'] / 1e3:.0f} kB raw and "
            f"{measured['lab_bytes'] / 1e3:.0f} kB in the lab each",
            "measured": measured,
        },
        {
            "name": "the same, 2 workers",
            "seconds": float(np.median(seconds[2])),
            "ratio": measured["speedup"],
            "note": f"ratio: how much faster than 1 worker ({min(speedups):.2f} to {max(speedups):.2f} in {digits(_TURNS, 'turn')}); "
            f"its items alone would be {np.median(limits):.2f} times faster on the two cores of this machine",
        },
    ]


def _ratios(one: Sequence[float], other: Sequence[float]) -> list[float]:
    return [a / b for a, b in zip(one, other, strict=True)]


def _row(name: str, found: dict[str, Any], note: str) -> dict[str, Any]:
    return {"name": name, "seconds": found["seconds"], "note": f"{note}; {found['analysed']} results made"}
