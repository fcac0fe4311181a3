"""Checks of a lab: each a line that says it is well, or what is wrong and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

from ingest.quarantine import entries as quarantine_entries
from ingest.quarantine import entry_name
from pipeline.lab.annotations import find_broken_lines
from pipeline.lab.checks import find_damage, find_edits, find_violations
from pipeline.lab.installation import Finding, tell
from pipeline.lab.lab import Lab
from pipeline.lab.lock import is_busy
from pipeline.lab.settings import load_settings
from schemas.database import REBUILD, connect
from schemas.errors import DealabError
from schemas.views import fingerprint

_LISTED = 5


def check_lab(lab: Lab) -> Iterator[Finding]:
    """Is the lab whole? Reads all of the database and all samples, and compares the checksums of both."""
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
        damage = list(find_damage(partial(connect, lab.database)))
        yield tell("all of the database can be read", damage, REBUILD[0].lower() + REBUILD[1:])
        if damage:
            return
        with connect(lab.database) as connection:
            found = connection.execute("SELECT value FROM lab WHERE key = 'schema'").fetchone()
            current = found is not None and found[0] == fingerprint()
            yield Finding(
                "the database has today's tables",
                None if current else "it is another release's; the next nightly brings it up to date",
            )
            if current:
                edits = list(find_edits(connection))
                yield tell("nobody has edited the database", edits, REBUILD[0].lower() + REBUILD[1:])
                if edits:
                    return
                yield tell("what must hold in the database holds", list(find_violations(connection)), "report this")
            rows = connection.execute(
                "SELECT recording_id, samples_path, source_sha256, source_path, status FROM recordings"
            ).fetchall()
    except duckdb.Error as error:
        yield Finding(
            "the database can be read",
            f"{str(error).splitlines()[0]}; {REBUILD[0].lower()}{REBUILD[1:]}",
        )
        return
    yield from _check_samples(lab, rows)
    named = {entry_name(row[3]) for row in rows if row[4] == "quarantined"}
    stray = [entry.folder.name for entry in quarantine_entries(lab.folder) if entry.folder.name not in named]
    yield tell("quarantine holds what the database says", stray, "no row speaks of them; remove them when not needed")


def _check_samples(lab: Lab, rows: list[tuple[Any, ...]]) -> Iterator[Finding]:
    named = {row[1]: (row[0], row[2]) for row in rows if row[1] is not None}
    wrong = [
        f"{path} ({reason})" for path, known in sorted(named.items()) if (reason := _find_fault(lab, path, *known))
    ]
    yield tell("samples of all recordings are there", wrong, "remove them and run the nightly over the raw files again")
    found = {path.relative_to(lab.folder).as_posix() for path in lab.samples_folder.rglob("*.parquet")}
    yield tell("no samples without a recording", sorted(found - named.keys()), "remove them when not needed")


def _find_fault(lab: Lab, relative: str, recording_id: str, sha256: str) -> str | None:
    """What is wrong with a samples file, None when nothing is."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with (lab.folder / relative).open("rb") as file:
            found = pq.ParquetFile(file, page_checksum_verification=True)
            about = found.schema_arrow.metadata or {}
            for group in range(found.num_row_groups):  # all of one after the other: no more memory than a group takes
                found.read_row_group(group)
    except FileNotFoundError:
        return "missing"
    except (OSError, pa.ArrowException) as error:
        return f"unreadable: {str(error).splitlines()[0]}"
    if about.get(b"dealab.recording_id") != recording_id.encode():
        return "of another recording"
    if about.get(b"dealab.source_sha256") != sha256.encode():
        return "made from another file"
    return None


def _check_leftovers(lab: Lab) -> Finding:
    if is_busy(lab):
        return Finding("no temporary files are left (a nightly is at work)")
    left = [path for pattern in ("*.tmp", ".partial-*") for path in lab.folder.rglob(pattern)]
    if lab.work.exists():
        left.append(lab.work)
    return tell(
        "no temporary files are left",
        [path.relative_to(lab.folder).as_posix() for path in left],
        "the next nightly takes up or removes what a killed one left",
    )
