"""What is in a lab, in words: the last run, what was refused and why, what has gone, and what is no longer fresh.

Rows are taken one by one, so that the memory that this takes does not grow with the number of recordings.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from pipeline.lab.annotations import Annotation, find_broken_lines, list_excluded, read_annotations
from pipeline.lab.journal import Freshness
from pipeline.lab.lab import Lab
from pipeline.lab.lock import describe_holder, is_busy
from pipeline.lab.reader import Reader
from pipeline.lab.settings import load_settings
from pipeline.nightly.stages import STAGES
from schemas.visible import make_safe

Row = dict[str, Any]

_NAMED_EACH = 10
"""How many recordings are named for each reason why there is no result; the table has all of them."""


def describe_lab(lab: Lab) -> str:
    """The state of a lab. Raises `LabError` where there is none."""
    lab.require_database()
    annotations = read_annotations(lab)
    lines = [f"Lab {lab.folder}"]
    if is_busy(lab):
        lines.append(f"A nightly is at work: {describe_holder(lab)}.")
    with Reader(lab.database) as reader:
        published = len(reader.rows("annotations", ("recording_id",)))
        lines += _describe_last_run(reader.rows("runs"))
        lines += _count_recordings(reader, list_excluded(annotations))
        for title, found in (
            ("Needs attention", [*find_broken_lines(lab), *_list_attention(reader)]),
            ("No result from", _list_without_result(lab, reader)),
            ("Without a model", _list_without_model(lab, reader)),
            ("Out of the analysis", _list_exclusions(annotations, published)),
            ("The file has gone, the results stay", _list_gone(reader)),
            ("Not fresh, made again by the next nightly over its files", _list_stale(lab, reader)),
        ):
            listed = list(found)
            if listed:
                lines += ["", f"{title}:", *(f"  {line}" for line in listed)]
    return make_safe("\n".join(lines))


def _describe_last_run(runs: Sequence[Row]) -> Iterator[str]:
    if not runs:
        yield "No run yet."
        return
    last = runs[-1]
    files = "file" if last["found"] == 1 else "files"
    yield (
        f"Last run {last['run_id']}, {last['finished_at']:%Y-%m-%d %H:%M:%S} UTC, dealab {last['software_version']}: "
        f"{last['found']} {files} found, {last['ingested']} taken in, {last['reused']} unchanged, "
        f"{last['quarantined']} refused, {last['damaged']} damaged, {last['failed']} analyses failed."
    )
    for note in json.loads(last["notes"] or "[]"):
        yield f"  {note}"


def _count_recordings(reader: Reader, out: frozenset[str]) -> Iterator[str]:
    counted: Counter[str] = Counter()
    specimens = set()
    for row in reader.each("recordings", ("recording_id", "specimen_id", "status")):
        status = _find_status(row, out)
        counted[status] += 1
        if row["specimen_id"] and status != "quarantined":
            specimens.add(row["specimen_id"])
    numbers = ", ".join(f"{number} {name}" for name, number in sorted(counted.items()))
    yield f"Recordings: {numbers or 'none'}; {len(specimens)} specimens."


def _find_status(row: Row, out: frozenset[str]) -> str:
    """The status that a row has with the exclusions of this moment."""
    status: str = row["status"]
    if status in ("ok", "damaged") and row["recording_id"] in out:
        return "excluded"
    if status == "excluded" and row["recording_id"] not in out:
        return "ok"
    return status


def _list_attention(reader: Reader) -> Iterator[str]:
    columns = ("status", "source_path", "source_present", "problem")
    for row in reader.rows("recordings", columns, where="status IN ('quarantined', 'damaged', 'pending')"):
        gone = "" if row["source_present"] else " (the file has gone)"
        yield f"{row['status']}: {row['source_path']}{gone}: {row['problem']}"
    for row in reader.rows("items", ("item_id", "error"), where="outcome = 'failed'"):
        yield f"failed: {row['item_id']}: {(row['error'] or 'no reason given').splitlines()[0]}"
    yield from reader.list_rigs_without_constants()


def _list_without_result(lab: Lab, reader: Reader) -> Iterator[str]:
    """What was taken in and led to nothing, by reason; refused files need attention, and stand there."""
    named = (
        (
            f"{row['recording_id']}: {row['source_path']}",
            row["what_was_missing"].replace(f"{row['recording_id']}: ", ""),
        )
        for row in reader.each("without_result", ("recording_id", "status", "source_path", "what_was_missing"))
        if row["status"] != "quarantined"
    )
    yield from _name_some(named, lab.spell_command('sql "SELECT * FROM without_result"'))


def _list_without_model(lab: Lab, reader: Reader) -> Iterator[str]:
    """Specimens that have results and no model, by what their models lacked."""
    listing = lab.spell_command("sql \"SELECT * FROM needs_attention WHERE what = 'specimen'\"")
    yield from _name_some(reader.list_specimens_without_model(), listing)


def _name_some(named: Iterable[tuple[str, str]], listing: str) -> Iterator[str]:
    """Names with their reasons, of each reason the first ones alone; `listing` is the command that lists them all."""
    found: dict[str, list[str]] = {}
    more: Counter[str] = Counter()
    for name, why in named:
        some = found.setdefault(why, [])
        if len(some) < _NAMED_EACH:
            some.append(name)
        else:
            more[why] += 1
    for why, some in found.items():
        yield from (f"{one}: {why}" for one in some)
        if more[why]:
            yield f"and {more[why]} more: {why} ({listing} lists them)"


def _list_exclusions(annotations: Sequence[Annotation], published: int) -> Iterator[str]:
    out = list_excluded(annotations)
    last = {one.recording_id: one for one in annotations}
    for name in sorted(out):
        yield f"{name}: {last[name].why} ({last[name].author}, {last[name].at[:16]})"
    if len(annotations) > published:
        yield f"{len(annotations) - published} of these words reach the results with the next nightly"


def _list_gone(reader: Reader) -> Iterator[str]:
    for row in reader.each("recordings", ("recording_id", "source_path", "source_present")):
        if row["source_present"] is False:
            yield f"{row['recording_id'] or 'no id'}: {row['source_path']}"


def _list_stale(lab: Lab, reader: Reader) -> Iterator[str]:
    """Results whose code, settings or raw file is not what they were made from."""
    settings = load_settings(lab)
    versions = {name: stage.version(settings) for name, stage in STAGES.items()}
    found: Counter[tuple[str, str]] = Counter()
    for row in reader.each("items", ("stage", "input_hash", "code_version", "settings_hash")):
        if row["stage"] in versions:
            made_from = Freshness(row["input_hash"], row["code_version"], row["settings_hash"])
            now = Freshness(row["input_hash"], *versions[row["stage"]])
            found.update((row["stage"], what) for what in made_from.differences(now))
    for (stage, what), number in sorted(found.items()):
        yield f"{number} {stage} result{'' if number == 1 else 's'}: made with other {what}"
    changed = (row["path"] for row in reader.each("files", ("path", "size", "mtime_ns", "inode")) if _has_changed(row))
    for path in sorted(changed):
        yield f"{path}: other input, the file has changed since it was read"


def _has_changed(seen: Row) -> bool:
    """Whether a raw file is another than when it was hashed; one that has gone is told elsewhere."""
    try:
        now = os.stat(seen["path"])
    except OSError:
        return False
    return (now.st_size, now.st_mtime_ns, now.st_ino) != (seen["size"], seen["mtime_ns"], seen["inode"])
