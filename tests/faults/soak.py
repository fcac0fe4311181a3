"""A soak: nights with accidents of all kinds, one after the other in one lab, drawn anew each time; into `soak.md`.

    python -m tests.faults.soak [--nights 30] [--seed N]

Each night finds a new recording and one to four accidents among its files, and is itself killed, starved, raced or left
without rights. What a night left is looked at, then people mend what is theirs to mend, as the messages say. When all
nights are over one more has no accident: the lab must then equal that of a single night over the same files.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import duckdb

from ingest.quarantine import entries, entry_name
from pipeline import Lab
from pipeline.lab.annotations import EXCLUDE, INCLUDE, annotate
from tests.faults import strange_items
from tests.faults.harness import Bench, count_session
from tests.faults.lab_state import healthy
from tests.helpers.machine import machine, today
from tests.helpers.small_lab import RIG, life

HERE = Path(__file__).resolve().parent
_LONGEST_S = 300.0
_SECRET = "nobody's business"
_INTERRUPTED = 130
_END_S = 1.5
"""How long the processes of a night that was ended may be there."""


@dataclass
class Scene:
    """Where accidents happen: raw files, the lab, a folder of somebody else, and the dice."""

    bench: Bench
    lab: Lab
    outside: Path
    rng: random.Random

    @property
    def raw(self) -> Path:
        return self.bench.raw

    def choose(self, paths: Iterable[Path]) -> Path | None:
        """One of the files that are there, or none."""
        found = sorted(paths)
        return self.rng.choice(found) if found else None


Accident = Callable[[Scene], AbstractContextManager[None]]
"""Something that happens before a night; at its end it is put right as the messages say."""


@contextlib.contextmanager
def strange_names(scene: Scene) -> Iterator[None]:
    """Names that are no UTF-8 or too long, folders deeper than a path may be, links and devices that never end."""
    put = scene.rng.choice(strange_items.ALL)
    place = scene.raw / "strange"
    place.mkdir()
    put(os.fsencode(place))
    try:
        yield
    finally:
        strange_items.remove_deep(place)
        shutil.rmtree(place)


@contextlib.contextmanager
def broken_rig_file(scene: Scene) -> Iterator[None]:
    """A rig file that is no TOML, holds nonsense, or has gone."""
    file = scene.raw / "rigs" / "rig-a.toml"
    text = scene.rng.choice(("clamp_mass_kg = ", "clamp_mass_kg = inf\n", "clamp_mass_kg = 'heavy'\n", "\0", None))
    file.unlink() if text is None else file.write_text(text)
    try:
        yield
    finally:
        file.write_text(RIG)


@contextlib.contextmanager
def broken_settings(scene: Scene) -> Iterator[None]:
    """Settings that are none."""
    scene.lab.create()
    scene.lab.settings.write_text(scene.rng.choice(("memory_mb = inf\n", "deadline_s = ", "no such key = 1\n", "\0")))
    try:
        yield
    finally:
        scene.lab.settings.unlink()


@contextlib.contextmanager
def half_a_copy(scene: Scene) -> Iterator[None]:
    """A recording whose copy from the rig ends in the middle, or is zeros from there on, and is whole later."""
    file = scene.rng.choice(sorted(scene.raw.glob("*.mcap")))
    whole, status = file.read_bytes(), file.stat()
    keep = scene.rng.randrange(len(whole))
    file.write_bytes(whole[:keep] + bytes(len(whole) - keep) * scene.rng.randrange(2))
    os.utime(file, (status.st_atime, status.st_mtime - 60))
    try:
        yield
    finally:
        file.write_bytes(whole)
        os.utime(file, (status.st_atime, status.st_mtime + 1))


@contextlib.contextmanager
def other_clocks(scene: Scene) -> Iterator[None]:
    """The times of raw files are set back and forth."""
    for file in scene.raw.glob("*.mcap"):
        os.utime(file, (0, scene.rng.choice((0, 1, 2**31, 2**33, time.time() - 7200))))
    yield


@contextlib.contextmanager
def gone_file(scene: Scene) -> Iterator[None]:
    """A raw file is away for a night."""
    file = scene.rng.choice(sorted(scene.raw.glob("*.mcap")))
    away = scene.outside / file.name
    file.rename(away)
    try:
        yield
    finally:
        away.rename(file)


@contextlib.contextmanager
def closed_files(scene: Scene) -> Iterator[None]:
    """A raw file, the rig files or some of the lab belong to another user, who lets nobody in."""
    places = [scene.rng.choice(sorted(scene.raw.glob("*.mcap"))), scene.raw / "rigs"]
    places += [place for place in (scene.lab.samples_folder, scene.lab.annotations) if place.exists()]
    place = scene.rng.choice(places)
    mode = place.stat().st_mode
    place.chmod(0)
    try:
        yield
    finally:
        place.chmod(mode)


@contextlib.contextmanager
def lost_samples(scene: Scene) -> Iterator[None]:
    """Samples files are removed."""
    for _ in range(scene.rng.randint(1, 3)):
        if file := scene.choose(scene.lab.samples_folder.rglob("*.parquet")):
            file.unlink()
    yield


@contextlib.contextmanager
def damaged_samples(scene: Scene) -> Iterator[None]:
    """Bits of a samples file flip, or its end is lost; it is removed as `dealab doctor` says."""
    if file := scene.choose(scene.lab.samples_folder.rglob("*.parquet")):
        _spoil(scene, file)
    try:
        yield
    finally:
        if file:
            file.unlink(missing_ok=True)


@contextlib.contextmanager
def damaged_database(scene: Scene) -> Iterator[None]:
    """Bits of the published database flip, or its end is lost; it is moved away as the message says."""
    there = scene.lab.database.exists()
    if there:
        _spoil(scene, scene.lab.database)
    try:
        yield
    finally:
        if there:
            scene.lab.database.unlink(missing_ok=True)


@contextlib.contextmanager
def edited_database(scene: Scene) -> Iterator[None]:
    """Somebody opens the published database for writing and changes its tables; it is moved away as the message says."""
    there = scene.lab.database.exists()
    if there:
        edits = (
            "ALTER TABLE runs ADD COLUMN mine INTEGER",
            "DROP VIEW best_models",
            "CREATE TABLE notes (text VARCHAR)",
        )
        with duckdb.connect(str(scene.lab.database)) as connection:
            connection.execute(scene.rng.choice(edits))
    try:
        yield
    finally:
        if there:
            scene.lab.database.unlink(missing_ok=True)


def _spoil(scene: Scene, file: Path) -> None:
    content = bytearray(file.read_bytes())
    kind = scene.rng.choice(("flip", "cut", "zeros", "other"))
    place = scene.rng.randrange(len(content))
    if kind == "flip":
        content[place] ^= 1 << scene.rng.randrange(8)
    elif kind == "cut":
        del content[place:]
    elif kind == "zeros":
        content[place : place + 4096] = bytes(len(content[place : place + 4096]))
    else:
        content = bytearray(b"not what it was")
    file.write_bytes(content)


@contextlib.contextmanager
def broken_annotations(scene: Scene) -> Iterator[None]:
    """Half a line, bytes that are no text, other people's JSON; mended by saying the next thing."""
    scene.lab.create()
    with scene.lab.annotations.open("ab") as file:
        file.write(scene.rng.choice((b'{"recording_id": "L-0", "act', b"\xff\xfe\n", b"[1, 2]\n", b'{"at": 7}\n')))
    try:
        yield
    finally:
        annotate(scene.lab, "L-1", scene.rng.choice((EXCLUDE, INCLUDE)), "a soak")


