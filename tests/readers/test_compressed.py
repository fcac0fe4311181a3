"""Compressed texts: as other programs write them, in several streams, cut, damaged, locked and made to fill the memory."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyuff
from hypothesis import given, settings
from hypothesis import strategies as st

from ingest import compressed
from ingest.compressed import find_inner_name, find_stem, find_suffix, read_plain_content
from ingest.discover import discover, lacks_end
from ingest.inspect import DAMAGED, FITS, REFUSED, inspect
from ingest.mapping import format_of
from pipeline.cli import main
from schemas.errors import RefusedError

ROWS = 2000
TEXT = "t;F;x\ns;N;mm\n" + "".join(f"{i / 1000:.3f};{2 + i % 7:.3f};{i % 11:.3f}\n" for i in range(ROWS))
CONTENT = TEXT.encode()
MAPPING = """
[csv]
delimiter = ";"
unit_row = true
[time]
column = "t"
[columns.displacement]
column = "x"
[columns.force]
column = "F"
[recording]
recording_id = "{stem}"
protocol = "step"
loading = "mechanical"
specimen_id = "L-1"
started_at = "2026-03-01T13:05:00Z"
"""


def zipped(content: bytes, name: str = "deep/run.csv", how: int = zipfile.ZIP_DEFLATED) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w", how) as archive:
            archive.mkdir("deep")
            archive.writestr(name, content)
            archive.writestr("__MACOSX/deep/._run.csv", b"\x00\x05")

    return write


WRITERS: dict[str, Callable[[Path], Any]] = {
    "run.csv.gz": lambda path: path.write_bytes(gzip.compress(CONTENT)),
    "run.CSV.GZ": lambda path: path.write_bytes(
        gzip.compress(CONTENT[:500]) + gzip.compress(CONTENT[500:]) + bytes(99)
    ),
    "run.csv.bz2": lambda path: path.write_bytes(bz2.compress(CONTENT[:77]) + bz2.compress(CONTENT[77:])),
    "run.csv.xz": lambda path: path.write_bytes(lzma.compress(CONTENT)),
    "run.csv.zip": zipped(CONTENT),
    "run.txt.zip": zipped(CONTENT, how=zipfile.ZIP_LZMA),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_compressed_text_is_the_recording_that_it_holds(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    WRITERS[name](path)
    path.with_name(name + ".toml").write_text(MAPPING, encoding="utf-8")
    found = inspect(path)
    assert found.verdict == FITS, found.as_text()
    assert {c.name: c.samples for c in found.channels} == {"force": ROWS, "displacement": ROWS}
    assert dict(found.metadata)["recording_id"] == "run"
    assert [file.format for file in discover([tmp_path], print)] == ["csv"]


def test_a_universal_file_may_be_compressed(tmp_path: Path) -> None:
    plain = tmp_path / "plain.uff"
    for name, unit in (("F", "N"), ("x", "mm")):
        pyuff.UFF(str(plain)).write_sets(
            {"type": 58, "func_type": 1, "rsp_node": 1, "rsp_dir": 1, "ref_dir": 1, "ref_node": 1, "binary": 0,
             "data": np.sin(np.arange(50)), "x": np.arange(50) / 100, "id1": name, "abscissa_axis_units_lab": "s",
             "ordinate_axis_units_lab": unit, "orddenom_axis_units_lab": "NONE", "orddenom_spec_data_type": 0},
            "add",
        )  # fmt: skip
    path = tmp_path / "run.uff.gz"
    path.write_bytes(gzip.compress(plain.read_bytes()))
    plain.unlink()
    path.with_name("run.uff.gz.toml").write_text(
        '[columns.force]\ncolumn = "F"\n[columns.displacement]\ncolumn = "x"\n'
        + MAPPING[MAPPING.index("[recording]") :],
        encoding="utf-8",
    )
    assert inspect(path).verdict == FITS


@pytest.mark.parametrize("name", ["run.csv.gz", "run.csv.bz2", "run.csv.xz", "run.csv.zip"])
def test_a_cut_file_is_read_as_far_as_it_goes(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    rng = np.random.default_rng(7)  # digits that do not shrink, so that bz2 and xz make more than one block
    rows = [f"{i / 1000:.3f};{a:.9f};{b:.9f}\n" for i, (a, b) in enumerate(rng.random((40_000, 2)))]
    content = ("t;F;x\ns;N;mm\n" + "".join(rows)).encode()
    whole = {"gz": gzip.compress, "bz2": bz2.compress, "xz": lambda c: lzma.compress(c, preset=0), "zip": archived}[
        name[8:]
    ](content)
    path.write_bytes(whole[: int(0.9 * len(whole))])
    path.with_name(name + ".toml").write_text(MAPPING, encoding="utf-8")
    found = inspect(path)
    assert found.verdict == DAMAGED, found.as_text()
    assert "the compressed file ends too early: what comes after is lost" in found.problems
    assert 10_000 < found.channels[0].samples < 40_000
    assert content.startswith(read_plain_content(path).content)
    assert read_plain_content(path).content.endswith(b"\n")  # no half number at the end


@pytest.mark.parametrize("name", ["run.csv.gz", "run.csv.bz2", "run.csv.xz", "run.csv.zip"])
@given(at=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
@settings(max_examples=40, deadline=None)
def test_a_flipped_bit_gives_no_other_text_as_whole(tmp_path_factory: Any, name: str, at: float, bit: int) -> None:
    path = tmp_path_factory.mktemp("flipped") / name
    WRITERS[name](path)
    content = bytearray(path.read_bytes())
    content[int(at * len(content))] ^= 1 << bit
    path.write_bytes(content)
    try:
        plain = read_plain_content(path)
    except RefusedError:
        return
    assert plain.content == CONTENT or (plain.problems and CONTENT.startswith(plain.content))


def test_what_stands_behind_the_data_is_told(tmp_path: Path) -> None:
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress(CONTENT) + b"\x00\x00Copied on Monday")
    plain = read_plain_content(path)
    assert plain.content == CONTENT
    assert plain.problems == ("16 bytes behind the compressed data are something else and were left out",)


@pytest.mark.parametrize("suffix", [".gz", ".bz2", ".xz", ".zip"])
def test_a_file_made_to_fill_the_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    path = tmp_path / f"run.csv{suffix}"
    monkeypatch.setattr(compressed, "_SMALLEST_LIMIT", 1 << 20)
    bomb = b"1;2\n" * (1 << 19)
    if suffix == ".zip":
        zipped(bomb)(path)
    else:
        path.write_bytes({".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}[suffix](bomb))
    with pytest.raises(RefusedError, match="inflates to more than"):
        read_plain_content(path)


def test_archives_of_several_files_and_locked_ones_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "runs.csv.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.csv", CONTENT)
        archive.writestr("b.csv", CONTENT)
    with pytest.raises(RefusedError, match=r"2 files: a\.csv, b\.csv"):
        read_plain_content(path)
    zipped(CONTENT)(path)
    content = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        place = -1
        while (place := content.find(signature, place + 1)) >= 0:
            content[place + offset] |= 1
    path.write_bytes(content)
    with pytest.raises(RefusedError, match="locked with a password"):
        read_plain_content(path)


def test_only_texts_are_read_compressed(tmp_path: Path) -> None:
    path = tmp_path / "run.mat.gz"
    path.write_bytes(gzip.compress(b"no text"))
    assert format_of(path) is None
    notes: list[str] = []
    assert list(discover([tmp_path], lambda passed: notes.append(str(passed)))) == []
    assert any("run.mat.gz" in note and "unpack it" in note for note in notes)
    path.with_name("run.mat.gz.toml").write_text('format = "matlab"\n[columns.force]\ncolumn = "F"\n', encoding="utf-8")
    found = inspect(path)
    assert found.verdict == REFUSED
    assert "Unpack it" in found.as_text()


def test_add_maps_an_archive_whose_name_tells_no_format(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "export 3.zip"
    zipped(CONTENT)(path)
    about = ["specimen_id=L-1", "started_at=2026-03-01T13:05:00Z", "protocol=step", "recording_id=export-3"]
    assert main(["add", str(path), "--yes", *about]) == 0, capsys.readouterr().err
    toml = path.with_name("export 3.zip.toml").read_text(encoding="utf-8")
    assert 'format = "csv"' in toml
    assert inspect(path).verdict == FITS


def test_names_without_the_compression() -> None:
    path = Path("folder/run.7.csv.gz")
    assert (find_inner_name(path).name, find_stem(path), find_suffix(path)) == ("run.7.csv", "run.7", ".csv")
    plain = Path("folder/run.7.csv")
    assert (find_inner_name(plain).name, find_stem(plain), find_suffix(plain)) == ("run.7.csv", "run.7", ".csv")


def test_an_archive_has_an_end(tmp_path: Path) -> None:
    path = tmp_path / "run.csv.zip"
    zipped(CONTENT)(path)
    assert not lacks_end(path, "csv")
    path.write_bytes(path.read_bytes()[:-30])
    assert lacks_end(path, "csv")


def archived(content: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.mkdir("deep")
        archive.writestr("deep/run.csv", content)
    return stream.getvalue()


def test_an_archive_that_lacks_its_end_only_is_read_whole_and_told(tmp_path: Path) -> None:
    path = tmp_path / "run.csv.zip"
    whole = bytearray(archived(CONTENT))
    path.write_bytes(whole[:-30])
    found = read_plain_content(path)
    assert found.content == CONTENT
    assert found.problems == ("the compressed file ends too early: what comes after is lost",)
    whole[whole.index(b"PK\x03\x04", 4) + 14] ^= 1  # of the checksum before the file
    path.write_bytes(whole[:-30])
    with pytest.raises(RefusedError, match="checksum does not agree"):
        read_plain_content(path)


def test_a_file_that_ends_in_its_first_block_is_told_as_cut(tmp_path: Path) -> None:
    for name, make in (("run.csv.bz2", bz2.compress), ("run.csv.gz", gzip.compress)):
        path = tmp_path / name
        path.write_bytes(make(CONTENT)[:20])
        with pytest.raises(RefusedError, match="ends before its first line does"):
            read_plain_content(path)
