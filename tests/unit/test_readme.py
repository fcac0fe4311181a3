"""The READMEs: their code runs, their commands are commands, their links lead somewhere, their generated parts are today's."""

from __future__ import annotations

import importlib.util
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

from ingest.canonical import canonical
from ingest.inspect import FITS, inspect
from ingest.mapping import FileMapping, find_mapping
from ingest.mapping_keys import IGNORE, RECORDING
from ingest.parts import list_parts, name_parts, part_of
from ingest.read import read_raw
from pipeline.cli import main
from pipeline.simulate.plan import load_campaign
from pipeline.transform.respond import respond
from schemas.metadata import RecordingMetadata, RigConstants
from tests.helpers import synthetic_lab
from tests.tools.docs import PARTS, PICTURES, README, ROOT, SHOTS, renew

LINES = 300
"""A README that is longer is not read."""
DOCUMENTS = tuple(
    sorted({*PARTS, *(f".github/{name}.md" for name in ("CONTRIBUTING", "CHANGELOG", "packaging/README"))})
)
TEXTS = {name: (ROOT / name).read_text(encoding="utf-8") for name in DOCUMENTS}
OURS = ("schemas", "ingest", "pipeline", "reports", "tests")


def blocks(language: str, *names: str) -> list[str]:
    found = re.compile(rf"```{language}\n(.*?)```", re.DOTALL)
    return [block for name in names or DOCUMENTS for block in found.findall(TEXTS[name])]


def commands(first: str, *names: str) -> Iterator[list[str]]:
    """Commands of the documents that begin with a word, as a shell takes them apart, up to where they go on to another."""
    for block in blocks("sh", *names):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            if words[:1] == [first]:
                ends = [i for i, word in enumerate(words) if word in ("|", "||", ">")]
                yield words[: min(ends, default=len(words))]


def test_the_readme_is_short() -> None:
    assert len(TEXTS["README.md"].splitlines()) <= LINES


@pytest.mark.parametrize("name", PARTS)
def test_generated_parts_are_up_to_date(name: str) -> None:
    assert renew(name, TEXTS[name], left={"first file"}) == TEXTS[name], "run make docs"


@pytest.mark.slow
def test_the_first_five_minutes_show_what_the_readme_says() -> None:
    """The commands and the mapping are taken from the text, as are the answers that it promises."""
    assert renew("README.md", TEXTS["README.md"]) == TEXTS["README.md"], "run make docs"


def anchors(text: str) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_links_lead_somewhere(name: str) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", TEXTS[name]):
        if "://" in target:
            continue
        file, _, anchor = target.partition("#")
        path = (ROOT / name).parent / file if file else ROOT / name
        assert path.exists(), target
        assert not anchor or anchor in anchors(path.read_text(encoding="utf-8")), target


@pytest.mark.parametrize("name", DOCUMENTS)
def test_files_that_are_named_exist(name: str) -> None:
    """Paths below our packages, from the top of the repository or from the document's own folder."""
    own = (ROOT / name).parent
    for path in re.findall(r"`((?:\w+/)+[\w.]*)`", TEXTS[name]):
        if path.split("/")[0] in OURS:
            assert any(place.exists() or place.with_suffix(".py").exists() for place in (ROOT / path, own / path)), path


@pytest.mark.parametrize("package", ["ingest", "schemas"])
def test_every_module_has_its_place_in_the_table_of_rooms(package: str) -> None:
    table = TEXTS[f"{package}/README.md"].partition("| modules |")[2].partition("\n\n")[0]
    named = set(re.findall(r"`(\w+)`", table))
    families = tuple(re.findall(r"`(\w+_)…`", table))
    modules = {
        path.stem for path in (ROOT / package).iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    assert {name for name in modules - named - {"__init__"} if not name.startswith(families or "/")} == set()
    assert named - modules == set()


@pytest.mark.parametrize("name", DOCUMENTS)
def test_modules_that_are_run_exist_and_targets_are_in_the_makefile(name: str) -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for words in commands("make", name):
        for target in (word for word in words[1:] if "=" not in word):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), words
    for target in re.findall(r"`make ([a-z]+)`", TEXTS[name]):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
    for module in re.findall(r"python -m ([\w.]+)", TEXTS[name]):
        assert importlib.util.find_spec(module) is not None, module
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert set(re.findall(r'"\.\[(\w+)\]"', TEXTS[name])) <= set(extras)


