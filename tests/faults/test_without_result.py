"""A recording or table that led to no result is told: a row, a line on the index and in the status, an exit status."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline import Lab
from pipeline.commands.show.status import describe_lab
from pipeline.lab.annotations import annotate
from pipeline.nightly.night import nightly
from tests.faults.lab_state import healthy, select
from tests.helpers.small_lab import RIG, about, chirp, life, write

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

ROWS = "SELECT recording_id, status, what_was_missing FROM without_result ORDER BY source_path"


def still(path: Path) -> Path:
    """A step of displacement that never comes: noise on both channels."""
    noise = np.random.default_rng(5)
    channels = {"displacement": ("mm", noise.normal(0, 1e-3, 4000)), "force": ("N", noise.normal(0, 1e-3, 4000))}
    return write(path, about(path.stem, "step", "mechanical", "P-9", 0), 100.0, channels)


def test_a_night_without_a_result_is_not_all_done(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "lab")
    (tmp_path / "raw").mkdir()
    still(tmp_path / "raw" / "still.mcap")
    summary = nightly([tmp_path / "raw"], lab, jobs=0)
    assert summary.attention == ()
    assert summary.exit_status == 4
    assert len(summary.without_result) == 1
    assert "1 recording led to no result" in summary.paragraph()
    ((name, status, missing),) = select(lab, ROWS)
    assert (name, status) == ("still", "ok")
    assert "holds no step above its noise" in missing
    index = (lab.reports / "index.html").read_text(encoding="utf-8")
    assert "all done" not in index
    assert "holds no step above its noise" in index
    assert "no result" in index.lower()
    told = describe_lab(lab)
    assert "No result from:" in told
    assert "holds no step above its noise" in told
    assert select(lab, "SELECT without_result FROM runs") == [(1,)]
    assert healthy(lab) == []


def test_the_status_names_the_first_of_many_without_a_result(tmp_path: Path) -> None:
    """It listed them all, so that its length and memory grew with the lab."""
    lab = Lab(tmp_path / "lab")
    (tmp_path / "raw").mkdir()
    for number in range(12):
        still(tmp_path / "raw" / f"still-{number:02d}.mcap")
    nightly([tmp_path / "raw"], lab, jobs=0)
    listed = describe_lab(lab).partition("No result from:")[2].splitlines()[1:]
    assert [line.split(":")[0].strip() for line in listed[:10]] == [f"still-{number:02d}" for number in range(10)]
    assert listed[10].strip().startswith("and 2 more: response: the input holds no step above its noise")
    assert len(listed) == 11


def test_what_leads_to_a_result_later_is_no_longer_told(tmp_path: Path) -> None:
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    still(raw / "still.mcap")
    life(raw / "L-1.mcap", 1)
    (raw / "torn.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(200))
    summary = nightly([raw], lab, jobs=0)
    assert summary.exit_status == 3, "a refused file goes first"
    rows = select(lab, ROWS)
    assert [row[:2] for row in rows] == [("still", "ok"), (None, "quarantined")]
    assert rows[1][2] == select(lab, "SELECT problem FROM recordings WHERE status = 'quarantined'")[0][0]
    assert len(summary.without_result) == 1, "the refused file is told with its reason already"

    (raw / "torn.mcap").unlink()
    annotate(lab, "still", "exclude", "the step was never made")
    assert nightly([raw], lab, jobs=0).exit_status == 0
    assert "still" not in {name for name, *_ in select(lab, ROWS)}


def test_a_step_of_another_system_leads_to_its_response(tmp_path: Path) -> None:
    """Output 2 V after a step of 1 V, falling by 0.5 V with 3 s: in the database and drawn on the recording's page."""
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    t = np.arange(4000) / 100.0
    noise = np.random.default_rng(6).normal(0, 1e-3, t.size)
    since = np.clip(t - 5.0, 0, None)
    answer = np.where(t < 5.0, 0.0, 2.0 - 0.5 * (1 - np.exp(-since / 3.0))) + noise
    channels = {"input": ("V", np.where(t < 5.0, 0.0, 1.0)), "output": ("V", answer)}
    write(raw / "other.mcap", about("other", "step", "other", "X-1", 0), 100.0, channels)
    summary = nightly([raw], lab, jobs=0)
    assert summary.without_result == ()
    rows = select(lab, "SELECT time_s, value FROM relaxation_curves WHERE usable ORDER BY time_s")
    time, value = np.array(rows).T
    np.testing.assert_allclose(value, 2.0 - 0.5 * (1 - np.exp(-time / 3.0)), atol=0.01)
    page = (lab.reports / "recordings" / "other.html").read_text(encoding="utf-8")
    assert "the output over the input goes from" in page


