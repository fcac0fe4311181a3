"""Writes a recording, a mapping and a rig file as another laboratory's software would: from the documents alone.

Imports nothing of dealab: numpy, mcap and protobuf, which a rig's computer has.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer

START_NS = 1_772_370_300_000_000_000
METADATA = {
    "recording_id": "ours-1", "protocol": "cyclic", "loading": "mechanical", "specimen_id": "F-1", "started_at": "2026-03-01T13:05:00Z",
    "film_length_mm": "50", "film_width_mm": "20", "film_thickness_mm": "0.5", "stretch_1": "1.0", "frequency_hz": "1.0", "rig_id": "rig-o",
}  # fmt: skip
RIG = "clamp_mass_kg = 0.188\nclamp_mass_kg_sd = 0.002\nload_cell_stiffness_n_per_mm = 20.2\nforce_noise_sd = 0.001\n"


def _block() -> tuple[bytes, type]:
    file = descriptor_pb2.FileDescriptorProto(name="block.proto", package="dealab", syntax="proto3")
    message = file.message_type.add(name="SampleBlock")
    for number, (name, kind, label) in enumerate(
        [("start_time_ns", 16, 1), ("sample_interval_s", 1, 1), ("values", 1, 3)], start=1
    ):
        message.field.add(name=name, number=number, type=kind, label=label)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    cls: Any = message_factory.GetMessageClass(pool.FindMessageTypeByName("dealab.SampleBlock"))
    return descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString(), cls


def write(folder: Path) -> list[Path]:
    """A recording in the native format, its metadata as JSON, a CSV file with its mapping, and the rig's file."""
    descriptor, block = _block()
    (folder / "rigs").mkdir()
    time = [i / 1000 for i in range(5000)]
    moved = [0.5 * math.sin(2 * math.pi * t) for t in time]
    force = [0.3 * x + 0.01 * math.cos(2 * math.pi * t) for x, t in zip(moved, time, strict=True)]
    with (folder / "ours-1.mcap").open("wb") as out:
        writer = Writer(out)
        writer.start()
        writer.add_metadata("recording", METADATA)
        schema = writer.register_schema("dealab.SampleBlock", "protobuf", descriptor)
        for name, unit, values in (("displacement", "mm", moved), ("force", "N", force)):
            channel = writer.register_channel(f"/{name}", "protobuf", schema, {"unit": unit})
            for number, first in enumerate(range(0, 5000, 1000)):
                start = START_NS + first * 1_000_000
                data = block(start_time_ns=start, sample_interval_s=1e-3, values=values[first : first + 1000])  # type: ignore[call-arg]
                writer.add_message(channel, start, data.SerializeToString(), start, number)
        writer.finish()
    (folder / "ours-1.json").write_text(json.dumps({"recording": METADATA}), encoding="utf-8")
    rows = "".join(f"{t:.3f},{x:.6f},{f:.6f}\n" for t, x, f in zip(time, moved, force, strict=True))
    (folder / "ours-2.csv").write_text("t,x,F\n" + rows, encoding="utf-8")
    about = "".join(f'{k} = "{v}"\n' for k, v in (METADATA | {"recording_id": "{stem}"}).items())
    columns = '[time]\ncolumn = "t"\nunit = "s"\n[columns.displacement]\ncolumn = "x"\nunit = "mm"\n[columns.force]\ncolumn = "F"\nunit = "N"\n'
    (folder / "ours-2.csv.toml").write_text(columns + "[recording]\n" + about, encoding="utf-8")
    (folder / "rigs" / "rig-o.toml").write_text(RIG, encoding="utf-8")
    return sorted(path for path in folder.rglob("*") if path.is_file())
