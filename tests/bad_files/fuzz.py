"""`make fuzz`: mutated files for every reader, and what became of them, into `results.md`.

    python -m tests.bad_files.fuzz [--reader NAME …] [--cases N] [--mcap-cases N] [--coverage SECONDS] [--seed N] [--jobs N]

Each case is a mutation of a valid file, made from its own random source: `--only NUMBER` makes one again. No case may
crash its reader, take a second of processor time, take 300 MB, or give as `ok` what its seed does not hold (seeds with checksums). Files
that broke a promise are kept under `artifacts/fuzz`. The table is written by runs over all readers.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.bad_files.beside import crowded, relinked
from tests.bad_files.mutate import mutated, resealed
from tests.bad_files.promises import (
    DAMAGED,
    LARGEST_MB,
    LONGEST_S,
    OK,
    REFUSED,
    TABLE,
    Truth,
    Verdict,
    examined,
    truth,
)
from tests.bad_files.seeds import READERS, Seed
from tests.helpers.machine import machine, peak_mb, today

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
KEPT = ROOT / "artifacts" / "fuzz"
GUIDED = ROOT / ".venv-fuzz" / "bin" / "python"
SEED = 20_260_301
_BATCH = 250
_STUCK_S = 30.0
"""A reader that has not come back after this is killed and counts as hung."""
_DATA_LIMIT = 1 << 30
_LINKED, _CROWDED = 0.2, 0.2
"""Shares of cases that have a link to another file in them, where the format has links, and that are read once more among
files that lie beside them."""


@dataclass
class Tally:
    """What became of the cases of one reader. `findings` are (case, what was broken)."""

    cases: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    peak_mb: float = 0.0
    crowded: int = 0
    findings: list[tuple[int, str]] = field(default_factory=list)

    def add(self, number: int, verdict: Verdict) -> None:
        self.cases += 1
        self.outcomes[verdict.outcome] += 1
        self.slowest_s = max(self.slowest_s, verdict.seconds)
        before, self.peak_mb = self.peak_mb, max(self.peak_mb, peak_mb())
        if verdict.broken is not None:
            self.findings.append((number, verdict.broken))
        elif verdict.seconds > LONGEST_S:
            self.findings.append((number, f"hang: {verdict.seconds:.1f} s"))
        elif before <= LARGEST_MB < self.peak_mb:
            self.findings.append((number, f"memory: {self.peak_mb:.0f} MB"))

    def compare(self, number: int, alone: Verdict, crowded: Verdict) -> None:
        """Books a case that was read once more among other files, where it has to be the same."""
        self.crowded += 1
        if crowded.found != alone.found or crowded.outcome != alone.outcome:
            self.findings.append((number, f"wrong: beside other files {crowded.outcome}, alone {alone.outcome}"))

    def join(self, other: Tally) -> None:
        self.cases += other.cases
        self.outcomes += other.outcomes
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.peak_mb = max(self.peak_mb, other.peak_mb)
        self.crowded += other.crowded
        self.findings += other.findings


@dataclass(frozen=True)
class Case:
    """One mutated file. `seed` is what it was made from; sealed no longer where the mutation has sealed it anew."""

    seed: Seed
    content: bytes


def case(seeds: Sequence[Seed], run: int, number: int) -> Case:
    """The case of a number: always the same one."""
    rng = random.Random(f"{run}:{number}")
    seed = seeds[number % len(seeds)]
    if seed.reader.startswith("mcap") and rng.random() < 0.3:
        content = resealed(seed.content, rng)
        if content is not None:
            return Case(Seed(seed.reader, seed.name, seed.suffix, content, seed.mapping), content)
    if rng.random() < _LINKED and (content := relinked(seed.content, rng)) is not None:
        return Case(seed, mutated(content, rng) if rng.random() < 0.5 else content)
    return Case(seed, mutated(seed.content, rng))


def batch(reader: str, run: int, numbers: Sequence[int], folder: Path) -> Tally:
    """Examines some cases in this process. The file of a case that kills it stays in `folder`."""
    seeds, truths = _known(reader, folder)
    tally = Tally()
    for number in numbers:
        made = case(seeds, run, number)
        path = folder / f"{number}{made.seed.suffix}"
        path.write_bytes(made.content)
        original = truths[number % len(seeds)]
        verdict = _timed(made.seed, original, path)
        tally.add(number, verdict)
        rng = random.Random(f"beside {run}:{number}")
        if rng.random() < _CROWDED and verdict.broken is None:
            with crowded(path, rng, made.seed.content) as place:
                among_others = _timed(made.seed, original, place)
            tally.compare(number, verdict, among_others)
        path.unlink()
    return tally


def _timed(seed: Seed, original: Truth, path: Path) -> Verdict:
    """Examines a file; a reader that waits for ever takes this process with it."""
    signal.setitimer(signal.ITIMER_REAL, _STUCK_S)
    try:
        return examined(seed, original, path)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


_SEEDS: dict[str, tuple[list[Seed], list[Truth]]] = {}


def _known(reader: str, folder: Path) -> tuple[list[Seed], list[Truth]]:
    if reader not in _SEEDS:
        seeds = READERS[reader]()
        _SEEDS[reader] = seeds, [truth(seed, folder / f"seed-{os.getpid()}{seed.suffix}") for seed in seeds]
    return _SEEDS[reader]


def _start_worker() -> None:
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_DATA, (_DATA_LIMIT, _DATA_LIMIT))


def fuzz(reader: str, cases: int, *, run: int = SEED, jobs: int = 1) -> Tally:
    """Examines many cases of a reader in worker processes."""
    tally = Tally()
    waiting = [range(at, min(at + _BATCH, cases)) for at in range(0, cases, _BATCH)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        while waiting:
            waiting = _round(reader, run, waiting, folder, jobs, tally)
            for number in _left(folder):
                waiting = _alone(reader, run, number, folder, waiting, tally)
    return tally


def _round(reader: str, run: int, waiting: list[range], folder: Path, jobs: int, tally: Tally) -> list[range]:
    """Runs batches until all are done or a worker has died; returns those that are left."""
    context = multiprocessing.get_context("spawn")
    left = list(waiting)
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_start_worker) as pool:
        futures = {pool.submit(batch, reader, run, numbers, folder): numbers for numbers in waiting}
        for future in as_completed(futures):
            try:
                tally.join(future.result())
            except BrokenProcessPool:
                continue
            left.remove(futures[future])
    return left


def _left(folder: Path) -> list[int]:
    found = [int(path.stem) for path in folder.iterdir() if path.stem.isdigit()]
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
    return sorted(found)


def _alone(reader: str, run: int, number: int, folder: Path, waiting: list[range], tally: Tally) -> list[range]:
    """Runs a case that was at work when a worker died; one that kills again is a finding, and is taken out."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context, initializer=_start_worker) as pool:
        try:
            pool.submit(batch, reader, run, [number], folder).result()
            return waiting
        except BrokenProcessPool:
            tally.cases += 1
            tally.outcomes["crash"] += 1
            tally.findings.append((number, "the process died (a crash in compiled code, or a hang)"))
            _left(folder)
    parts = []
    for numbers in waiting:
        if number in numbers:
            parts += [range(numbers.start, number), range(number + 1, numbers.stop)]
        else:
            parts.append(numbers)
    return [part for part in parts if part]


