"""The recipe for a new mechanism in the README of the diagnosis is complete: followed on a clean copy, what it adds is found."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
RECIPE = (
    (ROOT / "pipeline" / "diagnose" / "README.md").read_text(encoding="utf-8").partition("## Adding a mechanism")[2]
)
PACKAGES = ("schemas", "ingest", "pipeline", "reports")
PLACES = {
    "pipeline/diagnose/mechanisms/sensor.py": ("MECHANISMS = (", "{block}\n\nMECHANISMS = (CURVED_READING, "),
    "schemas/mechanisms.py": (
        "MECHANISMS: dict[str, Mechanism] = {\n",
        "MECHANISMS: dict[str, Mechanism] = {{\n{block}\n",
    ),
    "pipeline/simulate/effects.py": ("_ALL = (\n", "{block}\n\n_ALL = (\n    CURVED_READING,\n"),
}
"""File of a block of the recipe → the line to which it goes, and what that line becomes."""
CAMPAIGN = """
name = "toy"
seed = 7
started_at = 2026-03-01T14:05:00+01:00

[rigs.rig-a]
clamp_mass_kg = 0.187
load_cell_stiffness_n_per_mm = 20.0
damping_ratio = 0.005
load_cell_range_n = 10.0
[rigs.rig-a.file]
clamp_mass_kg_sd = 0.002
load_cell_stiffness_n_per_mm_sd = 0.3

[materials.silicone]
k0_n_per_mm = 0.29
k_n_per_mm = [0.30]
c_n_s_per_mm = [1.4e-2]

[specimens.P-07]
rig = "rig-a"
material = "silicone"
pretension_n = 0.65
[specimens.P-07.geometry]
film_length_mm = 50.0
film_width_mm = 50.0
film_thickness_mm = 0.6
stretch_1 = 1.2
[specimens.P-07.effects.curved_reading]
per_newton = 0.03

[[recordings]]
test = "chirp"
specimens = ["P-07"]
id = "sweep"
amplitude_mm = 0.2
frequency_start_hz = 1
frequency_stop_hz = 100

[[recordings]]
test = "cyclic"
specimens = ["P-07"]
id = "small-cycles"
frequency_hz = 1.0
strain_pp = 0.02
cycles = 10

[[recordings]]
test = "cyclic"
specimens = ["P-07"]
id = "large-cycles"
frequency_hz = 1.0
strain_pp = 0.06
cycles = 10
"""


def follow_recipe(house: Path) -> None:
    """A copy of the packages, with every block of the recipe where it says."""
    for package in PACKAGES:
        shutil.copytree(ROOT / package, house / package, ignore=shutil.ignore_patterns("__pycache__"))
    blocks = [
        textwrap.dedent(text) for text in re.findall(r"^   ```py\n(.*?)^   ```$", RECIPE, re.DOTALL | re.MULTILINE)
    ]
    by_file = {block.splitlines()[0].removeprefix("# "): block.partition("\n")[2].rstrip() for block in blocks}
    assert by_file.keys() == PLACES.keys()
    for file, block in by_file.items():
        line, becomes = PLACES[file]
        text = (house / file).read_text(encoding="utf-8")
        assert text.count(line) == 1, file
        (house / file).write_text(text.replace(line, becomes.format(block=block)), encoding="utf-8")


@pytest.mark.long
@pytest.mark.slow
def test_a_mechanism_added_by_the_recipe_is_found_where_it_is_hidden(tmp_path: Path) -> None:
    follow_recipe(tmp_path)
    (tmp_path / "toy.toml").write_text(CAMPAIGN, encoding="utf-8")

    def run(*words: str) -> str:
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        done = subprocess.run(
            [sys.executable, "-m", "pipeline.cli", *words],
            cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    run("simulate", "toy.toml", "--out", "raw")
    run("nightly", "raw", "--lab", "lab")
    (found,) = json.loads(run("diagnose", "P-07", "--lab", "lab", "--format", "json"))
    assert (found["verdict"], found["mechanism"]) == ("named", "curved_reading")
    # F (1 + c F) over F (1 + b F/F_max): b is c times the largest force of the session.
    severity = found["severity"]["curved_reading"]["curvature"]
    assert severity["value"] == pytest.approx(0.03 * 5.4, rel=0.05)
    assert "Curved reading" in run("diagnose", "P-07", "--lab", "lab")
