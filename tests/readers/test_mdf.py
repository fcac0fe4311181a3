"""ASAM MDF as asammdf writes it: groups with times of their own, invalid samples, damaged files, the way to a mapping."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ingest.draft import make_draft
from ingest.inspect import FITS, inspect
from ingest.mapping import FileMapping
from ingest.mapping_keys import FORMATS, OPTIONS
from ingest.mdf_reader import read_mdf
from ingest.reader_kit import check_reader
from schemas.errors import MissingExtraError, RefusedError
from tests.helpers.mdf_files import put_samples_last

asammdf = pytest.importorskip("asammdf")
READER = SimpleNamespace(suffixes=FORMATS["mdf"], options=OPTIONS["mdf"], read=read_mdf)
ALL = FileMapping("recording", None, {}, None, {}, {}, {})
T = np.arange(600) / 100
WAY, FORCE, WARM = 5 * np.sin(2 * T), 0.3 * np.sin(2 * T), np.full(60, 23.5)


def write(path: Path, version: str = "4.10", **more: Any) -> Path:
    """Two groups: way and force at 100 Hz, a temperature at 10 Hz."""
    file = asammdf.MDF(version=version)
    file.start_time = datetime(2026, 3, 1, 13, 5, 0, 250_000, tzinfo=UTC)
    force = asammdf.Signal(FORCE, T, name="Kraft", unit="N", **more)
    file.append([asammdf.Signal(WAY, T, name="Weg", unit="mm"), force])
    file.append([asammdf.Signal(WARM, T[::10], name="Temp", unit="degC")])
    file.save(path, overwrite=True)
    return path


@pytest.mark.parametrize(("version", "name"), [("4.10", "run.mf4"), ("3.30", "run.mdf")])
def test_the_kit_passes(tmp_path: Path, version: str, name: str) -> None:
    columns = {"Weg": list(WAY), "Kraft": list(FORCE), "Temp": list(WARM)}
    check_reader(READER, write(tmp_path / name, version), columns, units={"Weg": "mm", "Kraft": "N", "Temp": "degC"})


def test_each_group_has_its_own_time(tmp_path: Path) -> None:
    file = read_mdf(write(tmp_path / "run.mf4"), ALL)
    fast, slow = file.own_time("Weg"), file.own_time("Temp")
    assert fast is not None
    assert slow is not None
    np.testing.assert_allclose(fast.elapsed_s, T, atol=1e-12)
    np.testing.assert_allclose(slow.elapsed_s, T[::10], atol=1e-12)
    assert slow.start_ns == int(np.datetime64("2026-03-01T13:05:00.250", "ns").astype(np.int64))


def test_invalid_samples_are_empty_and_keep_their_place(tmp_path: Path) -> None:
    invalid = np.zeros(T.size, dtype=bool)
    invalid[100:103] = True
    file = read_mdf(write(tmp_path / "run.mf4", invalidation_bits=invalid), ALL)
    np.testing.assert_array_equal(file.numbers("Kraft").values, np.where(invalid, np.nan, FORCE))
    np.testing.assert_array_equal(file.numbers("Weg").values, WAY)


def test_names_that_several_groups_have_are_told_by_the_group(tmp_path: Path) -> None:
    made = asammdf.MDF(version="4.10")
    for scale in (1.0, 2.0):
        made.append([asammdf.Signal(scale * FORCE, T, name="Kraft", unit="N")])
    made.save(tmp_path / "run.mf4")
    file = read_mdf(tmp_path / "run.mf4", ALL)
    assert file.names() == ("0/Kraft", "1/Kraft")
    np.testing.assert_allclose(file.numbers("1/Kraft").values, 2 * FORCE)


def test_a_measurement_is_drafted_and_fits(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mf4")
    draft = make_draft(path)
    assert draft.content["columns"]["force"] == {"column": "Kraft", "unit": "N"}
    assert draft.content["columns"]["displacement"] == {"column": "Weg", "unit": "mm"}
    assert "time" not in draft.content
    assert draft.content["recording"]["started_at"] == "2026-03-01T13:05:00.250000+00:00"
    path.with_name("run.mf4.toml").write_text(draft.as_toml(), encoding="utf-8")
    found = inspect(path)
    assert found.verdict == FITS, found.as_text()
    assert found.channels[0].rate_hz == pytest.approx(100)


def test_without_asammdf_the_message_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "run.mf4")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match="asammdf"):
        read_mdf(path, ALL)


@pytest.mark.parametrize(("version", "name"), [("4.10", "run.mf4"), ("3.30", "run.mdf")])
def test_a_logger_that_was_cut_is_read_as_far_as_it_goes(tmp_path: Path, version: str, name: str) -> None:
    path = write(tmp_path / name, version)
    whole = put_samples_last(path)
    assert read_mdf(path, ALL).problems == ()
    for lost in (1, 16, 17, 320):  # a sample of the second group has 16 bytes
        path.write_bytes(whole[:-lost])
        file = read_mdf(path, ALL)
        left = 60 - -(-lost // 16)
        assert file.problems == (f"the file ends too early: group 1 states 60 samples and holds {left}",)
        np.testing.assert_array_equal(file.numbers("Temp").values, WARM[:left])
        np.testing.assert_array_equal(file.numbers("Kraft").values, FORCE)
    own = file.own_time("Temp")
    assert own is not None
    np.testing.assert_allclose(own.elapsed_s, T[::10][:left], atol=1e-12)


def test_a_file_without_its_description_is_refused_at_every_length(tmp_path: Path) -> None:
    content = write(tmp_path / "run.mf4").read_bytes()
    for length in (0, 63, 70, 100, 200, 300, 14_500, len(content) - 200):
        (tmp_path / "cut.mf4").write_bytes(content[:length])
        with pytest.raises(RefusedError, match="as MDF"):
            read_mdf(tmp_path / "cut.mf4", ALL)


def test_what_is_no_measurement_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run.mf4").write_bytes(b"MDF     4.10    nothing else" + bytes(200))
    with pytest.raises(RefusedError, match="as MDF") as told:
        read_mdf(tmp_path / "run.mf4", ALL)
    assert str(tmp_path) not in str(told.value)


def test_another_version_is_told_without_the_folder(tmp_path: Path) -> None:
    (tmp_path / "run.mdf").write_bytes(b"MDF     E.30    nothing else" + bytes(200))
    with pytest.raises(RefusedError, match=r"E\.30") as told:
        read_mdf(tmp_path / "run.mdf", ALL)
    assert str(tmp_path) not in str(told.value)
