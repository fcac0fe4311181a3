"""What may lie beside a file, and links in it that lead out of it: neither may change or add to what is read."""

from __future__ import annotations

import contextlib
import functools
import io
import os
import random
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tests.bad_files.mutate import mutated

SECRET = 1234.5
"""The values of somebody else's file, which no seed has."""
_ROWS = 24
_HDF5 = b"\x89HDF\r\n\x1a\n"
_NAMES = (
    "{name}_index", "{stem}_index", "{stem}.tdms_index", "{name}.idx", "{stem}.hdr", "{stem}.xml", "{stem}.h5", "{stem}.raw",
    "_metadata", "_common_metadata", "{name}~", ".{name}", "{name}.lock", "{stem}.txt", "{name}.gz",
)  # fmt: skip
"""Names that programs give to what belongs to a file, or that a library might look for."""


@functools.cache
def secret() -> Path:
    """A file of somebody else: HDF5 with arrays of every name that seeds have, and the same numbers bare, in `.raw`."""
    import h5py

    folder = Path(tempfile.gettempdir()) / f"dealab-fuzz-{os.getuid()}"
    folder.mkdir(exist_ok=True)
    half = folder / f"{os.getpid()}.h5"  # of many processes the last one's stays, and each is whole
    with h5py.File(half, "w") as file:
        for name in ("t", "F", "x", "rig/t", "rig/F", "rig/x", "run/data"):
            file[name] = np.full((3, _ROWS) if name == "run/data" else _ROWS, SECRET)
    np.full(3 * _ROWS, SECRET).tofile(half.with_suffix(".raw"))
    for written in (half.with_suffix(".raw"), half):
        written.replace(folder / f"secret{written.suffix}")
    return folder / "secret.h5"


def relinked(content: bytes, rng: random.Random) -> bytes | None:
    """An HDF5 file in which an array has become a link into the secret file; None for other files."""
    import h5py

    if _HDF5 not in content[:1024]:
        return None
    at = content.index(_HDF5)
    stream = io.BytesIO(content[at:])
    with h5py.File(stream, "r+") as file:
        arrays: list[str] = []
        file.visititems(lambda name, item: arrays.append(name) if isinstance(item, h5py.Dataset) else None)
        name = rng.choice(arrays)
        shape = file[name].shape
        del file[name]
        rng.choice(_LINKS)(file, name, shape)
    return content[:at] + stream.getvalue()


def _external_link(file: Any, name: str, _shape: Any) -> None:
    import h5py

    file[name] = h5py.ExternalLink(os.fspath(secret()), f"/{name}")


def _link_to_a_link(file: Any, name: str, _shape: Any) -> None:
    import h5py

    file["all"] = h5py.ExternalLink(os.fspath(secret()), "/")
    file[name] = h5py.SoftLink(f"/all/{name}")


def _virtual(file: Any, name: str, shape: Any) -> None:
    import h5py

    layout = h5py.VirtualLayout(shape, "f8")
    layout[...] = h5py.VirtualSource(os.fspath(secret()), name, shape=shape)
    file.create_virtual_dataset(name, layout)


def _external_storage(file: Any, name: str, shape: Any) -> None:
    import h5py

    file.create_dataset(name, shape, "f8", external=[(os.fspath(secret().with_suffix(".raw")), 0, h5py.h5f.UNLIMITED)])


_LINKS: tuple[Callable[[Any, str, Any], None], ...] = (_external_link, _link_to_a_link, _virtual, _external_storage)


@contextlib.contextmanager
def crowded(path: Path, rng: random.Random, seed: bytes) -> Iterator[Path]:
    """The same file where others lie beside it, or behind a link; in a folder that is gone afterwards."""
    folder = path.with_name(f"beside-{path.name}")
    folder.mkdir()
    try:
        place = folder / path.name
        if rng.random() < 0.3:
            (folder / "elsewhere").mkdir()
            shutil.copyfile(path, folder / "elsewhere" / "other-name")
            place.symlink_to(folder / "elsewhere" / "other-name")
        else:
            shutil.copyfile(path, place)
        for name in rng.sample(_NAMES, rng.randint(1, 4)):
            other = folder / name.format(name=path.name, stem=path.stem)
            if not os.path.lexists(other):
                _put(other, rng, seed)
        yield place
    finally:
        shutil.rmtree(folder)


def _put(place: Path, rng: random.Random, seed: bytes) -> None:
    kind = rng.choice(("earlier", "earlier", "mutated", "empty", "noise", "device", "secret", "loop", "folder", "pipe"))
    if kind == "earlier":  # of a copy before the last run; an index of TDMS has another mark and no numbers
        place.write_bytes(seed.replace(b"TDSm", b"TDSh") if place.name.endswith("_index") else seed)
    elif kind == "mutated":
        place.write_bytes(mutated(seed.replace(b"TDSm", b"TDSh"), rng))
    elif kind in ("empty", "noise"):
        place.write_bytes(rng.randbytes(0 if kind == "empty" else 200))
    elif kind == "folder":
        place.mkdir()
    elif kind == "pipe":
        os.mkfifo(place)
    else:
        place.symlink_to({"device": "/dev/zero", "secret": secret(), "loop": place}[kind])
