"""The README's code runs and its generated parts are those of today."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

from ingest.canonical import canonical
from ingest.mapping import find_mapping
from ingest.read import read_raw
from pipeline.cli import main
from pipeline.simulate.plan import load_campaign
from tests.helpers import synthetic_lab
from tests.tools.docs import PICTURES, README, SHOTS, renewed

TEXT = README.read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def test_generated_parts_are_up_to_date() -> None:
    assert renewed(TEXT) == TEXT, "run make docs"


def test_the_writer_example_makes_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    start = 1_772_370_300_000_000_000

    def some_blocks():
        for i in range(4):
            t = (i * 1000 + np.arange(1000)) / 2000
            yield start + i * 500_000_000, np.sin(60 * t), 800 * np.sin(60 * t)

    exec(blocks("python")[0], {"blocks": some_blocks})
    raw = read_raw(tmp_path / "P-07_chirp-1.mcap", None)
    recording = canonical(raw, where="example", rig_file=None, source=None)
    assert recording.status == "ok"
    assert recording.channels["force"].values.max() == pytest.approx(0.8, rel=1e-2)  # mN became N


def test_the_mapping_example_makes_a_recording(tmp_path: Path) -> None:
    toml = next(block for block in blocks("toml") if "Kraft" in block)
    rows = [f"{i / 1000:.4f};{np.sin(i / 20):.5f};{2 + np.sin(i / 20):.5f}".replace(".", ",") for i in range(4000)]
    text = "Prüfstand 3\nPrüfer: Ö\n\nt;Weg;Kraft\ns;mm;N\n" + "\n".join(rows) + "\n"
    (tmp_path / "run7.csv").write_bytes(text.encode("cp1252"))
    (tmp_path / "run7.csv.toml").write_text(toml, encoding="utf-8")
    path = tmp_path / "run7.csv"
    raw = read_raw(path, find_mapping(path))
    recording = canonical(raw, where="example", rig_file=None, source=None)
    assert recording.metadata.recording_id == "run7"
    assert recording.channels["displacement"].values.size == 4000


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a lab in it, as the README's reader has one."""
    synthetic_lab.whole_story().write(tmp_path / "lab")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def as_in_the_test(code: str) -> str:
    """Names of the demonstration's specimens exchanged for those of the lab at hand."""
    return code.replace("PA-1-sphs-7kV", "P-05_chirp-1").replace("PA-1", "P-07").replace("PA-3", "P-07")


def samples(lab: Path, recording: str) -> None:
    """A few samples for a recording of that lab."""
    import duckdb
    import pyarrow as pa
    import pyarrow.parquet as pq

    with duckdb.connect(str(lab / "results.duckdb"), read_only=True) as database:
        query = f"SELECT samples_path FROM recordings WHERE recording_id = '{recording}' AND status = 'ok'"
        ((path,),) = database.sql(query).fetchall()
    (lab / path).parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table({"time_ns": np.arange(9), "force": np.arange(9.0)}), lab / path)


def test_the_notebook_examples_run(there: Path) -> None:
    mpl.use("Agg")
    samples(there / "lab", "P-05_chirp-1")
    found: dict[str, Any] = {}
    notebook = [block for block in blocks("python") if "Lab(" in block or "fit.campaign" in block]
    assert len(notebook) == 2
    exec(as_in_the_test(notebook[0]), found)
    assert list(found["models"].columns) == ["specimen_id", "model_order", "modulus_mpa"]
    assert len(found["force"]) == 9
    assert found["steps"].attrs["units"]["force_step_n"] == "N"
    assert np.iscomplexobj(found["response"]["value"])
    exec(as_in_the_test(notebook[1]), found)
    assert [p.recording_id for p in load_campaign(there / "what-if.toml").planned] == ["what-if"]


def test_the_database_opens_with_duckdb_and_pandas_alone(there: Path) -> None:
    found: dict[str, Any] = {}
    exec(next(block for block in blocks("python") if "import duckdb" in block), found)
    assert {"configuration", "survival"} <= set(found["survival"].columns)
    assert len(found["units"]) > 20


def test_the_database_opens_in_duckdbs_own_command_line(there: Path) -> None:
    program = shutil.which("duckdb") or shutil.which("duckdb", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("the command line of DuckDB is not here")
    lines = [line for block in blocks("sh") for line in block.splitlines() if line.startswith("duckdb ")]
    assert len(lines) == 2
    for line in lines:
        words = shlex.split(line)
        done = subprocess.run([program, *words[1:]], capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stderr) == (0, "")
        assert "k0_n_per_mm" in done.stdout or "alarm" in done.stdout


def test_every_command_of_the_readme_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    lines = [line for block in blocks("sh") for line in block.splitlines() if line.startswith("dealab ")]
    assert len(lines) > 8
    for line in lines:
        with pytest.raises(SystemExit) as ended:
            main([shlex.split(line)[1], "--help"])
        assert ended.value.code == 0
        shown = capsys.readouterr().out
        for word in shlex.split(line.partition(" #")[0]):
            assert not word.startswith("--") or word in shown, (line, word)


def test_pictures_are_there_small_and_said_in_words() -> None:
    shown = re.findall(r"!\[([^\]]*)\]\(reports/pictures/([a-z]+)\.png\)", TEXT)
    assert {name for _, name in shown} == set(SHOTS)
    assert all(len(alt) > 60 for alt, _ in shown)
    for name in SHOTS:
        content = (PICTURES / f"{name}.png").read_bytes()
        assert content.startswith(b"\x89PNG")
        assert len(content) < 120_000
