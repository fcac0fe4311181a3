"""Whoever mistypes a name is asked about the one that was meant, wherever names are typed."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ingest.inspect import inspect
from pipeline.cli import main
from schemas.alike import ask_meant, find_alike
from schemas.errors import RefusedError
from schemas.metadata import RecordingMetadata
from schemas.protocols import PROTOCOL_NAMES, protocol
from schemas.quantities import quantity
from schemas.units import conversion

MAPPING = """
kind = "recordng"
[time]
column = "t"
unit = "s"
[columns.force]
column = "F"
unit = "N"
"""


@pytest.mark.parametrize(
    ("given_name", "meant"),
    [("cyclik", "cyclic"), ("CHIRP", "chirp"), ("lifetme", "lifetime"), ("stp", "step"), ("sweep", None), ("", None)],
)
def test_a_protocol_is_asked_about(given_name: str, meant: str | None) -> None:
    assert find_alike(given_name, PROTOCOL_NAMES) == meant
    with pytest.raises(RefusedError) as caught:
        protocol(given_name, "mechanical")
    assert ("did you mean" in caught.value.problem) == (meant is not None)
    assert f"did you mean {meant}?" in caught.value.problem or meant is None


@pytest.mark.parametrize(
    ("unit", "canonical", "meant"),
    [("milimeter", "mm", "millimeter"), ("Newtn", "N", "newton"), ("KPA", "kPa", "kPa"), ("Nn", "N", None), ("furlogn", "mm", None)],
)  # fmt: skip
def test_a_unit_is_asked_about(unit: str, canonical: str, meant: str | None) -> None:
    with pytest.raises(RefusedError, match="is unknown") as caught:
        conversion(unit, canonical)
    assert ("did you mean" in caught.value.problem) == (meant is not None)
    assert f"did you mean {meant}?" in caught.value.problem or meant is None


def test_quantities_kinds_and_loadings_are_asked_about(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="did you mean displacement"):
        quantity("displacment")
    path = tmp_path / "run.csv"
    path.write_text("t,F\n0,1\n1,2\n", encoding="utf-8")
    path.with_name("run.csv.toml").write_text(MAPPING, encoding="utf-8")
    assert "did you mean recording?" in inspect(path).as_text()
    about = {"recording_id": "a", "protocol": "cyclic", "loading": "mechancal", "specimen_id": "s"}
    with pytest.raises(RefusedError, match="did you mean mechanical"):
        RecordingMetadata.parse({**about, "started_at": "2026-03-01T14:05:00Z"})


def test_a_command_is_asked_about(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["nigthly", "raw"])
    assert ended.value.code == 2
    assert 'there is no command "nigthly": did you mean nightly?' in capsys.readouterr().err


def test_a_mistyped_folder_leaves_no_lab(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "recordings").mkdir()
    assert main(["nightly", str(tmp_path / "recordigns"), "--lab", str(tmp_path / "lab")]) == 2
    assert "did you mean recordings?" in capsys.readouterr().err
    assert not (tmp_path / "lab").exists()


@given(st.text(max_size=30), st.lists(st.text(st.characters(categories=["L", "N"]), max_size=12), max_size=6))
def test_what_is_asked_is_always_one_of_the_known(name: str, known: list[str]) -> None:
    found = find_alike(name, known)
    assert found is None or found in known
    assert (ask_meant(name, known) == "") == (found is None)
    for one in known:
        assert find_alike(one, known) is not None
