"""What pip installs, in an environment of its own, with what others put over it; every remedy is typed as it is printed."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from tests.conftest import ROOT

_QUIET = ("--quiet", "--disable-pip-version-check")
_ALONE = ("--no-index", "--no-deps", "--no-compile")
FOREIGN = {"report": "reports/__init__.py", "doctor": "schemas/errors.py", "status": "pipeline/__init__.py"}
"""Files that other distributions have under the same names, and the command that is typed after each came."""


class Installed:
    """An environment with dealab and none of the libraries that it needs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        venv.create(folder / "venv", with_pip=False)
        self.python = folder / "venv" / "bin" / "python"
        subprocess.run(
            [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder],
            cwd=ROOT,
            check=True,
            capture_output=True,
        )
        self.pip("install", str(next(folder.glob("*.whl"))))
        self.packages = next((folder / "venv").glob("lib/python*/site-packages"))

    def pip(self, what: str, *words: str) -> None:
        options = _ALONE if what == "install" else ()
        command = [sys.executable, "-m", "pip", "--python", str(self.python), what, *_QUIET, *options, *words]
        subprocess.run(command, check=True, capture_output=True)

    def type(self, *words: str) -> tuple[int, str]:
        """The exit status of a command and what it said, which is no traceback."""
        command = [self.python.with_name("dealab"), *words]
        alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        done = subprocess.run(command, cwd=self.folder, env=alone, capture_output=True, text=True, check=False)
        assert "Traceback" not in done.stderr, done.stderr
        return done.returncode, done.stdout + done.stderr

    def follow(self, said: str) -> None:
        """Does what a remedy tells."""
        for command in re.findall("`([^`]*)`", said):
            python, _, pip, what, *words = shlex.split(command)
            assert (python, pip) == (str(self.python), "pip")
            self.pip(what, *words)

    def install_foreign(self, name: str, file: str) -> None:
        """What pip does with another distribution that has such a file: ours is written over."""
        about = {f"{name}-1.0.dist-info/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n"}
        about |= {file: "raise RuntimeError('the wrong package')\n", f"{name}-1.0.dist-info/INSTALLER": "pip\n"}
        about |= {f"{name}-1.0.dist-info/RECORD": "".join(f"{each},,\n" for each in about)}
        for each, text in about.items():
            (self.packages / each).parent.mkdir(exist_ok=True)
            (self.packages / each).write_text(text)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    return Installed(tmp_path_factory.mktemp("an environment"))


@pytest.mark.long
@pytest.mark.slow
def test_without_its_libraries_it_says_which_are_missing(installed: Installed) -> None:
    status, said = installed.type("doctor")
    assert status == 1
    assert said.splitlines()[0] == "ok       packages are ours"
    assert "packaging is missing; `" in said
    status, said = installed.type("inspect", "nothing.csv")
    assert status == 1
    assert re.fullmatch(r"dealab: the library \w+ is missing. `dealab doctor` lists what is needed\n", said)
    assert installed.type("--version") == (0, "dealab 0.1.0\n")


@pytest.mark.long
@pytest.mark.slow
def test_packages_of_others_are_refused_until_the_remedy_is_followed(installed: Installed) -> None:
    told = {}
    for command, file in FOREIGN.items():
        name = file.partition("/")[0]
        installed.install_foreign(name, file)
        told[command] = installed.type(command)
        assert told[command][0] == 1
        assert file in told[command][1]
        assert re.search(f"the package .*{name}.* has the same names", told[command][1])
    installed.follow(told["status"][1])
    assert installed.type("doctor")[1].splitlines()[0] == "ok       packages are ours"


def test_a_file_that_is_missing_is_refused_and_an_edited_one_is_told(installed: Installed) -> None:
    file = installed.packages / "reports" / "names.py"
    text = file.read_text()
    file.write_text(f"{text}\n# ours\n")
    assert "files of dealab are not as installed: reports/names.py" in installed.type("doctor")[1]
    assert "library" in installed.type("inspect", "nothing.csv")[1]
    file.unlink()
    status, said = installed.type("inspect", "nothing.csv")
    file.write_text(text)
    assert status == 1
    assert said.startswith(
        f"dealab: files of dealab are missing: reports/names.py. `{shlex.quote(str(installed.python))} -m pip"
    )


def test_the_door_for_notebooks_is_one_file() -> None:
    import dealab
    from pipeline import Lab

    assert dealab.Lab is Lab
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        dealab.Nothing
