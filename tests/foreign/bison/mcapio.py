"""Native recordings: MCAP with `dealab.SampleBlock` messages, written by hand."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from google.protobuf import descriptor_pb2
from mcap.writer import CompressionType, Writer


def _descriptor() -> bytes:
    f = descriptor_pb2.FileDescriptorProto(name="dealab/sample_block.proto", package="dealab", syntax="proto3")
    m = f.message_type.add(name="SampleBlock")
    d = descriptor_pb2.FieldDescriptorProto
    m.field.add(name="start_time_ns", number=1, type=d.TYPE_SFIXED64, label=d.LABEL_OPTIONAL, json_name="startTimeNs")
    m.field.add(
        name="sample_interval_s", number=2, type=d.TYPE_DOUBLE, label=d.LABEL_OPTIONAL, json_name="sampleIntervalS"
    )
    m.field.add(name="values", number=3, type=d.TYPE_DOUBLE, label=d.LABEL_REPEATED, json_name="values")
    return descriptor_pb2.FileDescriptorSet(file=[f]).SerializeToString()


DESCRIPTOR = _descriptor()


def _varint(n: int) -> bytes:
    out = b""
    while n > 127:
        out += bytes([n & 127 | 128])
        n >>= 7
    return out + bytes([n])


def block(start_ns: int, dt: float, values: np.ndarray) -> bytes:
    """One SampleBlock on the wire."""
    body = np.ascontiguousarray(values, "<f8").tobytes()
    return b"\x09" + struct.pack("<q", start_ns) + b"\x11" + struct.pack("<d", dt) + b"\x1a" + _varint(len(body)) + body


def write(
    path: Path, meta: dict[str, str], rig: dict[str, str] | None, channels: list[dict], size: int, compression: str
) -> None:
    """Write a recording; a channel has topic, unit, start_ns, dt, values, meta and optionally keep (a mask)."""
    kind = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}[compression]
    with path.open("wb") as out:
        w = Writer(out, compression=kind)
        w.start(profile="", library="dea-bench 2.3")
        schema = w.register_schema("dealab.SampleBlock", "protobuf", DESCRIPTOR)
        w.add_metadata("recording", meta)
        if rig is not None:
            w.add_metadata("rig", rig)
        todo = []
        for c in channels:
            cid = w.register_channel("/" + c["topic"], "protobuf", schema, {"unit": c["unit"], **c["meta"]})
            v, keep = c["values"], c.get("keep")
            runs = [(0, v.size)]
            if keep is not None:
                edge = np.flatnonzero(np.diff(np.concatenate([[0], keep.astype(int), [0]])))
                runs = list(zip(edge[::2], edge[1::2], strict=True))
            seq = 0
            for a, b in runs:
                for i in range(a, b, size):
                    t = c["start_ns"] + round(i * c["dt"] * 1e9)
                    todo.append((t, cid, seq, c, i, min(i + size, b)))
                    seq += 1
        todo.sort(key=lambda x: (x[0], x[1]))
        for t, cid, seq, c, i, j in todo:
            w.add_message(cid, t, block(t, c["dt"], c["values"][i:j]), t, seq)
        w.finish()
