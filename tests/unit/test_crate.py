"""Crates: the same bytes for the same results, nothing of the machine in them, and every change found."""

from __future__ import annotations

import hashlib
import json
import shutil
import zipfile
from pathlib import Path

import pytest

from pipeline.cli import main
from pipeline.commands.crate.archive import read_crate
from pipeline.nightly.night import nightly
from tests.helpers import synthetic_lab
from tests.helpers.small_lab import make_lab_of_one_life

ABOUT = """title = "Films"
publisher = "A university"
publication_year = 2026
license = "https://creativecommons.org/licenses/by/4.0/"
[[creators]]
name = "Mills, Ada"
orcid = "https://orcid.org/0000-0002-1825-0097"
affiliation = "A university"
affiliation_url = "https://university.example"
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic_lab.small_story().write(tmp_path_factory.mktemp("crate") / "lab")


@pytest.fixture(scope="module")
def crate(lab: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("written")
    (folder / "about.toml").write_text(ABOUT)
    target = folder / "films.zip"
    assert main(["export", "--crate", str(target), "--about", str(folder / "about.toml"), "--lab", str(lab)]) == 0
    return target


def unpack(crate: Path, folder: Path) -> Path:
    with zipfile.ZipFile(crate) as archive:
        archive.extractall(folder)
    return folder


def digest_said(text: str) -> str:
    return text.split("SHA-256 of the results: ")[1].split()[0]


@pytest.mark.long
def test_a_lab_elsewhere_gives_the_same_crate(lab: Path, crate: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "another place" / "lab"
    shutil.copytree(lab, elsewhere)
    (tmp_path / "about.toml").write_text(ABOUT)
    again = tmp_path / "films.zip"
    assert (
        main(["export", "--crate", str(again), "--about", str(tmp_path / "about.toml"), "--lab", str(elsewhere)]) == 0
    )
    assert again.read_bytes() == crate.read_bytes()


@pytest.mark.long
@pytest.mark.slow
def test_nights_in_two_folders_give_the_same_digest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        raw, lab = make_lab_of_one_life(tmp_path / name)
        shutil.copy(raw / "L-1.mcap", raw / "copy.mcap")  # a duplicate names the other file with its folder
        nightly([raw], lab, jobs=0)
        capsys.readouterr()
        assert main(["export", "--crate", str(tmp_path / f"{name}.zip"), "--lab", str(lab.folder)]) == 0
        said.append(digest_said(capsys.readouterr().out))
    assert said[0] == said[1]
    files = read_crate(tmp_path / "first.zip")
    results = b"".join(
        content for name, content in files.items() if name.split("/")[0] in ("tables", "models", "figures")
    )
    assert str(tmp_path).encode() not in results
    assert main(["verify", str(tmp_path / "first.zip"), "--lab", str(tmp_path / "second" / "lab")]) == 0
    assert "all tables, models and figures are the same" in capsys.readouterr().out


def test_the_metadata_name_every_file_and_recording(crate: Path) -> None:
    files = read_crate(crate)
    graph = {e["@id"]: e for e in json.loads(files["ro-crate-metadata.json"])["@graph"]}
    assert graph["ro-crate-metadata.json"]["conformsTo"] == {"@id": "https://w3id.org/ro/crate/1.1"}
    assert graph["./"]["license"] == {"@id": "https://creativecommons.org/licenses/by/4.0/"}
    parts = {part["@id"] for part in graph["./"]["hasPart"]}
    assert parts == set(files) - {"ro-crate-metadata.json"}
    for name in parts:
        assert graph[name]["sha256"] == hashlib.sha256(files[name]).hexdigest()
        assert graph[name]["contentSize"] == str(len(files[name]))
    author = graph[graph["./"]["author"]["@id"]]
    assert graph[author["affiliation"]["@id"]] == {
        "@id": "https://university.example", "@type": "Organization", "name": "A university",
        "url": "https://university.example",
    }  # fmt: skip
    night = graph["#night"]
    assert night["instrument"] == {"@id": "#dealab"}
    rests_on = night["object"] if isinstance(night["object"], list) else [night["object"]]
    assert all(graph[r["@id"]]["sha256"] == r["@id"].removeprefix("#recording-") for r in rests_on)
    cited = json.loads(files["datacite.json"])
    assert cited["creators"][0]["nameIdentifiers"][0]["nameIdentifier"].endswith("0097")
    assert (cited["publisher"], cited["publicationYear"]) == ("A university", 2026)
    assert {"tables/model_fits.csv", "tables/recordings.csv"} <= set(files)
    assert any(name.startswith("figures/") for name in files)


@pytest.mark.long
def test_an_eln_has_all_in_one_folder(
    lab: Path, crate: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "films.eln"
    assert main(["export", "--crate", str(target), "--lab", str(lab)]) == 0
    said = capsys.readouterr().out
    assert "asked for by DataCite or RO-Crate: creators, title, publisher" in said
    with zipfile.ZipFile(target) as archive:
        assert {name.split("/")[0] for name in archive.namelist()} == {"films"}
    kept, other = read_crate(crate), read_crate(target)
    differ = {name for name in kept if kept[name] != other[name]}
    assert differ == {"ro-crate-metadata.json", "datacite.json", "manifest-sha256.txt"}  # what --about says
    assert main(["verify", str(target)]) == 0


@pytest.mark.long
def test_every_change_is_said_in_a_line(
    lab: Path, crate: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = unpack(crate, tmp_path / "crate")
    table = folder / "tables" / "model_fits.csv"
    heads, first, *rest = table.read_text().splitlines()
    cells = first.split(",")
    place = heads.split(",").index("k0_n_per_mm")
    cells[place] = repr(1.25 * float(cells[place]))
    table.write_text("\n".join((heads, ",".join(cells), *rest)) + "\n")
    (folder / "datacite.json").unlink()
    (folder / "extra.txt").write_text("?")
    capsys.readouterr()
    assert main(["verify", str(folder), "--lab", str(lab)]) == 1
    said = capsys.readouterr().out.splitlines()
    assert "tables/model_fits.csv: its SHA-256 is not the one in manifest-sha256.txt" in said
    assert "datacite.json: missing" in said
    assert "extra.txt: not listed in manifest-sha256.txt" in said
    assert "tables/model_fits.csv: numbers are apart by up to 0.2 of their size (k0_n_per_mm)" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["export"], "--crate FILE for all of a lab"),
        (["export", "--crate", "a.rar"], "ends in .zip or .eln"),
        (["export", "--crate", "there.zip"], "there already"),
        (["export", "--crate", "a.zip", "--as", "json"], "no place beside --crate"),
        (["export", "--crate", "a.zip", "--about", "bad.toml"], '"tittle" is no key'),
    ],
)
def test_what_cannot_be_exported_is_said(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.zip").write_bytes(b"mine")
    (tmp_path / "bad.toml").write_text('tittle = "Films"')
    assert main([*words, "--lab", str(lab)]) == 2
    assert said in capsys.readouterr().err
    assert (tmp_path / "there.zip").read_bytes() == b"mine"
    assert {p.name for p in tmp_path.iterdir()} == {"there.zip", "bad.toml"}


def test_what_is_no_crate_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.txt").write_text("no crate")
    assert main(["verify", str(tmp_path / "a.txt")]) == 2
    assert "neither a folder nor an archive" in capsys.readouterr().err
    assert main(["verify", str(tmp_path)]) == 2
    assert "no ro-crate-metadata.json" in capsys.readouterr().err