@contextlib.contextmanager
def linked_folder(scene: Scene) -> Iterator[None]:
    """A folder of the lab is a link to somebody else's folder, which has to stay as it is."""
    scene.lab.create()
    place = scene.rng.choice((scene.lab.work, scene.lab.reports, scene.lab.quarantine, scene.lab.samples_folder))
    secret = scene.outside / "secret"
    secret.mkdir()
    (secret / "theirs.txt").write_text(_SECRET)
    aside = scene.outside / "aside"
    if place.exists():
        place.rename(aside)
    place.symlink_to(secret)
    try:
        yield
        if [path.name for path in secret.iterdir()] != ["theirs.txt"]:
            raise RuntimeError(f"behind the link {place.name}: {sorted(path.name for path in secret.iterdir())}")
    finally:
        place.unlink()
        if aside.exists():
            aside.rename(place)
        shutil.rmtree(secret)


@contextlib.contextmanager
def litter(scene: Scene) -> Iterator[None]:
    """What killed nights and other programs leave in a lab: journal entries that are none, half-written files."""
    scene.lab.journal.mkdir(parents=True, exist_ok=True)
    for number in range(scene.rng.randint(1, 4)):
        (scene.lab.journal / f"{number:064x}.entry").write_bytes(scene.rng.randbytes(scene.rng.randrange(200)))
    for folder in (scene.lab.reports, scene.lab.samples_folder):
        folder.mkdir(exist_ok=True)
        (folder / ".L-1.parquet.1234.tmp").write_bytes(b"half")
        (folder / ".partial-9").mkdir(exist_ok=True)
    yield