def test_every_command_of_the_documents_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    lines = list(commands("dealab"))
    assert len(lines) > 20
    for words in lines:
        with pytest.raises(SystemExit) as ended:
            main([words[1], "--help"])
        assert ended.value.code == 0
        shown = capsys.readouterr().out
        for word in words:
            assert not word.startswith("--") or word in shown, words


def test_the_citation_is_of_this_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8").splitlines()
    assert f"version: {project['version']}" in citation
    assert f"license: {project['license']}" in citation


def test_the_writer_example_makes_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The example as it stands, with nothing that it does not say itself."""
    monkeypatch.chdir(tmp_path)
    exec(next(block for block in blocks("python") if "RecordingWriter" in block), {})
    raw = read_raw(tmp_path / "P-12_chirp-1.mcap", None)
    recording = canonical(raw, where="example", rig_file=None, source=None)
    assert recording.status == "ok"
    assert recording.channels["displacement"].values.size == 44_000
    assert recording.channels["force"].values.max() == pytest.approx(0.32, rel=1e-2)  # mN became N
    (response,) = respond(recording).responses
    assert response.frequency_hz.max() > 90, "a night has to make something of what the README shows"
    assert np.abs(response.value[response.usable]) == pytest.approx(0.2, rel=0.02)


def test_who_follows_the_readme_from_the_top_measures_two_specimens() -> None:
    """Both examples were of P-07 on one day: the second made a nonsense of the first one's model."""
    writer = next(block for block in blocks("python", "README.md") if "RecordingWriter" in block)
    first = {tomllib.loads(block)["recording"]["specimen_id"] for block in blocks("toml", "README.md")}
    assert first
    assert first.isdisjoint(re.findall(r'"specimen_id": "(.*?)"', writer))


def examples() -> list[tuple[str, str]]:
    """The files that `ingest/README.md` shows with their mappings: content and mapping."""
    return re.findall(r"```csv\n(.*?)```\s*```toml\n(.*?)```", TEXTS["ingest/README.md"], re.DOTALL)


@pytest.mark.parametrize(("content", "mapping"), examples(), ids=lambda text: text.splitlines()[0][:20])
def test_a_file_with_its_mapping_is_what_the_example_says(content: str, mapping: str, tmp_path: Path) -> None:
    name = mapping.splitlines()[0].removeprefix("# ")
    (tmp_path / name).write_text(mapping, encoding="utf-8")
    path = tmp_path / name.removesuffix(".toml")
    path.write_text(content, encoding="utf-8")
    found = find_mapping(path)
    assert found is not None
    parts = [part_of(found, label) for label in list_parts(path, found)] if found.parts_file else [found]
    read = [read_raw(path, part) for part in parts]
    assert all(one.problems == () for one in read)
    assert inspect(path).verdict == FITS
    if found.kind == RECORDING:
        rows = content.strip().splitlines()[
            found.options.get("skip_rows", 0) + 1 + found.options.get("unit_row", False) :
        ]
        recordings = [canonical(one, where=name, rig_file=None, source=None) for one in read]
        sizes = [{channel.values.size for channel in recording.channels.values()} for recording in recordings]
        assert all(len(size) == 1 for size in sizes)
        assert sum(size.pop() for size in sizes) == len(rows)


def test_each_kind_of_file_has_an_example() -> None:
    kinds = {tomllib.loads(mapping).get("kind", RECORDING) for _, mapping in examples()}
    assert kinds == {RECORDING, "lifetimes", "frequency_response", "relaxation"}
    assert any(IGNORE in block for block in blocks("toml", "ingest/README.md"))


@pytest.mark.parametrize("block", blocks("toml"), ids=lambda block: block.splitlines()[0].removeprefix("# "))
def test_every_toml_is_understood(block: str) -> None:
    name, content = Path(block.splitlines()[0].removeprefix("# ")), tomllib.loads(block)
    if name.parent.name == "rigs":
        assert RigConstants.parse(content).extra == {}
        return
    for entry in content.get("files", [content]):
        mapping = FileMapping.parse(entry, stem="x", suffix=Path(name.stem).suffix)
        if mapping.kind == RECORDING:
            abouts = [part_of(mapping, n).recording for n in name_parts(entry)] or [mapping.recording]
            assert all(RecordingMetadata.parse(about).extra == {} for about in abouts)


