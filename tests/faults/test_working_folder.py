"""What lies beside the raw data is data: no module of the folder that a night is started in is ever imported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline import Lab
from tests.conftest import ROOT
from tests.faults.lab_state import select
from tests.helpers.small_lab import life

NAMES = ("numpy", "pipeline", "ingest", "schemas", "reports", "statistics", "multiprocessing", "pyarrow", "pebble")
COMMAND = "import sys\nfrom dealab import main\nif __name__ == '__main__':\n    sys.exit(main())\n"
"""What pip installs as `dealab`."""


@pytest.mark.long
def test_modules_in_the_working_folder_are_not_run(tmp_path: Path) -> None:
    """The command, its workers and the servers that Python starts for them."""
    raw, lab, mark = tmp_path / "raw", Lab(tmp_path / "lab"), tmp_path / "was-run"
    raw.mkdir()
    life(raw / "L-1.mcap", 1)
    (raw / "matplotlibrc").write_bytes(b"# Gr\xf6\xdfe\nfont.size: 30\n")
    for name in NAMES:
        (raw / f"{name}.py").write_text(f"open({str(mark)!r}, 'a').write(__file__)\n")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "command.py").write_text(COMMAND)
    done = subprocess.run(
        [sys.executable, tmp_path / "bin" / "command.py", "nightly", ".", "--lab", str(lab.folder), "--jobs", "1"],
        cwd=raw,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert not mark.exists(), mark.read_text()
    assert done.returncode == 0, done.stderr
    about_settings = [line for line in done.stderr.splitlines() if "matplotlibrc" in line]
    assert [": passed over" in line for line in about_settings] == [True], "it is a raw file, and nobody's settings"
    assert select(lab, "SELECT status FROM recordings") == [("ok",)]
    again = subprocess.run(
        [sys.executable, tmp_path / "bin" / "command.py", "report", "--lab", str(lab.folder)],
        cwd=raw,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (again.returncode, again.stderr) == (0, ""), "settings of the folder are none of the pages'"


def test_settings_of_the_folder_are_those_of_a_notebook_in_it(tmp_path: Path) -> None:
    """Whoever draws in a program of their own keeps their settings; a command has none of them."""
    (tmp_path / "matplotlibrc").write_text("font.size: 30\n")
    draw = "import matplotlib; print(matplotlib.rcParams['font.size'])"
    leave = "from pipeline.import_path import leave_working_folder; leave_working_folder(); "
    told = [
        subprocess.run(
            [sys.executable, "-c", code],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for code in (
            draw,
            f"import pipeline; {draw}",
            f"{leave}{draw}",
            f"{leave}import importlib.util as u; u.find_spec('matplotlib'); {draw}",
        )
    ]
    assert told == ["30.0\n", "30.0\n", "10.0\n", "10.0\n"]


def test_an_empty_entry_of_the_path_is_the_working_folder(tmp_path: Path) -> None:
    """`PYTHONPATH=$PYTHONPATH:/somewhere` leaves one at the front where nothing was set before."""
    mark = tmp_path / "was-run"
    (tmp_path / "numpy.py").write_text(f"open({str(mark)!r}, 'a').write(__file__)\n")
    code = (
        "import sys; from pipeline.import_path import *; leave_working_folder(); import numpy\n"
        "import os; print(os.getcwd() in sys.path, '' in sys.path)\n"
        "with start_without_working_folder(): import subprocess; subprocess.run([sys.executable, '-c', 'import numpy'])"
    )
    environment = {**os.environ, "PYTHONPATH": f"{os.pathsep}{ROOT}"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == "False False\n"
    assert not mark.exists()
