"""Nights over more and larger recordings than the tests have, into `scale.md`.

    python -m tests.faults.scale [--only NAME …] [--jobs N]

Each night is a process of its own, which a limit of time ends; the most memory is that of the largest of its processes.
With `--only` the other lines of the table stay as they were.
Many recordings without their numerical work are in `many.py`.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from ingest.mcap_writer import RecordingWriter
from pipeline import Lab
from tests.conftest import ROOT
from tests.faults.lab_state import healthy, select
from tests.helpers.machine import machine, today
from tests.helpers.small_lab import RIG, about, chirp

HERE = Path(__file__).resolve().parent
_TABLE = HERE / "scale.md"
_HEAD = """# Scale

Made by `python -m tests.faults.scale`; not edited by hand. Nights over these, pages included, on a machine with other work.

{machine} · {jobs} workers

| what | size, MB | seconds | with nothing new | peak of a process, MB | wrong | |
|---|---:|---:|---:|---:|---|---|
"""
_LONGEST_S = 900.0


@dataclass(frozen=True)
class Measured:
    """A night: how it ended, how long it took, the most memory of one of its processes, and what was wrong."""

    status: int
    seconds: float
    peak_mb: float
    wrong: tuple[str, ...]


def of_one_specimen(raw: Path) -> None:
    """300 sweeps of one film."""
    for number in range(300):
        chirp(raw / f"P-1-{number:03d}.mcap", number)


def of_many_specimens(raw: Path) -> None:
    """Two sweeps of each of 200 films."""
    for number in range(400):
        specimen = f"P-{number // 2:03d}"
        chirp(raw / f"{specimen}-{number % 2}.mcap", number, specimen_id=specimen, stiffness=1 + number // 2 / 400)


def of_many_samples(raw: Path) -> None:
    """A test until breakdown of ten million samples in one channel."""
    _long_life(raw / "L-long.mcap", 10_000_000)


def of_half_a_gigabyte(raw: Path) -> None:
    """The same as a file of 500 MB, without compression."""
    _long_life(raw / "L-large.mcap", 62_500_000, compression="none")


def as_text(raw: Path) -> None:
    """Force and displacement of ten million samples as text, 300 MB."""
    count = 10_000_000
    t = np.arange(count) / 1e4
    rng = np.random.default_rng(5)
    piece = 1_000_000
    with (raw / "text.csv").open("w") as file:
        file.write("t;F;x\n")
        for at in range(0, count, piece):
            part = t[at : at + piece]
            x = 0.2 * np.sin(2 * np.pi * part)
            rows = np.column_stack((part, 0.5 + x + rng.normal(0, 1e-3, part.size), x))
            file.write("\n".join(f"{a:.4f};{b:.6f};{c:.6f}" for a, b, c in rows.tolist()) + "\n")
    (raw / "text.csv.toml").write_text(
        '[csv]\ndelimiter = ";"\n[time]\ncolumn = "t"\nunit = "s"\n[columns.force]\ncolumn = "F"\nunit = "N"\n'
        '[columns.displacement]\ncolumn = "x"\nunit = "mm"\n[recording]\nrecording_id = "text"\nprotocol = "cyclic"\n'
        'loading = "mechanical"\nspecimen_id = "T-1"\nstarted_at = "2026-03-01T14:00:00Z"\nfrequency_hz = 1.0\n'
        "strain_pp = 0.04\n"
    )


def _long_life(path: Path, count: int, *, compression: str = "zstd") -> None:
    rate = 1e4
    t = np.arange(count, dtype=np.float64) / rate
    voltage = np.where((t > 0.01 * t[-1]) & (t < 0.9 * t[-1]), 7500.0, 0.0)
    voltage += np.random.default_rng(3).normal(0, 3.0, count)
    metadata = about(path.stem, "lifetime", "electrical", path.stem, 0, voltage_setpoint_kv=7.5, test_duration_s=t[-1])
    begin = int(datetime.fromisoformat(metadata["started_at"]).timestamp() * 1e9)
    with RecordingWriter(path, metadata | {"configuration": "A"}, compression=compression) as recording:
        recording.add_channel("voltage", "V")
        recording.append("voltage", begin, 1 / rate, voltage)


SIZES: dict[str, Callable[[Path], None]] = {
    "300 recordings of one specimen": of_one_specimen,
    "200 specimens of two recordings": of_many_specimens,
    "one recording of 1e7 samples": of_many_samples,
    "one recording of 500 MB": of_half_a_gigabyte,
    "a text of 1e7 rows": as_text,
}


def spend_night(raw: Path, lab: Lab, jobs: int) -> Measured:
    """A night in a process of its own, and what `dealab doctor` and the table of recordings say of it."""
    command = [sys.executable, "-m", "pipeline.cli", "nightly", str(raw), "--lab", str(lab.folder), "--jobs", str(jobs)]
    begin, peak_mb = time.monotonic(), 0.0
    with tempfile.TemporaryFile("w+") as told:
        process = subprocess.Popen(command, cwd=ROOT, stdout=told, stderr=told, start_new_session=True)
        while process.poll() is None:
            peak_mb = max([peak_mb, *_list_peaks(process.pid)])
            if time.monotonic() - begin > _LONGEST_S:
                process.kill()  # and its workers end with it
                return Measured(-1, time.monotonic() - begin, peak_mb, (f"ended after {_LONGEST_S:.0f} s",))
            time.sleep(0.2)
        seconds = time.monotonic() - begin
        told.seek(0)
        wrong = [] if process.returncode == 0 else [f"ended with {process.returncode}: {told.read()[-300:]}"]
    if lab.database.exists():
        wrong += healthy(lab)
        other = select(lab, "SELECT recording_id, status FROM recordings WHERE status <> 'ok'")
        wrong += [f"{name}: {status}" for name, status in other]
    return Measured(process.returncode, seconds, peak_mb, tuple(wrong))


def _list_peaks(leader: int) -> Iterator[float]:
    """The most memory that each process of a session has had, MB."""
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError, ValueError):
            if int((folder / "stat").read_text().rpartition(")")[2].split()[3]) == leader:
                status = (folder / "status").read_text()
                yield int(status.partition("VmHWM:")[2].split()[0]) / 1024


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--only", nargs="*", choices=SIZES)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    lines = dict(_read_table())
    wrong = False
    with tempfile.TemporaryDirectory() as name:
        for what, make in SIZES.items():
            if arguments.only and what not in arguments.only:
                continue
            raw, lab = Path(name, what, "raw"), Lab(Path(name, what, "lab"))
            (raw / "rigs").mkdir(parents=True)
            (raw / "rigs" / "rig-a.toml").write_text(RIG)
            make(raw)
            for path in raw.rglob("*"):
                os.utime(path, (time.time() - 3600,) * 2)
            size = sum(path.stat().st_size for path in raw.rglob("*") if path.is_file()) / 1e6
            first = spend_night(raw, lab, arguments.jobs)
            again = spend_night(raw, lab, arguments.jobs)
            found = (*first.wrong, *again.wrong)
            wrong |= bool(found)
            numbers = f"{size:.0f} | {first.seconds:.0f} | {again.seconds:.1f} | {first.peak_mb:.0f}"
            lines[what] = f"| {what} | {numbers} | {'; '.join(found)[:300] or 'nothing'} | {today()} |"
            print(lines[what], flush=True)
            text = "\n".join(lines[name] for name in SIZES if name in lines)
            _TABLE.write_text(f"{_HEAD.format(machine=machine(), jobs=arguments.jobs)}{text}\n", encoding="utf-8")
            shutil.rmtree(raw.parent)
    return 1 if wrong else 0


def _read_table() -> Iterator[tuple[str, str]]:
    """The lines of the table as it is, by what they are about."""
    for line in _TABLE.read_text(encoding="utf-8").splitlines() if _TABLE.exists() else ():
        what = line.strip("| ").partition(" |")[0]
        if what in SIZES:
            yield what, line


if __name__ == "__main__":
    sys.exit(main())
