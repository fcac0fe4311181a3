"""What `make site` makes of documents and docstrings before Sphinx sees them, and what its look through the pages finds."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.tools.docstrings import as_rst
from tests.tools.site import PACKAGES, Layout, list_documents, list_modules, look_through


@pytest.fixture(scope="module")
def layout(tmp_path_factory: pytest.TempPathFactory) -> Layout:
    made = Layout(ROOT, tmp_path_factory.mktemp("site"), list_documents(ROOT), list_modules(ROOT))
    made.write()
    return made


def test_every_readme_of_ours_has_a_page(layout: Layout) -> None:
    assert {f"{package}/README.md" for package in (*PACKAGES, "tests")} < set(layout.documents)
    assert layout.documents[0] == "README.md"
    assert (layout.folder / "index.md").is_file()
    assert (layout.folder / "CONTRIBUTING.md").is_file()
    assert not list(layout.folder.glob(".*")), "a folder that is hidden is left out by many a server"


def test_links_of_the_documents_lead_to_pages_or_copies(layout: Layout) -> None:
    targets = [
        (path, target)
        for path in layout.folder.rglob("*.md")
        for target in re.findall(r"\]\(<([^>]+)>\)", path.read_text(encoding="utf-8"))
    ]
    assert len(targets) > 60
    for path, target in targets:
        if "://" not in target and not target.startswith("#"):
            assert (path.parent / target.partition("#")[0]).is_file(), (path, target)
    text = (layout.folder / "index.md").read_text(encoding="utf-8")
    assert "](<api/pipeline.nightly.night.rst>)" in text
    assert "](<ingest/README.md>)" in text
    assert "](<reports/pictures/finding.png>)" in text
    assert "](<../index.md#writing-a-recording>)" in (layout.folder / "ingest" / "README.md").read_text(
        encoding="utf-8"
    )


def test_what_stands_between_fences_is_no_link(layout: Layout) -> None:
    text = "[a](pipeline/nightly/night.py)\n```sh\n[a](nowhere)\n```\n"
    assert layout.rewrite("README.md", text) == "[a](<api/pipeline.nightly.night.rst>)\n```sh\n[a](nowhere)\n```\n"
    with pytest.raises(SystemExit, match=r"README\.md: the link nowhere leads nowhere"):
        layout.rewrite("README.md", "[a](nowhere)")


def test_public_modules_have_a_page_and_a_place_in_the_order(layout: Layout) -> None:
    pages = {path.stem for path in (layout.folder / "api").glob("*.rst")}
    assert {
        "dealab",
        "schemas.units",
        "ingest.mcap_writer",
        "pipeline.transform.chirp",
        "pipeline.lab.notebook",
    } < pages
    assert not any("._" in name for name in pages)
    ordered = "".join(path.read_text(encoding="utf-8") for path in (layout.folder / "api").iterdir())
    for name in pages - {"dealab", "schemas", "ingest", "pipeline", "reports"}:
        assert f"   {name.rpartition('.')[2]} <{name}>" in ordered


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("Sizes of `x`s, |k| < 2*3, b_ and b_c.", r"Sizes of ``x``\ s, \|k\| \< 2\*3, b\_ and b_c."),
        ("*Step.* With `a*b`.", "*Step.* With ``a*b``."),
        ("Of:\n- one\n  and more\n- two", "Of:\n\n- one\n  and more\n- two"),
        ("Of:\n\n    a -> b\n\n     c", "Of:\n\n::\n\n        a -> b\n\n         c"),
        ("Of:\n    a = b", "Of:\n\n::\n\n    a = b".replace("    a", "        a")),
        (
            "Parameters\n----------\na, b : (n,) mm\n    and more\nc\n",
            ".. rubric:: Parameters\n\n``a, b``\n    (n,) mm\n    and more\n``c``\n    \\",
        ),
        ("Returns\n-------\nThe stretch, λ*", ".. rubric:: Returns\n\nThe stretch, λ\\*"),
    ],
)
def test_docstrings_mean_on_the_site_what_they_mean_here(written: str, meant: str) -> None:
    assert "\n".join(as_rst(written.splitlines())).strip() == meant


def test_a_look_through_the_pages_finds_what_is_broken_or_remote(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<a href="b.html#there">b</a> <h1 id="top"></h1><a href="#top"></a><link href="#">'
    )
    (tmp_path / "b.html").write_text(
        '<p id="there"></p><a href="https://doi.org/1">read</a><img src="data:image/png,">'
    )
    assert list(look_through(tmp_path)) == []
    (tmp_path / "c.html").write_text(
        '<script src="//cdn.example/x.js"></script><img src="x.png"><a href="gone.html"></a><a href="a.html#gone"></a>'
    )
    (tmp_path / "c.css").write_text("@import url(https://fonts.example/a.css);")
    assert list(look_through(tmp_path)) == [
        "c.html loads //cdn.example/x.js from the network",
        "c.html loads x.png, which is not there",
        "c.html links a.html#gone, where there is no such place",
        "c.html links gone.html, which is not there",
        "c.css loads https://fonts.example/a.css from the network",
    ]
