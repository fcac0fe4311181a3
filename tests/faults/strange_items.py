"""Strange items among raw files, for a night to pass over: names, depths, absurd texts, what never ends."""

from __future__ import annotations

import os
from pathlib import Path

TABLE = "a,b\n1,2\n"


def put_names_that_are_not_utf8(raw: bytes) -> None:
    for folder in (raw, raw + b"/folder \xfd"):
        os.makedirs(folder, exist_ok=True)
        for name in (b"bad \xff.mcap", b"unmapped \xfe.csv", b"mapped \xfc.csv", b"mapped \xfc.csv.toml"):
            with open(folder + b"/" + name, "w") as file:
                file.write(TABLE)
    os.symlink(b"nowhere \xfb", raw + b"/link \xfa.mcap")


def put_long_names(raw: bytes) -> None:
    for name in (b"n" * 251 + b".csv", b"m" * 250 + b".mcap", b"o" * 255):
        with open(raw + b"/" + name, "w") as file:
            file.write(TABLE)


def put_deep_folders(raw: bytes, name: bytes = b"d" * 10) -> None:
    """Deeper than Python recurses, and beyond the length that a path may have."""
    at = os.open(raw, os.O_RDONLY)
    for _ in range(600):
        os.mkdir(name, dir_fd=at)
        below = os.open(name, os.O_RDONLY, dir_fd=at)
        os.close(at)
        at = below
    os.close(os.open(b"x.mcap", os.O_WRONLY | os.O_CREAT, dir_fd=at))
    os.close(at)


def put_very_deep_folders(raw: bytes) -> None:
    put_deep_folders(raw, b"d")


def put_absurd_mappings(raw: bytes) -> None:
    texts = (
        f"kind = 'recording'\nx = {'9' * 400}",
        ".".join("a" * 3000) + " = 1",
        "a = " + "[" * 3000 + "]" * 3000,
        "x = inf",
        "x = " + "1" * 5000,
        "x = 0x" + "f" * 5000,
        "\udcff",
        "time = 9999-99-99",
    )
    for number, text in enumerate(texts):
        for name in (f"{number}.csv.toml", f"folder-{number}/recordings.toml"):
            path = Path(os.fsdecode(raw)) / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, errors="surrogateescape")
            (path.parent / f"{number}.csv").write_text(TABLE)


def put_what_never_ends(raw: bytes) -> None:
    for name in (b"zero.mcap", b"z.csv.toml", b"recordings.toml", b"zero.csv"):
        os.symlink("/dev/zero", raw + b"/" + name)
    os.mkfifo(raw + b"/pipe.mcap")
    if os.path.exists("/proc/self/pagemap"):
        for name in (b"pages.csv", b"p.csv.toml", b"pages.mcap"):
            os.symlink("/proc/self/pagemap", raw + b"/" + name)
    for name in (b"z.csv", b"p.csv"):
        with open(raw + b"/" + name, "w") as file:
            file.write(TABLE)


def remove_deep(folder: Path) -> None:
    """pytest's own removal gives up on paths that are too long."""
    for name in (b"d" * 10, b"d"):
        if os.path.isdir(os.fsencode(folder) + b"/" + name):
            at = os.open(folder, os.O_RDONLY)
            while True:  # turn the chain inside out: each folder goes up beside the first
                os.rename(name, b"top", src_dir_fd=at, dst_dir_fd=at)
                try:
                    os.rename(b"top/" + name, name, src_dir_fd=at, dst_dir_fd=at)
                except FileNotFoundError:
                    os.unlink(b"top/x.mcap", dir_fd=at)
                    os.rmdir(b"top", dir_fd=at)
                    break
                os.rmdir(b"top", dir_fd=at)
            os.close(at)


ALL = (
    put_names_that_are_not_utf8,
    put_long_names,
    put_deep_folders,
    put_very_deep_folders,
    put_absurd_mappings,
    put_what_never_ends,
)
"""All of them; each is given the folder as bytes."""
