"""Every command that a message or a page tells people to type is typed here, and does what it was named for."""

from __future__ import annotations

import ast
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

import pipeline.nightly.night
from ingest.extras import EXTRAS, advise_install
from pipeline import Lab
from pipeline.cli import COMMANDS, main
from tests.conftest import ROOT
from tests.helpers.small_lab import life

_OURS = ("schemas", "ingest", "pipeline", "reports")
_COMMAND = re.compile(rf"(?:dealab (?:{'|'.join(COMMANDS)})\b|pip install )[^`\n]*")
_TYPED = re.compile(r"(?:(?<=`)|^)(?:dealab|pip|\{shlex.quote\(sys.executable\)\} -m pip) [^`\n]*", re.MULTILINE)
"""Commands are between backticks, or lines of their own."""
_SPELLERS = {"code": "", "spell_command": "dealab "}
"""Functions that put a command between backticks, and what they put before it."""
_MAY_TELL = re.compile(rf"dealab|pip install|\b(?:{'|'.join(_SPELLERS)})\(")
"""What stands in every module that names a command: no other is read, for every run of tests waits for it."""
_NOT_TYPED = ("pipeline/cli.py", "pipeline/commands/completion.py", "ingest/extras.py")
"""Epilogs, whose examples `test_cli.py` parses; comments in generated scripts; `pip`, see below."""
FILL = {
    "RAW": "raw",
    "FILE": "run7.csv",
    "RECORDING": "L-1",
    "TEXT": "loose",
    "{quote_path(path.name)}": "run7.csv",
    "{quote_path(asked)}": "run7.csv",
    "{quote_path(str(path))}": "run7.csv",
    " --yes {wanted}": "",
    "{quote_path(str(draft.path))}": "run7.csv",
    "{folder}": "raw",
    "{quote_path(str(lab))}": "lab",
    "{quote_path(short(r['source_path'] or file, 300))}": "run7.csv",
    "{quote_path(short(paths[0], 300))}": "run7.csv",
    "{query}": "SELECT 1",
}
"""What stands for the words that a message fills in, and for those that a person does."""
ENDS = {"inspect": 3, "add": 1}
"""Exit statuses on a file without a mapping, of which nobody is asked; 0 is the usual one."""


