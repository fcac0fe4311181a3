"""Writing of MCAP files in the contract's native layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import CompressionType, Writer


def _schema():
    fd = descriptor_pb2.FileDescriptorProto(name="dealab/sample_block.proto", package="dealab", syntax="proto3")
    m = fd.message_type.add(name="SampleBlock")
    t = descriptor_pb2.FieldDescriptorProto
    m.field.add(name="start_time_ns", number=1, type=t.TYPE_SFIXED64, label=t.LABEL_OPTIONAL)
    m.field.add(name="sample_interval_s", number=2, type=t.TYPE_DOUBLE, label=t.LABEL_OPTIONAL)
    m.field.add(name="values", number=3, type=t.TYPE_DOUBLE, label=t.LABEL_REPEATED)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(fd)
    cls = message_factory.GetMessageClass(pool.FindMessageTypeByName("dealab.SampleBlock"))
    return descriptor_pb2.FileDescriptorSet(file=[fd]).SerializeToString(), cls


SCHEMA, BLOCK = _schema()


def write_mcap(path: Path, meta: dict, rig: dict, channels: dict, start_ns: int, block: int, compression: str) -> None:
    """Write one recording; channels: quantity -> {values, dt, unit, resolution?, skip?: (from, to) seconds left out}."""
    comp = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}[compression]
    with path.open("wb") as fh:
        w = Writer(fh, compression=comp)
        w.start(profile="", library="bench")
        sid = w.register_schema("dealab.SampleBlock", "protobuf", SCHEMA)
        msgs = []
        for q, ch in channels.items():
            md = {"unit": ch["unit"]}
            if ch.get("resolution"):
                md["resolution"] = repr(float(ch["resolution"]))
            cid = w.register_channel(f"/{q}", "protobuf", sid, md)
            v = np.asarray(ch["values"], float)
            for seq, a in enumerate(range(0, len(v), block)):
                t = start_ns + round(a * ch["dt"] * 1e9)
                m = BLOCK(start_time_ns=t, sample_interval_s=ch["dt"])
                m.values.extend(v[a : a + block].tolist())
                msgs.append((t, cid, seq, m.SerializeToString()))
        for t, cid, seq, data in sorted(msgs, key=lambda z: z[:3]):
            w.add_message(cid, log_time=t, data=data, publish_time=t, sequence=seq)
        w.add_metadata("recording", {k: str(v) for k, v in meta.items()})
        w.add_metadata("rig", {k: str(v) for k, v in rig.items()})
        w.finish()