@contextlib.contextmanager
def foreign_modules(scene: Scene) -> Iterator[None]:
    """Files in the working folder are named like libraries and like our packages."""
    names = ("numpy.py", "ingest.py", "pipeline.py", "json.py", "site.py")
    for name in names:
        (scene.outside / name).write_text(f"open({str(scene.outside / 'ran')!r}, 'w').close()\nraise SystemExit(9)\n")
    try:
        yield
        if (scene.outside / "ran").exists():
            raise RuntimeError("a module in the working folder was run")
    finally:
        for name in names:
            (scene.outside / name).unlink()


ACCIDENTS: tuple[Accident, ...] = (
    strange_names,
    broken_rig_file,
    broken_settings,
    half_a_copy,
    other_clocks,
    gone_file,
    closed_files,
    lost_samples,
    damaged_samples,
    damaged_database,
    edited_database,
    broken_annotations,
    linked_folder,
    litter,
    foreign_modules,
)


_ORDER: dict[Accident, int] = {edited_database: -1, linked_folder: 1, closed_files: 2}
"""Accidents that come before or after the others: who edits opens a whole database, and the last two, which are put right
first, close the lab to whoever mends the rest."""


def start(scene: Scene, **options: Any) -> subprocess.Popen[str]:
    """A night by a user who is not root, from a folder of somebody else."""
    command = [sys.executable, "-c", _COMMAND, str(scene.bench.software), "nightly", str(scene.raw)]
    if os.geteuid() == 0 and shutil.which("setpriv"):  # root may read everything unless that right is taken away
        command = ["setpriv", "--bounding-set=-dac_override,-dac_read_search", *command]
    return subprocess.Popen(
        [*command, "--lab", str(scene.lab.folder), "--jobs", str(scene.rng.choice((0, 1, 2)))],
        cwd=scene.outside,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="backslashreplace",
        start_new_session=True,
        **options,
    )


_COMMAND = "import sys; sys.path[0] = sys.argv.pop(1); from pipeline.cli import main; sys.exit(main())"


@dataclass(frozen=True)
class Ended:
    """How a night ended: its exit status, what it told, and whether it was told to end."""

    status: int
    told: str
    by_us: bool = False


def undisturbed(scene: Scene) -> Ended:
    """Nobody touches the night."""
    process = start(scene)
    _, told = process.communicate(timeout=_LONGEST_S)
    return Ended(process.returncode, told)


def ended_early(scene: Scene) -> Ended:
    """A signal at a random moment."""
    number = scene.rng.choice((signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP))
    moment = scene.rng.uniform(0.2, 1.2 * scene.bench.seconds)
    process = start(scene, preexec_fn=_heed_interrupts)
    try:
        process.wait(moment)
    except subprocess.TimeoutExpired:
        os.kill(process.pid, number)
    _, told = process.communicate(timeout=_LONGEST_S)
    begin = time.monotonic()
    while count_session(process.pid):
        if time.monotonic() - begin > _END_S:
            raise RuntimeError(f"{count_session(process.pid)} processes outlived {number.name}")
        time.sleep(0.05)
    return Ended(process.returncode, told, by_us=True)


def _heed_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # what runs behind a shell may have it ignored
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def full_disk(scene: Scene) -> Ended:
    """No file may grow beyond a size that is drawn."""
    size = int(2 ** scene.rng.uniform(6, 23))

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

    process = start(scene, preexec_fn=limit)
    _, told = process.communicate(timeout=_LONGEST_S)
    return Ended(process.returncode, told)


def two_at_once(scene: Scene) -> Ended:
    """Another night over the same lab begins meanwhile; the better end counts."""
    both = [start(scene), start(scene)]
    texts = [process.communicate(timeout=_LONGEST_S)[1] for process in both]
    statuses = [process.returncode for process in both]
    return Ended(min(statuses), "".join(texts))


NIGHTS: tuple[Callable[[Scene], Ended], ...] = (undisturbed, ended_early, full_disk, two_at_once)


@dataclass(frozen=True)
class Night:
    """A night of the soak: what happened to it, how it ended, what was wrong."""

    number: int
    accidents: tuple[str, ...]
    ended: int
    wrong: tuple[str, ...]


