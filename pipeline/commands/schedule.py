"""`dealab schedule`: unit and timer for systemd, or a line for cron, with this installation's own paths.

Does not belong here: installing them, which is the administrator's.
"""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from pipeline.commands.command import CLUSTER, DONE, LAB, RAW, RIGS, Command, argument, parse_jobs, parse_path
from schemas.errors import UsageError
from schemas.visible import shown

if TYPE_CHECKING:
    from pathlib import Path

NAME = "dealab-nightly"
_OF_USER = "~/.config/systemd/user"


def find_executable() -> Path:
    """The `dealab` beside the Python that runs this."""
    import shutil
    from pathlib import Path

    beside = Path(sys.executable).with_name("dealab")
    found = beside if beside.exists() else shutil.which("dealab")
    return Path(found or "dealab").absolute()


class Job(NamedTuple):
    """What is to run every night: raw files, folders and URLs, the lab, and the options that the nightly is given."""

    raw: Sequence[str]
    lab: Path
    rigs: Path | None = None
    jobs: int | None = None
    cluster: str | None = None

    def missing(self) -> list[str]:
        """Raw files and folders that are not there."""
        from ingest.remote import is_url

        return [given for given in self.raw if not is_url(given) and not os.path.exists(given)]

    @property
    def words(self) -> list[str]:
        """The command, every path absolute: neither cron nor systemd starts in the folder that was meant."""
        from pathlib import Path

        from ingest.remote import is_url

        raw = [given if is_url(given) else str(Path(given).absolute()) for given in self.raw]
        options = {
            "--lab": str(self.lab.absolute()),
            "--rigs": None if self.rigs is None else str(self.rigs.absolute()),
            "--jobs": None if self.jobs is None else str(self.jobs),
            "--cluster": self.cluster,
        }
        given = [word for name, value in options.items() if value is not None for word in (name, value)]
        return [str(find_executable()), "nightly", *raw, *given]


def parse_clock(text: str) -> tuple[int, int]:
    """Hour and minute of `02:30`. Raises `UsageError`."""
    hour, _, minute = text.partition(":")
    if not (hour.isdecimal() and minute.isdecimal() and int(hour) < 24 and int(minute) < 60):
        raise UsageError(f'"{text}" is no time of day', expected="hours and minutes, as in 02:30")
    return int(hour), int(minute)


def write_units(job: Job, at: str) -> dict[str, str]:
    """The unit and its timer by file name."""
    hour, minute = parse_clock(at)
    start = " ".join(_quote_for_systemd(word) for word in job.words)
    service = f"""# Statuses 3 and 4: the night is done, the unit did not fail; recordings were refused
# or are damaged (3), or led to no result (4).
[Unit]
Description=dealab: the night over the laboratory's recordings

[Service]
Type=oneshot
ExecStart={start}
SuccessExitStatus=3 4
Nice=10
IOSchedulingClass=idle
NoNewPrivileges=yes
TimeoutStartSec=infinity
"""
    timer = f"""[Unit]
Description=dealab: every night at {hour:02d}:{minute:02d}

[Timer]
OnCalendar=*-*-* {hour:02d}:{minute:02d}:00
Persistent=true

[Install]
WantedBy=timers.target
"""
    return {f"{NAME}.service": service, f"{NAME}.timer": timer}


def _quote_for_systemd(word: str) -> str:
    """A word of ExecStart: specifiers and variables doubled, quoted where it has more than plain characters."""
    doubled = word.replace("%", "%%").replace("$", "$$")
    if all(c.isalnum() or c in "/._-+=@%$" for c in doubled):
        return doubled
    escaped = doubled.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'


def write_crontab(job: Job, at: str) -> str:
    """Lines for `crontab -e`: the summary goes out as mail, progress and complaints to a file in the lab.

    The shell opens that file before the nightly runs, which makes the lab.
    """
    import shlex

    hour, minute = parse_clock(at)
    lab = job.lab.absolute()
    log = shlex.quote(str(lab / "nightly.log"))
    line = f"mkdir -p {shlex.quote(str(lab))} && {shlex.join(job.words)} 2>> {log}".replace("%", "\\%")
    return (
        f"# What the night printed, a paragraph, cron mails to you; refused and damaged recordings are named in {log}\n"
        f"{minute} {hour} * * * {line}\n"
    )


def tell_next(folder: Path) -> list[str]:
    """What to type for systemd to start the units of a folder: as the system from one of its own, else the user."""
    import shlex

    folder = folder.absolute()
    if folder.parts[-2:] == ("systemd", "system"):
        return ["sudo systemctl daemon-reload", f"sudo systemctl enable --now {NAME}.timer"]
    if folder.parts[-2:] == ("systemd", "user"):
        known = "systemctl --user daemon-reload"
    else:
        known = "systemctl --user link " + shlex.join(str(folder / f"{NAME}.{kind}") for kind in ("service", "timer"))
    return [
        known,
        f"systemctl --user enable --now {NAME}.timer",
        'loginctl enable-linger "$USER"  # so that it runs while nobody is logged in',
    ]


def _spell(job: Job, at: str, *options: str) -> str:
    """This command again, with absolute paths; `~` stays for the shell."""
    import shlex

    program, _, *given = job.words
    return " ".join([shlex.join([program, "schedule", *given, "--at", at]), *options])


def run(arguments: Namespace) -> int:
    from pathlib import Path

    job = Job(arguments.raw, arguments.lab, arguments.rigs, arguments.jobs, arguments.cluster)
    for path in job.missing():
        print(f"dealab: {shown(path)} is not there now: no night is done without it", file=sys.stderr)
    if arguments.cron:
        print(write_crontab(job, arguments.at), end="")
        print(f"# To turn it on:\n# (crontab -l 2>/dev/null; {_spell(job, arguments.at, '--cron')}) | crontab -")
        return DONE
    for name, text in write_units(job, arguments.at).items():
        if arguments.out is None:
            print(f"# {name}\n{text}")
        else:
            arguments.out.mkdir(parents=True, exist_ok=True)
            (arguments.out / name).write_text(text, encoding="utf-8")
            print(arguments.out / name)
    if arguments.out is None:
        typed = [_spell(job, arguments.at, "--out", _OF_USER), *tell_next(Path(_OF_USER))]
        print("\n".join(["# To turn it on:", *(f"# {line}" for line in typed)]))
    else:
        print("\n".join(["To turn it on:", *tell_next(arguments.out)]))
    return DONE


COMMAND = Command(
    (
        "/data/raw --lab /data/lab --at 02:30 --out ~/.config/systemd/user",
        "/data/raw --lab /data/lab --cron",
    ),
    (
        RAW,
        argument("--at", default="02:00", metavar="HH:MM", help="when, local time (default 02:00)"),
        argument("--cron", action="store_true", help="a line for crontab instead of units for systemd"),
        argument("--out", type=parse_path, metavar="FOLDER", help="write the units there instead of showing them"),
        argument("--jobs", type=parse_jobs, help="worker processes of the nightly (default: one per processor)"),
        RIGS,
        CLUSTER,
        LAB,
    ),
    run,
)
