"""The container recipe, taken apart: its instructions, and what it would do done in a folder instead of a container."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGING = ROOT / ".github" / "packaging"
CONTAINERFILE = PACKAGING / "Containerfile"


@dataclass(frozen=True)
class Step:
    """One instruction, with the stage that it is in, from 0."""

    stage: int
    instruction: str
    words: str


def list_steps(text: str) -> list[Step]:
    """The instructions of a Containerfile in their order; those before the first `FROM` have stage −1."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    joined = re.sub(r"\\\n\s*", "", "\n".join(lines)).splitlines()
    steps: list[Step] = []
    stage = -1
    for line in joined:
        instruction, _, words = line.partition(" ")
        stage += instruction == "FROM"
        steps.append(Step(stage, instruction, words.strip()))
    return steps


def healthcheck(steps: list[Step]) -> list[str]:
    """The command that a container's health is asked by."""
    (words,) = (step.words for step in steps if step.instruction == "HEALTHCHECK")
    found: list[str] = json.loads(words.partition("CMD ")[2])
    return found


def build_in(folder: Path, python: str, version: str) -> Path:
    """Does the first stage in a folder with a Python of this machine: its copies and its commands, with the folder before each path.

    Returns the environment that it makes. Raises `SystemExit` with what was said where a command fails.
    """
    steps = list_steps(CONTAINERFILE.read_text(encoding="utf-8"))
    programs = folder / "programs"
    programs.mkdir(parents=True)
    (programs / "python3").symlink_to(shutil.which(python) or python)
    environment = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"}
    environment.pop("PYTHONPATH", None)
    source = folder / "source"
    source.mkdir()
    for step in (step for step in steps if step.stage == 0):
        words = step.words.replace("${PYTHON}", version)
        if step.instruction == "COPY":
            *names, target = words.split()
            for name in names:
                _copy(ROOT / name, source / target / Path(name).name if target.endswith("/") else source / target)
        elif step.instruction == "RUN":
            moved = re.sub(r"(?<![\w.])/(?=(?:opt|wheels)\b)", f"{folder}/", words)
            done = subprocess.run(
                ["sh", "-ec", moved], cwd=source, env=environment, capture_output=True, text=True, check=False
            )
            if done.returncode:
                raise SystemExit(f"{moved}: status {done.returncode}\n{done.stdout}{done.stderr}")
    return folder / "opt" / "dealab"


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
    else:
        shutil.copyfile(source, target)
