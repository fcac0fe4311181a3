"""What is in a lab, in words: the last run, what was refused and why, what has gone, and what is no longer fresh."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from pipeline.commands.show import safe
from pipeline.lab.annotations import Annotation, excluded, read_annotations
from pipeline.lab.journal import Freshness
from pipeline.lab.lab import Lab
from pipeline.lab.lock import busy, holder
from pipeline.lab.manifest import KnownRecording, Manifest, SeenFile
from pipeline.lab.manifest import load as load_manifest
from pipeline.lab.reader import Reader
from pipeline.lab.settings import load as load_settings
from pipeline.nightly.stages import STAGES

_ATTENTION = ("quarantined", "damaged", "pending")


def status(lab: Lab) -> str:
    """The state of a lab. Raises `LabError` where there is none."""
    lab.require_database()
    manifest = load_manifest(lab)
    with Reader(lab.database) as reader:
        runs = reader.rows("runs")
        published = len(reader.rows("annotations", ("recording_id",)))
    annotations = read_annotations(lab)
    lines = [f"Lab {lab.folder}"]
    if busy(lab):
        lines.append(f"A nightly is at work: {holder(lab)}.")
    lines += _last_run(runs)
    lines += _contents(manifest, annotations)
    for title, found in (
        ("Needs attention", _attention(manifest)),
        ("Out of the analysis", _exclusions(annotations, published)),
        ("The file has gone, the results stay", _gone(manifest)),
        ("Not fresh, made again by the next nightly over its files", _stale(lab, manifest)),
    ):
        listed = list(found)
        if listed:
            lines += ["", f"{title}:", *(f"  {line}" for line in listed)]
    return safe("\n".join(lines))


def _last_run(runs: Sequence[dict[str, Any]]) -> Iterator[str]:
    if not runs:
        yield "No run yet."
        return
    last = runs[-1]
    yield (
        f"Last run {last['run_id']}, {last['finished_at']:%Y-%m-%d %H:%M:%S} UTC, dealab {last['software_version']}: "
        f"{last['found']} files found, {last['ingested']} taken in, {last['reused']} unchanged, "
        f"{last['quarantined']} refused, {last['damaged']} damaged, {last['failed']} analyses failed."
    )
    for note in json.loads(last["notes"] or "[]"):
        yield f"  {note}"


def _contents(manifest: Manifest, annotations: Sequence[Annotation]) -> Iterator[str]:
    out = excluded(annotations)
    counted = Counter(_now(row, out) for row in manifest.recordings)
    numbers = ", ".join(f"{number} {name}" for name, number in sorted(counted.items()))
    specimens = {row.specimen_id for row in manifest.recordings if row.specimen_id and _now(row, out) != "quarantined"}
    yield f"Recordings: {numbers or 'none'}; {len(specimens)} specimens."


def _now(row: KnownRecording, out: frozenset[str]) -> str:
    """The status that a row has with the exclusions of this moment."""
    if row.status in ("ok", "damaged") and row.recording_id in out:
        return "excluded"
    if row.status == "excluded" and row.recording_id not in out:
        return "ok"
    return row.status


def _attention(manifest: Manifest) -> Iterator[str]:
    for row in manifest.recordings:
        if row.status in _ATTENTION:
            gone = "" if row.source_present else " (the file has gone)"
            yield f"{row.status}: {row.source_path}{gone}: {row.problem}"
    for item in manifest.items.values():
        if item.outcome == "failed":
            yield f"failed: {item.item_id}: {(item.error or 'no reason given').splitlines()[0]}"


def _exclusions(annotations: Sequence[Annotation], published: int) -> Iterator[str]:
    out = excluded(annotations)
    last = {one.recording_id: one for one in annotations}
    for name in sorted(out):
        yield f"{name}: {last[name].why} ({last[name].author}, {last[name].at[:16]})"
    if len(annotations) > published:
        yield f"{len(annotations) - published} of these words reach the results with the next nightly"


def _gone(manifest: Manifest) -> Iterator[str]:
    for row in manifest.recordings:
        if row.source_present is False:
            yield f"{row.recording_id or 'no id'}: {row.source_path}"


def _stale(lab: Lab, manifest: Manifest) -> Iterator[str]:
    """Results whose code, settings or raw file is not what they were made from."""
    settings = load_settings(lab)
    found: Counter[tuple[str, str]] = Counter()
    for item in manifest.items.values():
        if item.stage in STAGES:
            now = Freshness(item.freshness.input_hash, *STAGES[item.stage].version(settings))
            found.update((item.stage, what) for what in item.freshness.differences(now))
    for (stage, what), number in sorted(found.items()):
        yield f"{number} {stage} result{'' if number == 1 else 's'}: made with other {what}"
    for path, seen in sorted(manifest.files.items()):
        if _changed(path, seen):
            yield f"{path}: other input, the file has changed since it was read"


def _changed(path: str, seen: SeenFile) -> bool:
    try:
        now = os.stat(path)
    except OSError:
        return False
    return (now.st_size, now.st_mtime_ns, now.st_ino) != (seen.size, seen.mtime_ns, seen.inode)