def test_what_was_refused_is_said_with_its_reason(tmp_path: Path) -> None:
    """Steps without a force around them had "no analysis takes a recording of protocol step"; so had sinusoids below the noise a verdict."""
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    t = np.arange(4000) / 100.0
    rng = np.random.default_rng(2)
    voltage = np.where(t % 8 > 4, 3.0, 0.0) + rng.normal(0, 1e-3, t.size)
    force = 0.5 - 0.05 * (t % 8 > 4) + rng.normal(0, 1e-4, t.size)
    force[(t % 8 > 3.2) & (t % 8 < 4.2)] = np.nan
    channels = {"voltage": ("kV", voltage), "force": ("N", force)}
    write(raw / "lost.mcap", about("lost", "step", "electrical", "S-1", 0), 100.0, channels)
    moved = {"displacement": ("mm", 0.2 * np.sin(2 * np.pi * t)), "force": ("N", 0.5 + rng.normal(0, 1, t.size))}
    write(raw / "deaf.mcap", about("deaf", "cyclic", "mechanical", "S-2", 1, frequency_hz=1), 100.0, moved)
    summary = nightly([raw], lab, jobs=0)
    assert len(summary.without_result) == 2
    told = {name: missing for name, _, missing in select(lab, ROWS)}
    assert "5 of 5 have no value: too few force samples around the step" in told["lost"]
    assert "noise: standard error above 30 % of the response" in told["deaf"]
    assert select(lab, "SELECT verdict FROM diagnoses WHERE specimen_id = 'S-2'") == [(None,)]
    ((reasons,),) = select(lab, "SELECT could_not_ask FROM diagnoses WHERE specimen_id = 'S-2'")
    assert "its response is refused, so that nothing can be said of it" in reasons[0]


@pytest.mark.parametrize(
    ("given", "lacking"),
    [
        ({}, "frequency_start_hz and frequency_stop_hz missing"),
        ({"frequency_start_hz": 1}, "frequency_stop_hz missing"),
        ({"frequency_start_hz": 1, "frequency_stop_hz": 20}, None),
    ],
)
def test_a_sweep_that_cannot_be_simulated_is_told_with_the_key_that_lacks(
    tmp_path: Path, given: dict[str, float], lacking: str | None
) -> None:
    """A sweep without its frequencies had a response and no diagnosis, and the night said "all done"."""
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    chirp(raw / "swept.mcap", 1, **({"frequency_start_hz": "", "frequency_stop_hz": ""} | given))
    summary = nightly([raw], lab, jobs=0)
    found = select(lab, ROWS)
    attention = select(lab, "SELECT name, problem FROM needs_attention WHERE status = 'without result'")
    if lacking is None:
        assert (found, attention) == ([], [])
        return
    assert summary.exit_status == 4
    assert "1 recording led to no result" in summary.paragraph()
    ((name, status, missing),) = found
    assert (name, status) == ("swept", "ok")
    assert f"no diagnosis: {lacking}" in missing
    assert "to [recording] of the mapping TOML" in missing
    assert attention == [("swept", missing)]
    assert "all done" not in (lab.reports / "index.html").read_text(encoding="utf-8")
    assert lacking in describe_lab(lab)


