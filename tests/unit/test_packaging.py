"""The recipes of `.github/packaging`: what can be held of them where no image can be built, and the script that waits for the night."""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.cli import main
from tests.conftest import ROOT
from tests.tools.recipe import CONTAINERFILE, PACKAGING, healthcheck, list_steps
from tests.tools.release import PACKAGES
from tests.unit.test_requirements import SUPPORTED

STEPS = list_steps(CONTAINERFILE.read_text(encoding="utf-8"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CONDA_NAMES = {"duckdb": "python-duckdb", "matplotlib": "matplotlib-base"}
"""Names that are others on conda-forge."""


def words_of(instruction: str, stage: int) -> list[str]:
    return [step.words for step in STEPS if (step.instruction, step.stage) == (instruction, stage)]


def read_yaml(name: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((PACKAGING / name).read_text(encoding="utf-8"))
    return found


def test_instructions_are_taken_apart() -> None:
    steps = list_steps("# about\nARG A=1\nFROM a AS b\nRUN one \\\n    && two\nFROM a\nUSER 1\n")
    assert [(step.stage, step.instruction, step.words) for step in steps] == [
        (-1, "ARG", "A=1"),
        (0, "FROM", "a AS b"),
        (0, "RUN", "one && two"),
        (1, "FROM", "a"),
        (1, "USER", "1"),
    ]


def test_the_image_has_what_is_pinned_and_nothing_that_builds() -> None:
    arguments = dict(step.words.split("=", 1) for step in STEPS if step.stage == -1)
    assert arguments["PYTHON"] in SUPPORTED
    assert [words_of("FROM", stage) for stage in (0, 1)] == [["${BASE} AS build"], ["${BASE}"]]
    first, second = words_of("RUN", 0)
    assert "--require-hashes --only-binary :all:" in first
    assert "--no-build-isolation" in second
    assert second.count("--no-deps") == 2
    copied = {name for words in words_of("COPY", 0) for name in words.split()[:-1]}
    assert {*PACKAGES, "dealab.py", "pyproject.toml", "LICENSE", PROJECT["readme"]} < copied
    last = [words for words in words_of("COPY", 1) if not words.startswith("--from=build /opt/dealab ")]
    assert [words.split()[1] for words in last] == [".github/packaging/every-night"]
    assert not any(step.instruction == "ADD" for step in STEPS)


def test_what_is_copied_is_there_and_not_ignored() -> None:
    ignored = (PACKAGING / "Containerfile.dockerignore").read_text(encoding="utf-8").split()
    assert ignored[0] == "*"
    kept = [name.removeprefix("!") for name in ignored if name.startswith("!")]
    for words in (*words_of("COPY", 0), *words_of("COPY", 1)[1:]):
        for name in (word for word in words.split()[:-1] if not word.startswith("--")):
            for version in SUPPORTED:
                file = name.replace("${PYTHON}", version)
                assert (ROOT / file).exists()
                assert any(fnmatch(file, pattern) for pattern in kept), file


def test_it_runs_as_nobody_and_says_how_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    (user,) = words_of("USER", 1)
    assert all(int(number) > 0 for number in user.split(":"))
    assert [step.instruction for step in STEPS][-1] == "ENTRYPOINT"
    program, command, option, lab = healthcheck(STEPS)
    assert (program, option, [lab]) == ("dealab", "--lab", words_of("VOLUME", 1))
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    assert option in capsys.readouterr().out


def test_compose_reads_raw_data_and_writes_the_lab_alone() -> None:
    compose = read_yaml("compose.yaml")
    assert set(compose) == {"name", "services", "volumes"}
    (service,) = compose["services"].values()
    context = PACKAGING / service["build"]["context"]
    assert (context / service["build"]["dockerfile"]).resolve() == CONTAINERFILE
    mounts = {mount["target"]: mount for mount in service["volumes"]}
    assert set(mounts) == {"/raw", "/lab"}
    assert mounts["/raw"]["read_only"] is True
    assert mounts["/lab"]["source"] in compose["volumes"]
    assert service["healthcheck"]["test"] == ["CMD", *healthcheck(STEPS)]
    assert (service["read_only"], service["cap_drop"]) == (True, ["ALL"])
    (variables,) = (words for words in words_of("ENV", 1))
    assert {word.partition("=")[0] for word in variables.split()} > set(service["environment"])


def test_the_conda_recipe_asks_for_what_the_project_does() -> None:
    recipe = read_yaml("conda/recipe.yaml")
    assert recipe["context"]["version"] == PROJECT["version"]
    asked = [re.fullmatch(r"([\w-]+)(.*)", word) for word in PROJECT["dependencies"]]
    wanted = {f"{CONDA_NAMES.get(found[1], found[1])} {found[2]}" for found in asked if found}
    assert len(wanted) == len(PROJECT["dependencies"])
    python = f"python {PROJECT['requires-python']}"
    assert set(recipe["requirements"]["run"]) == wanted | {python}
    assert python in recipe["requirements"]["host"]
    (entry,) = PROJECT["scripts"].items()
    assert recipe["build"]["python"]["entry_points"] == [" = ".join(entry)]
    assert recipe["about"]["summary"] == PROJECT["description"]
    assert (PACKAGING / "conda" / recipe["source"]["path"]).resolve() == ROOT


def pretend(folder: Path, **programs: str) -> dict[str, str]:
    """Variables with which these programs are found first."""
    folder.mkdir()
    for name, text in programs.items():
        (folder / name).write_text(f"#!/bin/sh\n{text}\n")
        (folder / name).chmod(0o755)
    return {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}


def wait_for_night(variables: dict[str, str], *words: str) -> subprocess.CompletedProcess[str]:
    script = str(PACKAGING / "every-night")
    return subprocess.run(
        ["sh", script, *words], env=variables, capture_output=True, text=True, timeout=20, check=False
    )


def test_a_night_at_once_has_its_options_and_its_status(tmp_path: Path) -> None:
    variables = pretend(tmp_path / "bin", dealab='echo "$@"; exit 3')
    done = wait_for_night({**variables, "NOW": "1", "LAB": "/there"}, "--jobs", "2")
    assert (done.returncode, done.stdout) == (3, "nightly /raw --lab /there --jobs 2\n")


@pytest.mark.parametrize(
    ("now", "at", "expected"),
    [
        ("2026-11-30 01:00", "02:30", "2026-11-30 02:30 CET"),
        ("2026-11-30 03:00", "02:30", "2026-12-01 02:30 CET"),
        ("2026-11-30 03:00", "08:09", "2026-11-30 08:09 CET"),
        ("2026-03-29 01:00", "02:30", "2026-03-29 03:30 CEST"),  # the clocks go from 2 to 3
        ("2026-03-28 12:00", "02:30", "2026-03-29 03:30 CEST"),
        ("2026-10-25 01:00", "02:30", "2026-10-25 02:30 CET"),  # the clocks go from 3 to 2: the second one
    ],
)
def test_the_next_night_is_at_its_hour_in_its_time_zone(now: str, at: str, expected: str, tmp_path: Path) -> None:
    """With a clock that stands still, until the sleep ends the script."""
    date = f"""
[ "$*" = "+%s" ] && exec /bin/date --date "{now}" +%s
when=$(echo "$2" | sed "s/^today/{now[:10]}/")
case $when in tomorrow*) when="$(/bin/date --date "{now[:10]} 12:00 tomorrow" +%F) ${{when#tomorrow }}" ;; esac
exec /bin/date --date "$when" "$3"
"""
    variables = pretend(tmp_path / "bin", date=date, sleep='echo "for $1 s"; kill $PPID', dealab="exit 9")
    done = wait_for_night({**variables, "TZ": "Europe/Berlin", "AT": at})
    assert done.stdout.splitlines()[0] == f"next night: {expected}", done.stderr
    assert done.returncode == 143


def test_nights_follow_each_other_and_a_wrong_time_is_told(tmp_path: Path) -> None:
    night = f'echo "$@" >> {tmp_path}/nights; [ $(wc -l < {tmp_path}/nights) -lt 3 ] || kill $PPID; exit 4'
    variables = pretend(tmp_path / "bin", dealab=night, sleep="exit 0")
    done = wait_for_night({**variables, "AT": "02:30"})
    assert (tmp_path / "nights").read_text() == "nightly /raw --lab /lab\n" * 3
    assert done.stdout.count("the night ended with status 4") >= 2
    wrong = wait_for_night({**variables, "AT": "2:30 pm"})
    assert (wrong.returncode, wrong.stderr) == (2, 'AT is "2:30 pm"; expected a time such as 02:30\n')