def spell(node: ast.expr) -> str | None:
    """A text or an f-string with its expressions between braces; None for anything else."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if not isinstance(node, ast.JoinedStr):
        return None
    return "".join(
        f"{{{ast.unparse(part.value)}}}" if isinstance(part, ast.FormattedValue) else str(part.value)  # type: ignore[attr-defined]
        for part in node.values
    )


def name_called(node: ast.Call) -> str:
    """The last name of what is called, empty where that is no name."""
    return str(getattr(node.func, "attr", getattr(node.func, "id", "")))


def list_texts(source: str) -> Iterator[str]:
    """The texts in a module without docstrings; words of `code` and `spell_command` as the commands that they become."""
    seen: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if id(node) in seen:
            continue
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            seen.add(id(node.value))
        elif isinstance(node, ast.Call) and name_called(node) in _SPELLERS:
            word = spell(node.args[0])
            seen |= {id(part) for part in ast.walk(node)}
            if word is not None:
                yield f"`{_SPELLERS[name_called(node)]}{word}`"
        elif isinstance(node, ast.expr) and (text := spell(node)) is not None:
            seen |= {id(part) for part in ast.walk(node) if not isinstance(part, ast.Call)}
            yield text


def list_hints() -> dict[str, str]:
    """Command → the module that names it."""
    found: dict[str, str] = {}
    for folder in _OURS:
        for file in sorted((ROOT / folder).rglob("*.py")):
            name, source = file.relative_to(ROOT).as_posix(), file.read_text(encoding="utf-8")
            if name in _NOT_TYPED or not _MAY_TELL.search(source):
                continue
            for text in list_texts(source):
                found |= {typed: name for typed in _TYPED.findall(text) if _COMMAND.search(typed)}
                rest = _TYPED.sub("", text)
                assert not _COMMAND.search(rest), f"{name}: a command that is not between backticks: {text}"
    return found


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with raw files, one without a mapping beside them, and a lab after a night."""
    folder = tmp_path_factory.mktemp("hints")
    (folder / "raw").mkdir()
    life(folder / "raw" / "L-1.mcap", 1)
    (folder / "run7.csv").write_text("t (s),F\n" + "".join(f"{t / 10},{t % 7}\n" for t in range(40)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
        assert main(["nightly", str(folder / "raw"), "--lab", str(folder / "lab"), "--jobs", "0"]) == 0
    return folder


@pytest.mark.long_after(1)
@pytest.mark.parametrize("hint", [hint for hint in list_hints() if hint.startswith("dealab")])
def test_a_command_that_is_told_does_something(
    hint: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
    typed = hint
    for words, stand_in in FILL.items():
        typed = typed.replace(words, stand_in)
    assert "{" not in typed, f"{list_hints()[hint]}: say in FILL what stands for the words between braces"
    words = shlex.split(typed)[1:]
    assert main(words) == ENDS.get(words[0], 0), capsys.readouterr().err


def test_the_answers_that_are_asked_for_can_be_given_as_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also for a file elsewhere, whose name a shell would take apart."""
    file = tmp_path / "it's run 7; a.csv"
    file.write_text("t (s),F\n" + "".join(f"{t / 10},{t % 7}\n" for t in range(40)))
    assert main(["add", str(file)]) == 1
    (typed,) = _TYPED.findall(capsys.readouterr().err)
    assert main([word.replace("…", "7") for word in shlex.split(typed)[1:]]) != 2
    assert "there is no" not in capsys.readouterr().err


NASTY = (
    "-x.csv",
    "--lab.csv",
    "a b.csv",
    "$(touch pwned).csv",
    "a;b&c.csv",
    "*.csv",
    "~x.csv",
    "#x.csv",
    'say "x".csv',
    "a\\b.csv",
    "%s.csv",
)
"""Names that a shell or a command would take for something else."""


@pytest.mark.long_after(1)
@pytest.mark.parametrize("name", NASTY)
def test_what_is_told_of_a_file_works_as_printed_whatever_its_name(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).write_text("t (s),F\n" + "".join(f"{t / 10},{t % 7}\n" for t in range(40)))
    for command in ("inspect", "validate", "add"):
        main([command, "--", name])
        said = "".join(capsys.readouterr())
        told = [typed for typed in _TYPED.findall(said) if "FILE" not in typed]
        assert told, said
        for typed in told:
            main([word.replace("…", "7") for word in shlex.split(typed)[1:]])
            again = capsys.readouterr().err
            assert "there is no" not in again, (typed, again)
            assert "required" not in again, (typed, again)
    assert not Path("pwned").exists()


def test_a_hint_names_the_lab_that_was_meant(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a lab").mkdir()
    assert main(["status", "--lab", str(tmp_path / "a lab")]) == 1
    (typed,) = _TYPED.findall(capsys.readouterr().err)
    assert shlex.split(typed)[-1] == str(tmp_path / "a lab")
    assert Lab().spell_command("status") == "`dealab status`"


def test_packages_of_the_extras_are_those_of_the_project() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert {extra: tuple(re.split("[<>=]", one)[0] for one in needed) for extra, needed in declared.items()} == EXTRAS


def test_pip_installs_what_it_is_told() -> None:
    """Without an index: all are installed here, and a name that is not is an error."""
    named = sorted(
        {word for extra in EXTRAS for typed in _TYPED.findall(advise_install(extra)) for word in typed.split()[2:]}
    )
    assert len(named) == sum(map(len, EXTRAS.values()))
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--dry-run",
        "--no-index",
        "--no-deps",
        "--disable-pip-version-check",
    ]
    done = subprocess.run(
        [*pip, *named], capture_output=True, text=True, check=False, env={**os.environ, "PIP_FIND_LINKS": ""}
    )
    assert done.returncode == 0, done.stderr