def test_every_python_is_python() -> None:
    for block in blocks("python"):
        compile(block, "example", "exec")


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a lab in it, as the reader has one."""
    synthetic_lab.whole_story().write(tmp_path / "lab")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_the_demonstration_says_to_try_can_be_asked(there: Path, capsys: pytest.CaptureFixture[str]) -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    queries = re.findall(r"""dealab sql --lab \$\(DEMO\)/lab ['"](SELECT [^'"]*)['"]""", makefile)
    assert len(queries) > 3
    for query in queries:
        assert main(["sql", query, "--lab", "lab"]) == 0, capsys.readouterr().err


def as_in_the_test(code: str) -> str:
    """Names of the demonstration's specimens exchanged for those of the lab at hand."""
    return code.replace("PA-1-sphs-7kV", "P-05_chirp-1").replace("PA-1", "P-07").replace("PA-3", "P-07")


def write_samples(lab: Path, recording: str) -> None:
    """A few samples for a recording of that lab."""
    import duckdb
    import pyarrow as pa
    import pyarrow.parquet as pq

    with duckdb.connect(str(lab / "results.duckdb"), read_only=True) as database:
        query = f"SELECT samples_path FROM recordings WHERE recording_id = '{recording}' AND status = 'ok'"
        ((path,),) = database.sql(query).fetchall()
    (lab / path).parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table({"time_ns": np.arange(9), "force": np.arange(9.0)}), lab / path)


@pytest.mark.long
@pytest.mark.slow
def test_the_notebook_examples_run(there: Path) -> None:
    mpl.use("Agg")
    write_samples(there / "lab", "P-05_chirp-1")
    found: dict[str, Any] = {}
    (short,) = (block for block in blocks("python", "README.md") if "Lab(" in block)
    exec(as_in_the_test(short), found)
    notebook = [block for block in blocks("python", "schemas/README.md") if "Lab(" in block or "fit.campaign" in block]
    assert len(notebook) == 2
    exec(as_in_the_test(notebook[0]), found)
    assert list(found["models"].columns) == ["specimen_id", "model_order", "modulus_mpa"]
    assert len(found["force"]) == 9
    assert found["steps"].attrs["units"]["force_step_n"] == "N"
    assert np.iscomplexobj(found["response"]["value"])
    exec(as_in_the_test(notebook[1]), found)
    assert {"voltage", "force"} <= set(found["expected"].columns)
    assert [p.recording_id for p in load_campaign(there / "what-if.toml").planned] == ["what-if"]


@pytest.mark.slow
def test_the_database_opens_with_duckdb_and_pandas_alone(there: Path) -> None:
    found: dict[str, Any] = {}
    exec(next(block for block in blocks("python") if "import duckdb" in block), found)
    assert {"configuration", "survival"} <= set(found["survival"].columns)
    assert len(found["units"]) > 20


@pytest.mark.slow
def test_the_database_opens_in_duckdbs_own_command_line(there: Path) -> None:
    program = shutil.which("duckdb") or shutil.which("duckdb", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("the command line of DuckDB is not here")
    lines = list(commands("duckdb"))
    assert len(lines) == 2
    for words in lines:
        done = subprocess.run([program, *words[1:]], capture_output=True, text=True, timeout=60, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        assert "k0_n_per_mm" in done.stdout or "alarm" in done.stdout


def test_pictures_are_there_small_and_said_in_words() -> None:
    shown = re.findall(r"!\[([^\]]*)\]\(reports/pictures/([a-z]+)\.png\)", README.read_text(encoding="utf-8"))
    assert {name for _, name in shown} == set(SHOTS)
    assert all(len(alt) > 60 for alt, _ in shown)
    for name in SHOTS:
        content = (PICTURES / f"{name}.png").read_bytes()
        assert content.startswith(b"\x89PNG")
        assert len(content) < 120_000