def keep(reader: str, run: int, findings: Sequence[tuple[int, str]]) -> Iterator[str]:
    """Writes the files that broke a promise, and says what they did."""
    seeds = READERS[reader]()
    for number, broken in findings:
        made = case(seeds, run, number)
        KEPT.mkdir(parents=True, exist_ok=True)
        path = KEPT / f"{reader.replace(' ', '_')}-{number}{made.seed.suffix}"
        path.write_bytes(made.content)
        yield f"{path.relative_to(ROOT)} ({made.seed.name}): {broken.strip()}"


# --- guided by coverage -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Guided:
    """A run of atheris over one reader."""

    executions: int
    seconds: float
    covered: int
    findings: tuple[str, ...]


def guided(reader: str, seconds: int, run: int) -> Guided:
    """Lets atheris look for inputs that take new ways through a reader, from its seeds."""
    kept = KEPT / f"guided-{reader.replace(' ', '_')}"
    shutil.rmtree(kept, ignore_errors=True)
    kept.mkdir(parents=True)
    command = [os.fspath(GUIDED), "-m", "tests.bad_files.guided", reader]
    options = [f"-max_total_time={seconds}", f"-seed={run}", "-timeout=5", "-rss_limit_mb=1024", "-print_final_stats=1"]
    begin = time.monotonic()
    done = subprocess.run(
        [*command, f"-artifact_prefix={kept}/", *options], cwd=ROOT, capture_output=True, text=True, check=False
    )
    said = done.stdout + done.stderr
    executed = re.findall(r"stat::number_of_executed_units:\s*(\d+)", said)
    covered = re.findall(r"\bcov: (\d+)", said)
    found = [f"{path.relative_to(ROOT)}" for path in sorted(kept.iterdir())]
    if done.returncode and not found:
        found = [said.strip().splitlines()[-1]]
    return Guided(
        int(executed[-1]) if executed else 0,
        time.monotonic() - begin,
        int(covered[-1]) if covered else 0,
        tuple(found),
    )