def spend_night(scene: Scene, number: int) -> Night:
    """A new recording, accidents, a night among them; then what people mend."""
    life(scene.raw / f"L-{20 + number}.mcap", 20 + number)
    chosen = scene.rng.sample(ACCIDENTS, scene.rng.randint(1, 4))
    chosen.sort(key=lambda accident: _ORDER.get(accident, 0))
    night = scene.rng.choice(NIGHTS)
    names = [accident.__name__ for accident in chosen]
    wrong: list[str] = []
    ended = Ended(-1, "")
    try:
        with ExitStack() as stack:
            for accident in chosen:
                stack.enter_context(accident(scene))
            ended = night(scene)
            wrong += judge(ended)
            published = scene.lab.database.exists() and "damaged_database" not in names
            if published and not {"linked_folder", "closed_files"} & set(names):
                wrong += [finding for finding in healthy(scene.lab) if finding.startswith("all of the database")]
    except RuntimeError as error:
        wrong.append(str(error))
    return Night(number, (night.__name__, *names), ended.status, tuple(wrong))


def judge(ended: Ended) -> Iterator[str]:
    """What is wrong with how a night ended: words of Python, no reason, a status that is none."""
    if "Traceback" in ended.told:
        yield f"a traceback: {ended.told[-400:]}"
    if ended.by_us and ended.status in (-signal.SIGKILL, -signal.SIGHUP, -signal.SIGINT, -signal.SIGTERM, _INTERRUPTED):
        return
    if ended.status not in (0, 1, 3, 4):
        yield f"ended with {ended.status}: {ended.told[-300:]}"
    if ended.status and not ended.told.strip():
        yield f"ended with {ended.status} without a word"


def soak(bench: Bench, nights: int, seed: int, tell: Callable[[Night], None] = lambda _: None) -> list[Night]:
    """The nights, and the one after them, whose lab is held against that of a single night."""
    scene = Scene(bench, Lab(bench.folder / "soaked"), bench.folder / "outside", random.Random(seed))
    scene.outside.mkdir()
    spent = []
    for number in range(1, nights + 1):
        spent.append(spend_night(scene, number))
        tell(spent[-1])
    for file in scene.raw.glob("*.mcap"):
        os.utime(file, (time.time() - 3600,) * 2)
    wrong: list[str] = []
    again = bench.run(scene.lab)
    if again.returncode:
        wrong.append(f"the quiet night ended with {again.returncode}: {again.stderr[-600:]}")
    bench.undisturbed = Lab(bench.folder / "of one night")
    bench.undisturbed.create()
    if scene.lab.annotations.exists():
        shutil.copy(scene.lab.annotations, bench.undisturbed.annotations)
    single = bench.run(bench.undisturbed)
    if single.returncode:
        wrong.append(f"the single night ended with {single.returncode}: {single.stderr[-300:]}")
    forget_last_copies(scene.lab)
    wrong += bench.differences(scene.lab, "after all nights")
    spent.append(Night(nights + 1, ("none",), again.returncode, tuple(wrong)))
    tell(spent[-1])
    return spent


def forget_last_copies(lab: Lab) -> None:
    """Removes what `dealab doctor` leaves to people: refused files that are gone, of a database that was moved away since.

    A night keeps these copies, for they may be the last. Those of files that are there it has to remove itself.
    """
    with duckdb.connect(str(lab.database), read_only=True) as connection:
        refused = connection.execute("SELECT source_path FROM recordings WHERE status = 'quarantined'").fetchall()
    named = {entry_name(path) for (path,) in refused}
    for entry in entries(lab.folder):
        if entry.folder.name not in named and not Path(entry.reason["source_path"]).exists():
            shutil.rmtree(entry.folder)


HEAD = "| night | what happened to it | exit status | what was wrong |\n|---:|---|---:|---|"


def row(night: Night) -> str:
    """A line of the table."""
    what = ", ".join(name.replace("_", " ") for name in night.accidents)
    return f"| {night.number} | {what} | {night.ended} | {len(night.wrong) or 'nothing'} |"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--nights", type=int, default=30)
    parser.add_argument("--seed", type=int, default=time.time_ns() % 1_000_000_007, help="drawn from the clock")
    arguments = parser.parse_args()
    lines = ["# Soak\n", "Made by `make faults`; not edited by hand. The last night has no accident: its lab is held"]
    lines += ["against that of a single night over the same files.\n"]
    lines += [f"{today()} · {machine()} · seed {arguments.seed}\n", HEAD]
    print(lines[-2], HEAD, sep="\n", flush=True)

    def tell(night: Night) -> None:
        print(row(night), *night.wrong, sep="\n", flush=True)

    with tempfile.TemporaryDirectory() as name:
        spent = soak(Bench(Path(name), chirps=0), arguments.nights, arguments.seed, tell)
    wrong = [f"- night {night.number}: {one}" for night in spent for one in night.wrong]
    text = "\n".join([*lines, *map(row, spent), "", *wrong]).rstrip() + "\n"
    (HERE / "soak.md").write_text(text, encoding="utf-8")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
