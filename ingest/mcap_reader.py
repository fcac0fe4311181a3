"""MCAP files as raw recordings: the native format of packed sample blocks, and one message per sample by a mapping.

Does not belong here: the file's layout and its damage (ingest.mcap_scan), units, plausibility and required channels
(ingest.canonical).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ingest.assemble import assemble
from ingest.mapping import FileMapping
from ingest.mcap_blocks import SCHEMA_NAME, BlockCollector, is_block_schema
from ingest.mcap_messages import MessageColumns
from ingest.mcap_records import Channel, Schema
from ingest.mcap_scan import Scan, scan
from schemas.arrays import Int
from schemas.errors import RefusedError, UnmappedError
from schemas.recording import RawChannel, RawRecording

_METADATA = ("recording", "rig", "writer")


def read_mcap(path: Path, mapping: FileMapping | None = None) -> RawRecording:
    """The recording in an MCAP file.

    Without a mapping, or with one that maps no columns, the channels are those whose schema is `dealab.SampleBlock`.
    With one, each quantity is read from the topic (`column`) and, for one message per sample, the `field` it names.
    What the mapping says in `recording` and `rig` goes before what the file says.

    Channels of the native format come ascending in time; those with the same time base share one `time_ns` array.
    What is lost or wrong is in `problems`.

    Raises `RefusedError` when nothing is usable (no MCAP file, no samples) and `UnmappedError` when there are messages
    but none that can be read without a mapping.
    """
    if mapping is not None and mapping.columns:
        return _mapped(path, mapping)
    return _native(path, mapping)


@dataclass(frozen=True)
class _Stream:
    """A topic of sample blocks."""

    channel: Channel
    blocks: BlockCollector


def _native(path: Path, mapping: FileMapping | None) -> RawRecording:
    streams: dict[str, _Stream] = {}
    others: dict[str, str] = {}
    contradictions: list[str] = []

    def choose(channel: Channel, schema: Schema | None) -> BlockCollector | None:
        if not is_block_schema(channel, schema):
            others[channel.topic] = f"{channel.message_encoding[:40]}, {schema.name[:80] if schema else 'no schema'}"
            return None
        stream = streams.setdefault(channel.topic, _Stream(channel, BlockCollector()))
        if stream.channel.metadata != channel.metadata:
            contradictions.append(f"{channel.topic}: two channels of this name differ in metadata; the first is used")
            return None
        return stream.blocks

    found = scan(path, choose, _METADATA)
    known_times: dict[tuple[bytes, bytes, bytes], Int] = {}
    channels, problems, notes = [], [*found.problems, *contradictions], [*found.notes, *_aborted(found)]
    for topic, stream in streams.items():
        quantity = topic.removeprefix("/")
        samples = stream.blocks.samples(known_times)
        problems += [f"{quantity[:80]}: {problem}" for problem in samples.problems]
        notes += [f"{quantity[:80]}: {note}" for note in samples.notes]
        if samples.values.size:
            metadata = dict(stream.channel.metadata)
            unit = metadata.pop("unit", "")
            channels.append(RawChannel(quantity, unit, samples.time_ns, samples.values, metadata))
    if others:
        shown = "; ".join(f"{topic[:80]} ({what})" for topic, what in list(others.items())[:20])
        notes.append(f"topics without sample blocks, left out: {shown}")
    if not channels:
        raise _nothing(path, problems, others if not streams else {})
    recording, rig = _merged(found, mapping)
    return RawRecording(recording, rig, tuple(channels), tuple(problems), tuple(notes))


def _mapped(path: Path, mapping: FileMapping) -> RawRecording:
    columns = MessageColumns(mapping, path.name)
    found = scan(path, columns.choose, _METADATA)
    if not found.message_count:
        raise _nothing(path, found.problems, {})
    if mapping.counts_rows_as_time and found.lost_before(columns.last_ns):
        raise RefusedError(
            "messages were lost with damaged chunks, and the mapping counts messages as time: all later ones would be early",
            where=path.name,
            expected="times in the file",
            remedy="Leave sample_rate_hz out of the mapping TOML: the log times of the messages are used then",
        )
    recording, rig = _merged(found, mapping)
    raw = assemble(columns, dataclasses.replace(columns.mapping, recording=recording, rig=rig), where=path.name)
    # the columns' own problems are complete only now that all have been read
    return dataclasses.replace(
        raw,
        problems=tuple(dict.fromkeys((*found.problems, *columns.problems, *raw.problems))),
        notes=tuple(dict.fromkeys((*found.notes, *_aborted(found), *columns.notes, *raw.notes))),
    )


def _merged(found: Scan, mapping: FileMapping | None) -> tuple[dict[str, Any], dict[str, Any]]:
    said: tuple[Mapping[str, Any], Mapping[str, Any]] = ({}, {})
    if mapping is not None:
        said = mapping.recording, mapping.rig
    return {**found.metadata.get("recording", {}), **said[0]}, {**found.metadata.get("rig", {}), **said[1]}


def _aborted(found: Scan) -> list[str]:
    reason = found.metadata.get("writer", {}).get("aborted")
    return [] if reason is None else [f"the recording was ended early: {reason[:200]}"]


def _nothing(path: Path, problems: list[str], others: Mapping[str, str]) -> RefusedError | UnmappedError:
    if others and not problems:
        topics = ", ".join(f"{topic[:80]} ({what})" for topic, what in list(others.items())[:20])
        return UnmappedError(
            f"no channel has the schema {SCHEMA_NAME}; there are {topics}",
            where=path.name,
            remedy="Map the topics with a TOML beside the file: `dealab add FILE` writes one",
        )
    because = f" ({'; '.join(problems[:5])})" if problems else ""
    return RefusedError(
        f"the file has no usable samples{because}",
        where=path.name,
        expected=f"at least one channel with {SCHEMA_NAME} messages",
    )
