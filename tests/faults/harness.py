"""Faults done to real nightlies, and what was lost: into `results.md`.

    python -m tests.faults.harness [--kills 50] [--publishes 20] [--seed N] [--only NAME …]

Each nightly is a process of its own, run from a copy of the software as it stands at the start. What it leaves is held
against the lab of a night that nobody disturbed: rows of the database, bytes of the samples, files left over, `doctor`.
Workers that are killed, out of memory or stuck, files that change, clocks set back and unreadable files are in
`test_faults.py` and `test_nightly.py`: there is nothing random in them.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline import Lab
from tests.conftest import ROOT
from tests.faults.lab_state import content, healthy, left_over, samples
from tests.helpers.machine import machine, today
from tests.helpers.small_lab import life, small_campaign

HERE = Path(__file__).resolve().parent
SEED = 20_260_301
_LONGEST_S = 300.0


@dataclass(frozen=True)
class Result:
    """What was done, how often, and all that was wrong afterwards."""

    done: str
    times: int
    wrong: tuple[str, ...]
    note: str = ""


class Bench:
    """A raw folder with so many chirps and lives, a copy of the software, and the lab of an undisturbed night."""

    def __init__(self, folder: Path, *, chirps: int = 2, lives: int = 4) -> None:
        self.folder = folder
        self.software = folder / "software"
        for name in ("schemas", "ingest", "pipeline", "reports", "tests"):
            shutil.copytree(ROOT / name, self.software / name)
        self.raw = small_campaign(folder / "raw", chirps=chirps, lives=lives)
        old = time.time() - 3600
        for path in self.raw.rglob("*"):
            os.utime(path, (old, old))
        self.undisturbed = Lab(folder / "undisturbed")
        begin = time.monotonic()
        done = self.run(self.undisturbed)
        self.seconds = time.monotonic() - begin
        if done.returncode:
            raise RuntimeError(f"the undisturbed night ended with {done.returncode}: {done.stderr}")

    def start(self, lab: Lab, *, jobs: int = 1, **options: Any) -> subprocess.Popen[str]:
        """A nightly as a process in a session of its own."""
        command = [sys.executable, "-m", "pipeline.cli", "nightly", str(self.raw)]
        return subprocess.Popen(
            [*command, "--lab", str(lab.folder), "--jobs", str(jobs)],
            cwd=self.software,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            **options,
        )

    def run(self, lab: Lab, **options: Any) -> subprocess.CompletedProcess[str]:
        """A whole nightly."""
        process = self.start(lab, **options)
        _, errors = process.communicate(timeout=_LONGEST_S)
        return subprocess.CompletedProcess(process.args, process.returncode, "", errors)

    def differences(self, lab: Lab, what: str) -> list[str]:
        """How a lab differs from the undisturbed one."""
        found = []
        expected, now = content(self.undisturbed), content(lab)
        found += [f"{what}: other rows in {name}" for name in expected if expected[name] != now[name]]
        if samples(lab) != samples(self.undisturbed):
            found.append(f"{what}: other samples")
        found += [f"{what}: left over {name}" for name in left_over(lab)]
        found += [f"{what}: {finding}" for finding in healthy(lab)]
        return found


def finished(lab: Lab) -> int:
    """Items that are finished and not published."""
    return len(list(lab.journal.glob("*.entry"))) if lab.journal.is_dir() else 0


STAGES: dict[str, Callable[[Lab], bool]] = {
    "the journal is there": lambda lab: lab.journal.is_dir(),
    "an item is finished": lambda lab: finished(lab) >= 1,
    "four items are finished": lambda lab: finished(lab) >= 4,
    "samples are there": lambda lab: lab.samples_folder.is_dir(),
    "the next database is being built": lambda lab: (lab.work / "building.duckdb").exists(),
    "the database is published": lambda lab: lab.database.exists(),
}
"""How far a night has come."""


def kills_at_stages(bench: Bench, seed: int) -> Result:
    """kill -9 at each stage of one lab, then another run."""
    rng = random.Random(seed)
    wrong: list[str] = []
    lab = Lab(bench.folder / "stages")
    for what, reached in STAGES.items():
        process = bench.start(lab)
        while process.poll() is None and not reached(lab):
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.05))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        if lab.database.exists():
            wrong += [f"killed when {what}: {one}" for one in healthy(lab) if "temporary" not in one]
    again = bench.run(lab)
    if again.returncode:
        wrong.append(f"the run after all kills ended with {again.returncode}: {again.stderr[-300:]}")
    else:
        wrong += bench.differences(lab, "killed at all stages")
    shutil.rmtree(lab.folder)
    return Result("kill -9 at each stage, one after the other", len(STAGES), tuple(wrong))


def kills(bench: Bench, times: int, seed: int) -> Result:
    """kill -9 at a random moment, then another run."""
    rng = random.Random(seed)
    wrong: list[str] = []
    before, published = 0, 0
    for number in range(times):
        lab = Lab(bench.folder / f"killed-{number}")
        moment = rng.uniform(0.0, 1.05 * bench.seconds)
        process = bench.start(lab)
        try:
            process.wait(moment)
        except subprocess.TimeoutExpired:
            os.kill(process.pid, signal.SIGKILL)
        process.communicate()
        what = f"killed after {moment:.2f} s"
        if (orphans := _session(process.pid)) != 0:
            wrong.append(f"{what}: {orphans} processes outlived it")
        if lab.database.exists():
            published += 1
            wrong += [f"{what}: {one}" for one in healthy(lab) if "half-written" not in one and "temporary" not in one]
        else:
            before += 1
        again = bench.run(lab)
        if again.returncode:
            wrong.append(f"{what}: the next run ended with {again.returncode}: {again.stderr[-300:]}")
        else:
            wrong += bench.differences(lab, what)
        shutil.rmtree(lab.folder)
    return Result(
        "kill -9 at a random moment", times, tuple(wrong), f"{before} before the first publish, {published} after"
    )


def _session(leader: int) -> int:
    """Processes of a session that are still there after a second."""
    for _ in range(20):
        if not count_session(leader):
            return 0
        time.sleep(0.05)
    return count_session(leader)


def count_session(leader: int) -> int:
    """Processes of a session that are there now; 0 where the system does not tell."""
    alive = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        alive += int(fields[3]) == leader and fields[0] != "Z"
    return alive


def two_at_once(bench: Bench, times: int) -> Result:
    """Two nightlies on one lab, started together."""
    wrong: list[str] = []
    for number in range(times):
        lab = Lab(bench.folder / f"two-{number}")
        both = [bench.start(lab) for _ in range(2)]
        texts = [process.communicate(timeout=_LONGEST_S)[1] for process in both]
        ends = [process.returncode for process in both]
        if sorted(ends) != [0, 1]:
            wrong.append(f"they ended with {ends}: {texts}")
            continue
        loser, winner = ends.index(1), ends.index(0)
        if f"process {both[winner].pid} on " not in texts[loser]:
            wrong.append(f"the second does not name the first: {texts[loser]}")
        wrong += bench.differences(lab, "two at once")
        shutil.rmtree(lab.folder)
    return Result("two nightlies started together", times, tuple(wrong), "one ends with status 1 and names the other")


def readers(bench: Bench, publishes: int, count: int = 2) -> Result:
    """Programs that open the database and query it, in a loop, while nights publish one new recording after another."""
    lab = Lab(bench.folder / "read")
    raw = bench.folder / "growing"
    shutil.copytree(bench.raw, raw)
    shutil.copytree(bench.undisturbed.folder, lab.folder)
    command = [sys.executable, "-m", "tests.faults.reader", str(lab.folder)]
    running = [
        subprocess.Popen(command, cwd=bench.software, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(count)
    ]
    wrong: list[str] = []
    plain, bench.raw = bench.raw, raw
    for number in range(publishes):
        life(raw / f"L-{20 + number}.mcap", 20 + number)
        done = bench.run(lab)
        if done.returncode:
            wrong.append(f"publish {number} ended with {done.returncode}: {done.stderr[-300:]}")
    bench.raw = plain
    queries = 0
    for process in running:
        said, _ = process.communicate("stop\n", timeout=_LONGEST_S)
        told = json.loads(said)
        queries += told["queries"]
        wrong += told["wrong"]
        if told["states"] < min(publishes, 3):
            wrong.append(f"a reader saw {told['states']} states only")
    shutil.rmtree(lab.folder)
    return Result(f"{publishes} publishes while {count} programs read", queries, tuple(wrong), "times: queries")


def full_disk(bench: Bench, limits: tuple[int, ...]) -> Result:
    """No file may grow beyond a limit: the disk is full at another stage with each."""
    wrong: list[str] = []
    refused = 0
    for limit in limits:
        lab = Lab(bench.folder / f"limit-{limit}")

        def small_files(size: int = limit) -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

        refused += _starved(bench, lab, f"files of at most {limit} bytes", wrong, preexec_fn=small_files)
        shutil.rmtree(lab.folder, ignore_errors=True)
    note = f"{refused} nights ended with status 1, the others had room"
    return Result("files limited to a size (RLIMIT_FSIZE)", len(limits), tuple(wrong), note)


def small_disk(bench: Bench, sizes_kb: tuple[int, ...]) -> Result:
    """A lab on a file system of a few hundred kB, with a published night and without; then the disk grows."""
    wrong: list[str] = []
    refused = 0
    place = bench.folder / "disk"
    place.mkdir()
    for size in sizes_kb:
        mounted = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", str(place)], capture_output=True, check=False
        )
        if mounted.returncode:
            return Result("a lab on a tiny disk (tmpfs)", 0, (), "not done: mounting needs rights")
        try:
            lab = Lab(place / "lab")

            def grow() -> None:
                subprocess.run(["mount", "-o", "remount,size=200m", str(place)], check=True)

            refused += _starved(bench, lab, f"a disk of {size} kB", wrong, relief=grow)
        finally:
            subprocess.run(["umount", str(place)], check=True)
    note = f"{refused} nights ended with status 1, the others had room"
    return Result("a lab on a tiny disk (tmpfs)", len(sizes_kb), tuple(wrong), note)


def _starved(
    bench: Bench, lab: Lab, what: str, wrong: list[str], *, relief: Callable[[], None] | None = None, **options: Any
) -> bool:
    """A night without room, then one with room; whether the first was refused."""
    first = bench.run(lab, **options)
    if "Traceback" in first.stderr:
        wrong.append(f"{what}: a traceback: {first.stderr[-400:]}")
    if first.returncode not in (0, 1):
        wrong.append(f"{what}: ended with {first.returncode}: {first.stderr[-300:]}")
    if first.returncode == 1 and not first.stderr.startswith("dealab: "):
        wrong.append(f"{what}: no reason: {first.stderr[:300]}")
    if lab.database.exists():
        wrong += [f"{what}: {finding}" for finding in healthy(lab) if "published" in finding]
    if relief is not None:
        relief()
    again = bench.run(lab)
    if again.returncode:
        wrong.append(f"{what}: the next run ended with {again.returncode}: {again.stderr[-300:]}")
    else:
        wrong += bench.differences(lab, what)
    return first.returncode == 1


def all_faults(bench: Bench, arguments: argparse.Namespace) -> Iterator[Result]:
    """The faults that were asked for, one after the other."""
    faults: dict[str, Callable[[], Result]] = {
        "kills": lambda: kills(bench, arguments.kills, arguments.seed),
        "stages": lambda: kills_at_stages(bench, arguments.seed),
        "two": lambda: two_at_once(bench, 3),
        "readers": lambda: readers(bench, arguments.publishes),
        "files": lambda: full_disk(bench, tuple(1 << power for power in range(6, 25, 2))),
        "disk": lambda: small_disk(bench, (4, 64, 256, 1024, 2048, 4096, 8192, 16384)),
    }
    for name, fault in faults.items():
        if not arguments.only or name in arguments.only:
            yield fault()


HEAD = "| what was done | times | what was lost or wrong | |\n|---|---:|---|---|"


def row(result: Result) -> str:
    """A line of the table."""
    wrong = f"{len(result.wrong)}: see below" if result.wrong else "nothing"
    return f"| {result.done} | {result.times} | {wrong} | {result.note} |"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--publishes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", nargs="*", choices=("kills", "stages", "two", "readers", "files", "disk"))
    arguments = parser.parse_args()
    lines = ["# Faults\n", "Made by `make faults`; not edited by hand.\n"]
    lines += [f"{today()} · {machine()} · seed {arguments.seed}\n", HEAD]
    print(HEAD, flush=True)
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        bench = Bench(Path(name))
        for result in all_faults(bench, arguments):
            lines.append(row(result))
            print(lines[-1], *result.wrong, sep="\n", flush=True)
            wrong += result.wrong
            if not arguments.only:  # as far as it has come: all of it takes an hour
                text = "\n".join([*lines, "", *(f"- {one}" for one in wrong)]).rstrip() + "\n"
                (HERE / "results.md").write_text(text, encoding="utf-8")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
