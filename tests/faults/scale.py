"""Nights over more and larger recordings than the tests have, into `scale.md`.

    python -m tests.faults.scale [--only NAME …] [--jobs N]

Each night is a process of its own, which a limit of time ends; the most memory is that of the largest of its processes,
and the time of processors that of all of them together: it hardly depends on what else the machine does.
With `--only` the other lines of the table stay as they were.
The last line is `many.py`: ten thousand recordings without their numerical work and without pages, in one process.
"""

from __future__ import annotations

import argparse
import contextlib
import json
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

{machine} · workers: {jobs}

| what | size, MB | seconds | of processors | with nothing new | peak of a process, MB | wrong | |
|---|---:|---:|---:|---:|---:|---|---|
"""
_LONGEST_S = 2400.0
_ALONE = "10 000 recordings without their numerical work"


@dataclass(frozen=True)
class Measured:
    """A night: how long it took, the processors' time of all its processes, the most memory of one, and what was wrong."""

    seconds: float
    processors_s: float
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
    begin, seen = time.monotonic(), dict[int, tuple[float, float]]()
    with tempfile.TemporaryFile("w+") as told:
        process = subprocess.Popen(command, cwd=ROOT, stdout=told, stderr=told, start_new_session=True)
        while process.poll() is None:
            seen.update(_look_at(process.pid))
            if time.monotonic() - begin > _LONGEST_S:
                process.kill()  # and its workers end with it
                return _sum_up(time.monotonic() - begin, seen, [f"ended after {_LONGEST_S:.0f} s"])
            time.sleep(0.2)
        seconds = time.monotonic() - begin
        told.seek(0)
        wrong = [] if process.returncode == 0 else [f"ended with {process.returncode}: {told.read()[-300:]}"]
    if lab.database.exists():
        wrong += healthy(lab)
        other = select(lab, "SELECT recording_id, status FROM recordings WHERE status <> 'ok'")
        wrong += [f"{name}: {status}" for name, status in other]
    return _sum_up(seconds, seen, wrong)


def _sum_up(seconds: float, seen: dict[int, tuple[float, float]], wrong: list[str]) -> Measured:
    peaks, processors = zip(*seen.values(), strict=True)
    return Measured(seconds, sum(processors), max(peaks), tuple(wrong))


def _look_at(leader: int) -> Iterator[tuple[int, tuple[float, float]]]:
    """Each process of a session: the most memory that it has had, MB, and the time of processors so far, s."""
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError, ValueError):
            stat = (folder / "stat").read_text().rpartition(")")[2].split()
            if int(stat[3]) == leader:
                peak = int((folder / "status").read_text().partition("VmHWM:")[2].split()[0]) / 1024
                yield int(folder.name), (peak, (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK"))


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--only", nargs="*", choices=[*SIZES, _ALONE])
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    lines = dict(_read_table())
    wrong = False
    with tempfile.TemporaryDirectory() as name:
        for what in arguments.only or [*SIZES, _ALONE]:
            folder = Path(name, what)
            raw, lab = folder / "raw", Lab(folder / "lab")
            raw.mkdir(parents=True)
            line, found = _without_work(raw, lab) if what == _ALONE else _nights(SIZES[what], raw, lab, arguments.jobs)
            wrong |= bool(found)
            lines[what] = f"| {what} | {line} | {'; '.join(found)[:300] or 'nothing'} | {today()} |"
            print(lines[what], flush=True)
            text = "\n".join(lines[one] for one in (*SIZES, _ALONE) if one in lines)
            _TABLE.write_text(f"{_HEAD.format(machine=machine(), jobs=arguments.jobs)}{text}\n", encoding="utf-8")
            shutil.rmtree(folder)
    return 1 if wrong else 0


def _nights(make: Callable[[Path], None], raw: Path, lab: Lab, jobs: int) -> tuple[str, tuple[str, ...]]:
    """Figures of the table from a night over these and one with nothing new, and what was wrong."""
    (raw / "rigs").mkdir()
    (raw / "rigs" / "rig-a.toml").write_text(RIG)
    make(raw)
    for path in raw.rglob("*"):
        os.utime(path, (time.time() - 3600,) * 2)
    size = sum(path.stat().st_size for path in raw.rglob("*") if path.is_file()) / 1e6
    first, again = (spend_night(raw, lab, jobs) for _ in range(2))
    line = f"{size:.0f} | {first.seconds:.0f} | {first.processors_s:.0f} | {again.seconds:.1f} | {first.peak_mb:.0f}"
    return line, (*first.wrong, *again.wrong)


def _without_work(raw: Path, lab: Lab) -> tuple[str, tuple[str, ...]]:
    """The same of ten thousand recordings whose results are made up."""
    command = [sys.executable, "-m", "tests.faults.many", str(raw), str(lab.folder), "10000"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        return "| | | | ", (f"ended with {done.returncode}: {done.stderr[-300:]}",)
    told = json.loads(done.stdout.splitlines()[-1])
    return f"0 | {told['first, s']:.0f} | | {told['quiet, s']:.1f} | {told['first']:.0f}", tuple(healthy(lab))


def _read_table() -> Iterator[tuple[str, str]]:
    """The lines of the table as it is, by what they are about."""
    for line in _TABLE.read_text(encoding="utf-8").splitlines() if _TABLE.exists() else ():
        what = line.strip("| ").partition(" |")[0]
        if what in (*SIZES, _ALONE):
            yield what, line


if __name__ == "__main__":
    sys.exit(main())
