"""Checks of the installation and of a lab: each a line that says it is well, or what is wrong and what to do."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from ingest.formats import find_plugins
from ingest.quarantine import entries as quarantine_entries
from ingest.quarantine import entry_name
from pipeline.lab.annotations import find_broken_lines
from pipeline.lab.checks import find_violations
from pipeline.lab.lab import Lab
from pipeline.lab.lock import is_busy
from pipeline.lab.settings import load_settings
from schemas.errors import DealabError
from schemas.views import fingerprint

PACKAGES = ("schemas", "ingest", "pipeline", "reports")
_LISTED = 5


@dataclass(frozen=True)
class Finding:
    """The result of one check; `problem` is None where all is well."""

    check: str
    problem: str | None = None

    def __str__(self) -> str:
        return f"ok       {self.check}" if self.problem is None else f"PROBLEM  {self.check}: {self.problem}"


def check_installation() -> Iterator[Finding]:
    """Is this the software it should be?"""
    root = Path(__file__).resolve().parents[2]
    for name in PACKAGES:
        spec = importlib.util.find_spec(name)
        origin = None if spec is None or spec.origin is None else Path(spec.origin).resolve()
        foreign = origin is None or origin.parent.parent != root
        yield Finding(
            f"package {name} is ours",
            f"Python finds {origin} under that name; use an environment of its own for dealab" if foreign else None,
        )
    required = f"{sys.version_info.major}.{sys.version_info.minor}"
    yield Finding(f"Python {required}", None if sys.version_info >= (3, 11) else "Python 3.11 or newer is needed")
    missing = _list_missing_libraries()
    yield _tell("required libraries are installed", missing, f"`pip install {' '.join(missing)}` where dealab is installed")
    plugins = find_plugins().values()
    yield _tell(
        "readers of other packages can be used",
        [f"{plugin.name} of {plugin.origin}: {plugin.trouble}" for plugin in plugins if plugin.trouble],
        "mend or remove that package",
    )


def check_lab(lab: Lab) -> Iterator[Finding]:
    """Is the lab whole? Reads every samples file's footer, no samples."""
    yield from _check_readable(lab)
    journal = lab.database.with_name(lab.database.name + ".wal")
    yield Finding(
        "nobody writes to the published database",
        f"{journal} exists; close the program that opened it for writing" if journal.exists() else None,
    )
    if not lab.database.is_file():
        yield Finding("a database is published", f"there is none; run {lab.spell_command('nightly RAW')}")
        return
    yield from _check_database(lab)
    yield _check_leftovers(lab)


def _check_readable(lab: Lab) -> Iterator[Finding]:
    for what, check in (("settings", load_settings), ("annotations", find_broken_lines)):
        try:
            broken = check(lab)
        except DealabError as error:
            yield Finding(f"{what} can be read", str(error))
        else:
            yield Finding(
                f"{what} can be read", ("; ".join(broken[:_LISTED]) or None) if isinstance(broken, tuple) else None
            )


def _check_database(lab: Lab) -> Iterator[Finding]:
    import duckdb

    try:
        with duckdb.connect(str(lab.database), read_only=True) as connection:
            found = connection.execute("SELECT value FROM lab WHERE key = 'schema'").fetchone()
            current = found is not None and found[0] == fingerprint()
            yield Finding(
                "the database has today's tables",
                None if current else "it is another release's; the next nightly brings it up to date",
            )
            if current:
                yield _tell("what must hold in the database holds", list(find_violations(connection)), "report this")
            rows = connection.execute(
                "SELECT recording_id, samples_path, source_sha256, source_path, status FROM recordings"
            ).fetchall()
    except duckdb.Error as error:
        yield Finding(
            "the database can be read",
            f"{str(error).splitlines()[0]}; move it away, the next nightly over all raw folders builds it anew",
        )
        return
    yield from _check_samples(lab, rows)
    named = {entry_name(row[3]) for row in rows if row[4] == "quarantined"}
    stray = [entry.folder.name for entry in quarantine_entries(lab.folder) if entry.folder.name not in named]
    yield _tell("quarantine holds what the database says", stray, "no row speaks of them; remove them when not needed")


def _check_samples(lab: Lab, rows: list[tuple[Any, ...]]) -> Iterator[Finding]:
    named = {row[1]: (row[0], row[2]) for row in rows if row[1] is not None}
    wrong = [
        f"{path} ({reason})" for path, known in sorted(named.items()) if (reason := _find_fault(lab, path, *known))
    ]
    yield _tell(
        "samples of all recordings are there", wrong, "remove them and run the nightly over the raw files again"
    )
    found = {path.relative_to(lab.folder).as_posix() for path in lab.samples_folder.rglob("*.parquet")}
    yield _tell("no samples without a recording", sorted(found - named.keys()), "remove them when not needed")


def _find_fault(lab: Lab, relative: str, recording_id: str, sha256: str) -> str | None:
    """What is wrong with a samples file, None when nothing is."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with (lab.folder / relative).open("rb") as file:
            about = pq.ParquetFile(file).schema_arrow.metadata or {}
    except FileNotFoundError:
        return "missing"
    except (OSError, pa.ArrowException) as error:
        return f"unreadable: {str(error).splitlines()[0]}"
    if about.get(b"dealab.recording_id", b"").decode() != recording_id:
        return "of another recording"
    if about.get(b"dealab.source_sha256", b"").decode() != sha256:
        return "made from another file"
    return None


def _check_leftovers(lab: Lab) -> Finding:
    if is_busy(lab):
        return Finding("no temporary files are left (a nightly is at work)")
    left = [path for pattern in ("*.tmp", ".partial-*") for path in lab.folder.rglob(pattern)]
    if lab.work.exists():
        left.append(lab.work)
    return _tell(
        "no temporary files are left",
        [path.relative_to(lab.folder).as_posix() for path in left],
        "the next nightly takes up or removes what a killed one left",
    )


def _list_missing_libraries() -> list[str]:
    missing = []
    for requirement in metadata.requires("dealab") or []:
        name = requirement.split(";")[0].strip()
        for separator in (">", "=", "<", "!", "~", "[", " "):
            name = name.split(separator)[0]
        if ";" in requirement:
            continue
        try:
            metadata.version(name)
        except metadata.PackageNotFoundError:
            missing.append(name)
    return missing


def _tell(check: str, wrong: list[str], remedy: str) -> Finding:
    if not wrong:
        return Finding(check)
    shown = ", ".join(wrong[:_LISTED]) + (f" and {len(wrong) - _LISTED} more" if len(wrong) > _LISTED else "")
    return Finding(check, f"{shown}; {remedy}")
