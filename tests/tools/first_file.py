"""The first five minutes of the README, done as it says: its commands, its mapping, and what they show."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

HEADING = "## Your first file in five minutes"
_DONE, _ATTENTION = 0, 3
"""Statuses of a command that did what it was asked; 3 also says that a file needs attention."""
_SHOWN = 3
"""The last commands, whose output the README shows."""
_BLOCK = re.compile(r"```(sh|toml)\n(.*?)```", re.DOTALL)


@dataclass(frozen=True)
class Done:
    """A command with what it said on both outputs."""

    command: str
    said: str


def follow(readme: Path, folder: Path, environment: Mapping[str, str]) -> list[Done]:
    """Does what the section says in an empty folder: files are saved under the name in their first line, commands are run.

    `environment` says which `dealab` that is. Raises `SystemExit` with all that was said when a command fails.
    """
    section = readme.read_text(encoding="utf-8").partition(HEADING)[2].partition("\n## ")[0]
    done: list[Done] = []
    for language, content in _BLOCK.findall(section):
        if language == "toml":
            (folder / content.splitlines()[0].removeprefix("# ")).write_text(content, encoding="utf-8")
            continue
        done += [run(line, folder, environment) for line in content.splitlines()]
    return done


def of_the_checkout(root: Path) -> dict[str, str]:
    """An environment whose `dealab` is that of the checkout."""
    return {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(root),
    }


def run(line: str, folder: Path, environment: Mapping[str, str]) -> Done:
    """Runs a line of a shell in a folder. Raises `SystemExit` with all that was said when it fails."""
    command = line.partition("  #")[0].rstrip()
    ended = subprocess.run(
        ["bash", "-euc", command],
        cwd=folder,
        env={**environment, "COLUMNS": "120"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
        check=False,
    )
    if ended.returncode not in (_DONE, _ATTENTION):
        raise SystemExit(f"{command}: status {ended.returncode}\n{ended.stdout}")
    return Done(command, ended.stdout.replace(f"{folder}/", "").replace(f"{folder.resolve()}/", ""))


def shown(readme: Path) -> str:
    """What the last commands of the section say with the `dealab` of the checkout."""
    with tempfile.TemporaryDirectory() as folder:
        return show(follow(readme, Path(folder), of_the_checkout(readme.parent)))


def without_times(said: str) -> str:
    """What a night said, without its progress and the time that it took, which are those of this machine."""
    steady = re.sub(r"^dealab: after [0-9]+ s: .*\n", "", said, flags=re.MULTILINE)
    return re.sub(r"took .+, its pages .+ more[.]$", "took …, its pages … more.", steady, flags=re.MULTILINE)


def show(done: Sequence[Done]) -> str:
    """The last commands and what they said, without the time that a night took."""
    blocks = [f"$ {one.command}\n{without_times(one.said).rstrip()}" for one in done[-_SHOWN:]]
    return "```text\n" + "\n".join(blocks) + "\n```"
