"""MDF files as programs write them that measure: asammdf writes the samples first."""

from __future__ import annotations

import struct
from pathlib import Path


def put_samples_last(path: Path) -> bytes:
    """The file as a logger writes it: all descriptions first, the samples of each group behind them."""
    import asammdf

    content = bytearray(path.read_bytes())
    with asammdf.MDF(path) as file:
        found = [(g.data_group.address, g.data_group.data_block_addr, g.channel_group) for g in file.groups]
        four = file.version >= "4"
    for group, samples, channels in found:
        content += bytes(-len(content) % 8)
        pointer, form = (group + 40, "<Q") if four else (group + 16, "<I")
        size = 24 * four + channels.samples_byte_nr * channels.cycles_nr
        struct.pack_into(form, content, pointer, len(content))
        content += content[samples : samples + size]
    path.write_bytes(content)
    return bytes(content)
