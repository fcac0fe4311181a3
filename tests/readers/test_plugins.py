"""Readers of other packages: found by their entry point, held against the kit, and never able to stop the night."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from ingest import formats
from ingest.inspect import FITS, REFUSED, inspect
from ingest.mapping_keys import FORMATS
from ingest.reader_kit import check_reader
from ingest.readers import find_reader
from pipeline.lab.installation import check_installation
from pipeline.lab.settings import Settings
from pipeline.nightly.stages import STAGES
from schemas.errors import MissingExtraError
from tests.readers import outside_reader

TIME = np.arange(400) / 100
COLUMNS = {"t": ("s", TIME), "x": ("mm", np.sin(TIME)), "F": ("N", 0.3 * np.sin(TIME))}
MAPPING = """
[time]
column = "t"
[columns.displacement]
column = "x"
[columns.force]
column = "F"
[recording]
recording_id = "{stem}"
protocol = "cyclic"
loading = "mechanical"
specimen_id = "L-1"
started_at = "2026-03-01T13:05:00Z"
frequency_hz = 0.16
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str, str], None]]:
    """Registers readers as an installed package does."""
    site = tmp_path / "site"

    def forget() -> None:
        for found in (formats.find_plugins, formats.list_formats, formats.list_options):
            found.cache_clear()

    def register(name: str, value: str) -> None:
        info = site / "outside-1.2.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: outside\nVersion: 1.2\n")
        (info / "entry_points.txt").write_text(f"[dealab.readers]\n{name} = {value}\n")
        monkeypatch.syspath_prepend(str(site))
        forget()

    yield register
    sys.path[:] = [place for place in sys.path if place != str(site)]
    forget()


def logger_file(folder: Path, mapping: str = MAPPING) -> Path:
    path = outside_reader.write(folder / "run.ldat", COLUMNS)
    path.with_name("run.ldat.toml").write_text(mapping, encoding="utf-8")
    return path


def test_the_kit_passes_the_reader_of_another_package(tmp_path: Path) -> None:
    path = outside_reader.write(tmp_path / "run.ldat", COLUMNS)
    units = {name: unit for name, (unit, _) in COLUMNS.items()}
    values = {name: list(values) for name, (_, values) in COLUMNS.items()}
    check_reader(outside_reader.READER, path, values, units=units)
    short = {name: part[3:] for name, part in values.items()}
    check_reader(outside_reader.READER, path, short, units=units, options={"skip_samples": 3})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"numbers": lambda self, column, index=None: None}, "is a NoneType"),
        ({"unit": lambda self, column: "kN"}, "unit('t') is 'kN'"),
        ({"names": lambda self: ("other",)}, "names() are"),
        ({"problems": ["a list"]}, "problems and notes are texts"),
    ],
)
def test_the_kit_tells_what_a_reader_gets_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, object], said: str
) -> None:
    path = outside_reader.write(tmp_path / "run.ldat", COLUMNS)
    read = outside_reader.LoggerReader.read

    def wrong(self: object, path: Path, mapping: object) -> object:
        file = read(self, path, mapping)  # type: ignore[arg-type]
        kind = type("Wrong", (type(file),), {k: v for k, v in change.items() if callable(v)})
        made = kind(file.where, file.heads, file.values)
        for name, value in change.items():
            if not callable(value):
                object.__setattr__(made, name, value)
        return made

    monkeypatch.setattr(outside_reader.LoggerReader, "read", wrong)
    with pytest.raises(AssertionError) as caught:
        check_reader(outside_reader.READER, path, {"t": list(TIME)}, units={"t": "s"})
    assert said in str(caught.value)


def test_the_kit_wants_damage_refused_and_no_crash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = outside_reader.write(tmp_path / "run.ldat", COLUMNS)
    read = outside_reader.LoggerReader.read

    def careless(self: object, path: Path, mapping: object) -> object:
        if path.stat().st_size < 100:
            raise IndexError("out of range")
        return read(self, path, mapping)  # type: ignore[arg-type]

    monkeypatch.setattr(outside_reader.LoggerReader, "read", careless)
    with pytest.raises(AssertionError, match="IndexError"):
        check_reader(outside_reader.READER, path, {"t": list(TIME)}, units={"t": "s"})


def test_a_registered_reader_reads_recordings(tmp_path: Path, install: Callable[[str, str], None]) -> None:
    before = STAGES["recording"].version(Settings())[0]
    others = STAGES["specimen"].version(Settings())
    install("ldat", "tests.readers.outside_reader:READER")
    found = inspect(logger_file(tmp_path))
    assert found.verdict == FITS, found.as_text()
    assert {channel.name for channel in found.channels} == {"displacement", "force"}
    assert STAGES["recording"].version(Settings())[0] != before  # another version of it reads all files again
    assert STAGES["specimen"].version(Settings()) == others


def test_options_of_its_own_table_are_known(tmp_path: Path, install: Callable[[str, str], None]) -> None:
    install("ldat", "tests.readers.outside_reader:READER")
    found = inspect(logger_file(tmp_path, "[ldat]\nskip_samples = 3\n" + MAPPING))
    assert found.verdict == FITS, found.as_text()
    assert found.channels[0].samples == 397
    wrong = inspect(logger_file(tmp_path, "[ldat]\nskip_sample = 3\n" + MAPPING))
    assert wrong.verdict == REFUSED
    assert "did you mean ldat.skip_samples?" in wrong.as_text()


def test_a_reader_that_fails_refuses_its_file(
    tmp_path: Path, install: Callable[[str, str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    install("ldat", "tests.readers.outside_reader:READER")
    monkeypatch.setattr(outside_reader.LoggerReader, "read", lambda *_: 1 / 0)
    found = inspect(logger_file(tmp_path))
    assert found.verdict == REFUSED
    assert "the reader of ldat (outside 1.2) failed: ZeroDivisionError" in found.as_text()


def test_a_reader_that_cannot_be_imported_is_told(install: Callable[[str, str], None]) -> None:
    install("ldat", "no_such_package_of_ours:READER")
    with pytest.raises(MissingExtraError, match=r"outside 1\.2"):
        find_reader("ldat")


def test_our_formats_stay_ours(install: Callable[[str, str], None]) -> None:
    install("csv", "tests.readers.outside_reader:READER")
    assert formats.list_formats() == dict(FORMATS)
    assert find_reader("csv").__module__ == "ingest.csv_reader"
    (told,) = [finding for finding in check_installation() if finding.check == "readers of other packages can be used"]
    assert told.problem is not None
    assert "the format csv is dealab's own" in told.problem


@pytest.mark.parametrize("name", [name for name in FORMATS if name != "mcap"])
def test_each_of_our_formats_has_a_reader(name: str) -> None:
    assert callable(find_reader(name))