# --- the table ----------------------------------------------------------------------------------------------------------


def row(reader: str, tally: Tally) -> str:
    """A line of the table."""
    kinds = Counter(broken.split(":")[0] for _, broken in tally.findings)
    hangs, memory = kinds.pop("hang", 0), kinds.pop("memory", 0)
    crashes = tally.outcomes["crash"]
    wrong = sum(kinds.values()) - crashes
    whole = tally.outcomes[OK] + tally.outcomes[TABLE]
    return (
        f"| {reader} | {tally.cases} | {tally.outcomes[REFUSED]} | {tally.outcomes[DAMAGED]} | {whole} "
        f"| {tally.crowded} | {tally.slowest_s:.2f} | {tally.peak_mb:.0f} | {crashes} | {hangs} | {memory} | {wrong} |"
    )


HEAD = """| reader | cases | refused | damaged | read as whole | beside others | slowest, s | peak, MB | crashes | hangs | memory | wrong |
|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|"""
GUIDED_HEAD = """| reader | executions | seconds | covered branches | findings |
|---|---:|---:|---:|---:|"""


def main(given: Sequence[str] | None = None) -> int:
    arguments = _arguments(given)
    if arguments.only is not None:
        return _again(arguments)
    readers = arguments.reader or list(READERS)
    lines = [f"{today()} · {machine()} · seed {arguments.seed}\n", HEAD]
    print(HEAD, flush=True)
    findings: list[str] = []
    for reader in readers:
        cases = arguments.mcap_cases if reader == "mcap" else arguments.cases
        tally = fuzz(reader, cases, run=arguments.seed, jobs=arguments.jobs)
        lines.append(row(reader, tally))
        print(lines[-1], flush=True)
        findings += keep(reader, arguments.seed, tally.findings)
    lines += ["", *_guided_lines(readers, arguments, findings)]
    print("\n".join(findings) or "No promise was broken.")
    if not arguments.reader:
        text = ["# Bad files\n", f"{_ABOUT}\n", *lines, "", *(f"- {one}" for one in findings)]
        (HERE / "results.md").write_text("\n".join(text).rstrip() + "\n", encoding="utf-8")
    return 1 if findings else 0


def _guided_lines(readers: Sequence[str], arguments: argparse.Namespace, findings: list[str]) -> list[str]:
    if not arguments.coverage:
        return ["Guided by coverage: not run."]
    if not _atheris_is_there():
        return ["Guided by coverage: not run, atheris is not installed (`make fuzz` installs it where it can)."]
    print(GUIDED_HEAD, flush=True)
    lines = ["Guided by coverage (atheris):\n", GUIDED_HEAD]
    for reader in readers:
        found = guided(reader, arguments.coverage, arguments.seed)
        lines.append(
            f"| {reader} | {found.executions} | {found.seconds:.0f} | {found.covered} | {len(found.findings)} |"
        )
        print(lines[-1], flush=True)
        findings += found.findings
    return lines


def _atheris_is_there() -> bool:
    found = GUIDED.exists() and subprocess.run([GUIDED, "-c", "import atheris"], capture_output=True, check=False)
    return bool(found) and found.returncode == 0


def _again(arguments: argparse.Namespace) -> int:
    """Makes one case again and says what becomes of it."""
    (reader,) = arguments.reader
    with tempfile.TemporaryDirectory() as name:
        tally = batch(reader, arguments.seed, [arguments.only], Path(name))
    print(*keep(reader, arguments.seed, tally.findings), dict(tally.outcomes), sep="\n")
    return 1 if tally.findings else 0


_ABOUT = (
    "Made by `make fuzz`; not edited by hand. A case is a valid file with one to four mutations; `slowest` is processor "
    "time, a hang more than a second of it. `wrong`: something was "
    "reported as whole that the seed does not hold, times and values that no recording may have, or something of another "
    "file: HDF5 and MATLAB v7.3 also get links to one, and cases that count as `beside others` are read once more behind a "
    "link or among indexes, heads, earlier copies, pipes and devices, where they have to be the same. Files without "
    "checksums (text, arrays) cannot show that a digit has changed: for them that part of `wrong` is not asked."
)


def _arguments(given: Sequence[str] | None) -> Any:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--reader", action="append", choices=list(READERS), help="only this reader; may be repeated")
    parser.add_argument("--cases", type=int, default=10_000, help="cases of each reader")
    parser.add_argument("--mcap-cases", type=int, default=100_000, help="cases of the native format")
    parser.add_argument("--coverage", type=int, default=60, help="seconds of guided search for each reader, 0 for none")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--only", type=int, help="make this case of one reader again")
    return parser.parse_args(given)


if __name__ == "__main__":
    sys.exit(main())
