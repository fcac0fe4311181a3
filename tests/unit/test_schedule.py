"""Units for systemd, lines for cron and completion for shells: taken in by the programs they are for."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from pipeline.cli import COMMANDS, main
from pipeline.commands.schedule import Job, tell_next, write_crontab, write_units
from schemas.errors import UsageError

AWKWARD = '/data/rig a/50 % "damp" $HOME\'s'


def test_units_pass_systemds_own_check(tmp_path: Path) -> None:
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("systemd-analyze is not here")
    for name, text in write_units(Job([AWKWARD, "/data/b"], tmp_path / "lab"), "02:30").items():
        (tmp_path / name).write_text(text)
    done = subprocess.run(
        [program, "verify", "--man=no", str(tmp_path / "dealab-nightly.timer"), str(tmp_path / "dealab-nightly.service")],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert "dealab-nightly" not in done.stderr, done.stderr


def test_units_start_the_nightly_with_absolute_paths_and_status_3_is_no_failure() -> None:
    made = write_units(Job(["raw"], Path("lab")), "2:5")
    service, timer = made["dealab-nightly.service"], made["dealab-nightly.timer"]
    start = next(line for line in service.splitlines() if line.startswith("ExecStart="))
    words = shlex.split(start.removeprefix("ExecStart="))
    assert words[1:] == ["nightly", str(Path("raw").absolute()), "--lab", str(Path("lab").absolute())]
    assert Path(words[0]).is_absolute()
    assert "SuccessExitStatus=3" in service
    assert "OnCalendar=*-*-* 02:05:00" in timer


def test_awkward_paths_survive_cron_and_its_shell() -> None:
    job = Job([AWKWARD], Path("/lab of mine"))
    line = write_crontab(job, "02:30").splitlines()[-1]
    schedule, rest = line.split(" * * * ")
    assert schedule == "30 2"
    assert "%" not in rest.replace("\\%", "")
    words = shlex.split(rest.replace("\\%", "%"))
    assert words[:4] == ["mkdir", "-p", "/lab of mine", "&&"]
    assert words[4 : 4 + len(job.words)] == job.words


def test_the_line_for_cron_runs_where_there_is_no_lab_yet(tmp_path: Path) -> None:
    """The shell opens the log before the nightly could make its folder."""
    lab = tmp_path / "new" / "lab"
    rest = write_crontab(Job([str(tmp_path)], lab), "02:30").splitlines()[-1].split(" * * * ")[1]
    subprocess.run(["sh", "-c", rest], capture_output=True, timeout=120, check=False)
    assert (lab / "nightly.log").exists()


def test_urls_and_options_of_the_nightly_are_kept() -> None:
    job = Job(["s3://rig-a/2026", "raw"], Path("/lab"), rigs=Path("/rigs"), jobs=3, cluster="tcp://head:8786")
    assert job.words[2:4] == ["s3://rig-a/2026", str(Path("raw").absolute())]
    assert job.words[4:] == ["--lab", "/lab", "--rigs", "/rigs", "--jobs", "3", "--cluster", "tcp://head:8786"]


@pytest.mark.parametrize("text", ["25:00", "2", "02:60", "a:b", "-1:00"])
def test_no_time_of_day_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="no time of day"):
        write_units(Job(["raw"], Path("lab")), text)


def test_units_are_written_where_they_are_wanted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "systemd" / "user"
    assert main(["schedule", "raw", "--out", str(folder)]) == 0
    assert {p.name for p in folder.iterdir()} == {"dealab-nightly.service", "dealab-nightly.timer"}
    told = capsys.readouterr()
    assert "dealab-nightly.timer" in told.out
    assert "raw is not there now" in told.err, "a slip of the pen is told before the night fails over it"


def told_to_type(text: str) -> list[str]:
    """The commands below the words that announce them."""
    return [line.lstrip("# ") for line in text.split("To turn it on")[1].splitlines()[1:]]


def test_what_turns_the_units_on_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Units were written and nothing said that they rest until systemd is told of them."""
    monkeypatch.chdir(tmp_path)
    on = [
        "systemctl --user daemon-reload",
        "systemctl --user enable --now dealab-nightly.timer",
        'loginctl enable-linger "$USER"',
    ]
    assert main(["schedule", str(tmp_path), "--out", "home/systemd/user"]) == 0
    assert [line.split("  #")[0] for line in told_to_type(capsys.readouterr().out)] == on
    assert main(["schedule", str(tmp_path), "--out", "some where"]) == 0
    typed = told_to_type(capsys.readouterr().out)
    places = [tmp_path / "some where" / f"dealab-nightly.{kind}" for kind in ("service", "timer")]
    assert typed[0] == f"systemctl --user link '{places[0]}' '{places[1]}'"
    assert [line.split("  #")[0] for line in typed[1:]] == on[1:]
    assert main(["schedule", "raw", "--lab", "lab", "--at", "02:30"]) == 0
    out = capsys.readouterr().out
    first = shlex.split(told_to_type(out)[0])
    assert first[1:6] == ["schedule", str(tmp_path / "raw"), "--lab", str(tmp_path / "lab"), "--at"]
    assert first[6:] == ["02:30", "--out", "~/.config/systemd/user"]
    assert [line.split("  #")[0] for line in told_to_type(out)[1:]] == on
    assert main(["schedule", str(tmp_path), "--cron"]) == 0
    (typed_line,) = told_to_type(capsys.readouterr().out)[:1]
    assert typed_line.startswith("(crontab -l 2>/dev/null; ")
    assert typed_line.endswith("--cron) | crontab -")


def test_units_of_the_system_are_turned_on_by_its_administrator() -> None:
    lines = tell_next(Path("/etc/systemd/system"))
    assert lines == ["sudo systemctl daemon-reload", "sudo systemctl enable --now dealab-nightly.timer"]


def test_raw_files_that_are_there_are_not_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schedule", str(tmp_path), "s3://rig-a/2026", "--cron"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_the_shells_own_language_and_names_every_command(
    shell: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in COMMANDS)
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"{shell} is not here")
    path = tmp_path / "dealab"
    path.write_text(text)
    done = subprocess.run([program, "-n", str(path)], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")


def completed(text: str, line: str, tmp_path: Path) -> list[str]:
    """What bash offers after a line."""
    words = line.split(" ")
    (tmp_path / "dealab.bash").write_text(text)
    script = (
        f"source {tmp_path}/dealab.bash; COMP_WORDS=({' '.join(map(shlex.quote, words))}); COMP_CWORD={len(words) - 1}; "
        'offer=$(complete -p dealab); offer=${offer##*-F }; ${offer%% *}; printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=60, cwd=tmp_path, check=True)
    return done.stdout.split()


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not here")
def test_bash_completes_commands_options_words_and_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["completion", "bash"])
    text = capsys.readouterr().out
    (tmp_path / "run7.csv").write_text("")
    assert completed(text, "dealab ni", tmp_path) == ["nightly"]
    assert completed(text, "dealab sql --form", tmp_path) == ["--format"]
    assert completed(text, "dealab sql --format pa", tmp_path) == ["parquet"]
    assert completed(text, "dealab inspect run", tmp_path) == ["run7.csv"]
    assert completed(text, "dealab completion fi", tmp_path) == ["fish"]