@pytest.mark.parametrize(
    ("protocol", "channels", "lacking"),
    [
        ("cyclic", ("displacement", "force"), "frequency_hz"),
        ("cycle", ("displacement", "force"), "film_length_mm"),
        ("cycle", ("stretch", "stress"), None),
    ],
)
def test_what_a_test_needs_for_its_diagnosis_is_told_where_it_lacks(
    tmp_path: Path, protocol: str, channels: tuple[str, str], lacking: str | None
) -> None:
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    t = np.arange(8000) / 200.0
    noise = np.random.default_rng(7)
    sine, triangle = np.sin(2 * np.pi * t), np.interp(t, [0, 20, 40], [0, 1, 0])
    moved = triangle if protocol == "cycle" else 0.2 * sine
    units = ("mm", "N") if channels[0] == "displacement" else ("1", "kPa")
    values = (moved + (1 if channels[0] == "stretch" else 0), 2 * moved + noise.normal(0, 1e-3, t.size))
    recorded = {name: (unit, value) for name, unit, value in zip(channels, units, values, strict=True)}
    write(raw / "one.mcap", about("one", protocol, "mechanical", "S-1", 0), 200.0, recorded)
    nightly([raw], lab, jobs=0)
    told = [missing for _, _, missing in select(lab, ROWS)]
    if lacking is None:
        assert told == []
    else:
        (missing,) = told
        assert f"no diagnosis: {lacking} missing" in missing


def test_a_specimen_without_a_model_is_told_with_the_reason(tmp_path: Path) -> None:
    """Only the bookkeeping of the night said so; the recording has a result, so that it is none of those without."""
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    (raw / "rigs").mkdir(parents=True)
    (raw / "rigs" / "rig-a.toml").write_text(RIG)
    t = np.arange(4000) / 100.0
    x = 0.2 * np.sin(2 * np.pi * t)
    force = 0.5 + x + np.random.default_rng(2).normal(0, 1e-3, t.size)
    channels = {"displacement": ("mm", x), "force": ("N", force)}
    write(raw / "one.mcap", about("one", "cyclic", "mechanical", "S:2", 1, frequency_hz=1), 100.0, channels)
    summary = nightly([raw], lab, jobs=0)
    assert (summary.exit_status, summary.without_result) == (0, ())
    ((name, status, problem),) = select(lab, "SELECT name, status, problem FROM needs_attention")
    assert (name, status) == ("S:2", "without model")
    assert problem == "no model: amplitude 0.2: 1 distinct frequencies or times for 3 parameters of order 1"
    told = describe_lab(lab).partition("Without a model:")[2].splitlines()
    assert told[1].strip() == f"S:2: {problem}"
    (page,) = (lab.reports / "specimens").glob("*.html")
    assert "No model: amplitude 0.2: 1 distinct frequencies" in page.read_text(encoding="utf-8")
    chirp(raw / "a.mcap", 1, specimen_id="S:2")
    nightly([raw], lab, jobs=0)
    assert select(lab, "SELECT name FROM needs_attention WHERE what = 'specimen'") == []
    assert "Without a model" not in describe_lab(lab)


def test_a_rig_without_a_file_is_told_once_where_people_look(tmp_path: Path) -> None:
    """Only the warnings of a model said so."""
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    life(raw / "L-1.mcap", 1)
    assert nightly([raw], lab, jobs=0).notes == (), "lives need no constants of their rig"
    chirp(raw / "a.mcap", 1)
    chirp(raw / "b.mcap", 2)
    wanted = "SELECT name, status, problem FROM needs_attention WHERE what = 'rig'"
    summary = nightly([raw], lab, jobs=0)
    ((name, status, problem),) = select(lab, wanted)
    assert (name, status) == ("rig-a", "without constants")
    assert problem.startswith("rig file rigs/rig-a.toml is not there or gives no load_cell_stiffness_n_per_mm")
    assert "no resonance correction of 2 of its recordings" in problem
    assert problem in summary.notes
    assert problem in describe_lab(lab)
    (raw / "rigs").mkdir()
    (raw / "rigs" / "rig-a.toml").write_text(RIG)
    assert nightly([raw], lab, jobs=0).notes == ()
    assert select(lab, wanted) == []
