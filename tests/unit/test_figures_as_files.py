"""Figures that leave the page: the page's own data, by matplotlib, the same bytes twice, readable by eye, ear and press."""

from __future__ import annotations

import csv
import io
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from pipeline import Lab
from pipeline.cli import main
from reports import gallery
from reports.blocks import Page
from reports.figures import cycle, relaxation
from reports.figures.cycle import CycleCurve
from reports.figures.panel import Drawing, Panel
from reports.figures.paper import WIDTHS_MM, write_figure
from reports.figures.scale import Scale
from reports.gallery import PRINTED, Exhibit, find_exhibits
from reports.pages.campaign import page as campaign_page
from reports.pages.specimen import page as specimen_page
from reports.results import Results
from reports.site import Site
from schemas.errors import UsageError
from tests.helpers import synthetic_lab

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic_lab.whole_story().write(tmp_path_factory.mktemp("printed") / "lab")


@pytest.fixture(scope="module")
def exhibits(folder: Path) -> dict[str, Exhibit]:
    """One figure of each kind that the synthetic lab shows, by kind."""
    found: dict[str, Exhibit] = {}
    with Results(folder) as results:
        site = Site(results)
        recording = results.rows("SELECT min(recording_id) AS id FROM previews")[0]["id"]
        for thing in ("P-07", "F-01", "RP-DEA lifetime", recording, "lab"):
            for exhibit in find_exhibits(site, thing):
                found.setdefault(exhibit.picture.kind, exhibit)
    return found


@pytest.fixture
def untouched() -> Iterator[None]:
    before, figures = dict(matplotlib.rcParams), pyplot.get_fignums()
    yield
    assert dict(matplotlib.rcParams) == before
    assert pyplot.get_fignums() == figures


def texts(figure: Figure) -> str:
    return "\n".join(t.get_text() for t in figure.findobj(matplotlib.text.Text))


def test_every_figure_of_a_page_is_listed() -> None:
    """A figure that a page shows can be had as a file: only small multiples, and the overlay with a command of its own, are not."""
    sources = (Path(gallery.__file__).parent / "figures").glob("*.py")
    kinds = re.findall(r'@pictured\(\s*"([^"]+)"', "".join(f.read_text(encoding="utf-8") for f in sources))
    assert len(kinds) == len(set(kinds)) > 50
    assert set(kinds) - {"multiple", "overlay"} == set(PRINTED)


@pytest.mark.long
def test_the_synthetic_lab_shows_many_kinds(exhibits: dict[str, Exhibit]) -> None:
    assert len(exhibits) >= 20
    assert {
        "response",
        "diagnosis",
        "survival",
        "lifetimes",
        "force-map",
        "control",
        "timeline",
        "residual-map",
    } <= set(exhibits)


@pytest.mark.slow
def test_what_bounds_the_use_of_a_specimen_is_on_top_of_its_page(folder: Path) -> None:
    """P-07 has a named cause in its heading, so the voltage from which its film wrinkles is the first sentence below."""
    with Results(folder) as results:
        site = Site(results)
        assert "The film wrinkles from 6.70" in specimen_page.page(site, "P-07").lede


@pytest.mark.long
@pytest.mark.parametrize("campaign", ["Endurance", "film-dynamics"])
def test_a_long_campaign_is_split_and_loses_nothing(
    folder: Path, campaign: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is about single questions moves to pages of its own, each finding a line that leads there; figures are listed from there, too."""

    def sections(page: Page) -> set[str]:
        return {s.id for s in page.sections}

    def listed() -> list[str]:
        return [e.name for e in find_exhibits(site, campaign)]

    with Results(folder) as results:
        site = Site(results)
        monkeypatch.setattr(campaign_page, "_MOST_BLOCKS", 10**6)
        whole, figures = campaign_page.page(site, campaign), listed()
        monkeypatch.setattr(campaign_page, "_MOST_BLOCKS", 0)
        first = campaign_page.page(site, campaign)
        assert listed() == figures
    parts = dict(first.further)
    assert set(parts) <= set(site.parts_of(campaign))
    moved = {f"../{path}#{s}" for path, part in parts.items() for s in sections(part)}
    assert moved
    links = {
        h
        for h in re.findall(r'href="([^"]+)"', str(first.sections))
        if h.startswith(("../failures", "../forces", "../checks"))
    }
    assert links == moved
    everywhere = sections(first).union(*(sections(part) for part in parts.values())) - {"further"}
    assert everywhere == sections(whole).union(*(sections(p) for _, p in whole.further)) - {"further"}
    assert first.files.keys() == whole.files.keys()


@pytest.mark.long
def test_every_kind_is_drawn_in_both_widths(exhibits: dict[str, Exhibit], untouched: None) -> None:
    for place, exhibit in enumerate(exhibits.values()):
        for width, size in list(WIDTHS_MM.items())[place % 2 :]:  # every second one in both
            drawing = exhibit.picture.draw(width)
            figure = drawing.figure
            assert figure.get_figwidth() == pytest.approx(size / 25.4)
            assert figure.get_label() == exhibit.picture.finding
            assert all(ax.lines or ax.collections or ax.patches or ax.texts for ax in figure.axes)
            left, right = drawing.overhang(FigureCanvasAgg(figure).get_renderer())
            assert max(left, right) < 2, f"{exhibit.name}: text is cut at the edge"


def test_kinds_without_a_page_in_the_synthetic_lab_are_drawn(untouched: None) -> None:
    time = np.linspace(0.0, 20.0, 80)
    stretch = 1 + np.where(time < 10, time, 20 - time) / 5
    measured = 50 * (stretch - stretch**-2.0)
    curves = [CycleCurve(n, n == 2, time, stretch, measured, measured + n) for n in (1, 2)]
    loop = cycle.loop(curves, alt="a cycle").draw().figure
    assert "second order ✓" in texts(loop)
    assert np.allclose(loop.axes[1].lines[-1].get_ydata(), -2.0)  # measured less modelled of the chosen order
    rest = cycle.rest(curves, 14.0, alt="what is left").draw().figure
    assert "left out to judge" in texts(rest)
    t = np.geomspace(0.05, 5, 30)
    relaxed = relaxation.relaxation(t, 1.02 * t**-0.1, t**-0.1, alt="relaxation").draw().figure
    assert np.allclose(relaxed.axes[1].lines[-1].get_ydata(), 2.0)  # 2 % above the model everywhere


def test_points_of_the_response_are_those_of_the_database(folder: Path, exhibits: dict[str, Exhibit]) -> None:
    figure = exhibits["response"].picture.draw().figure
    with Results(folder) as results:
        rows = results.rows(
            "SELECT frequency_hz, magnitude, phase_deg FROM frequency_responses WHERE specimen_id = 'P-07' AND usable"
            " AND loading = 'mechanical' AND stage = 'averaged' ORDER BY frequency_hz"
        )
    for axes, column in ((figure.axes[0], "magnitude"), (figure.axes[2], "phase_deg")):
        drawn = [np.asarray(line.get_xydata()) for line in axes.lines if line.get_marker() == "o"]
        wanted = np.array([(r["frequency_hz"], r[column]) for r in rows])
        assert any(d.shape == wanted.shape and np.allclose(d[np.argsort(d[:, 0])], wanted, rtol=1e-6) for d in drawn)


@pytest.mark.long
@pytest.mark.slow
def test_a_pdf_has_its_fonts_in_it_and_no_date(exhibits: dict[str, Exhibit], tmp_path: Path, untouched: None) -> None:
    for kind in ("response", "survival", "force-map"):
        exhibit = exhibits[kind]
        files = [tmp_path / f"{kind}-{i}.pdf" for i in range(2)]
        for file in files:
            write_figure(exhibit.picture.draw(), file, "pdf", title=kind, finding=exhibit.finding)
        first, second = (file.read_bytes() for file in files)
        assert first == second
        assert b"/FontFile2" in first
        assert b"/Type3" not in first
        assert b"Date" not in first


def test_text_of_an_svg_stays_text_and_says_the_finding(exhibits: dict[str, Exhibit]) -> None:
    for exhibit in (exhibits["response"], exhibits["survival"]):
        written = []
        for _ in range(2):
            file = io.BytesIO()
            write_figure(exhibit.picture.draw(), file, "svg", title="P-07: response", finding=exhibit.finding)
            written.append(file.getvalue())
        assert written[0] == written[1]
        tree = ElementTree.fromstring(written[0].decode())
        shown = " ".join("".join(t.itertext()) for t in tree.iter(f"{SVG}text"))
        assert "Surviving, %" in shown or "Dynamic stiffness |k|, N/mm" in shown
        assert exhibit.finding in "".join(tree.itertext())


def test_a_png_says_its_finding(exhibits: dict[str, Exhibit], tmp_path: Path) -> None:
    exhibit = exhibits["force-map"]
    write_figure(exhibit.picture.draw(), tmp_path / "a.png", "png", title="F-01", finding=exhibit.finding)
    with Image.open(tmp_path / "a.png") as image:
        assert image.info["Description"] == exhibit.finding
        assert image.size[0] == pytest.approx(85 / 25.4 * 300, abs=2)


@settings(deadline=None, max_examples=25)
@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=30))
def test_no_point_is_cut_off_in_silence(values: list[float]) -> None:
    drawing = Drawing(480, 200)
    panel = Panel(drawing, 40, 20, 400, 150, Scale(0, 40), Scale(-5.0, 5.0))
    panel.held(np.arange(len(values)), np.array(values), "black")
    assert sum(len(line.get_xdata()) for line in panel.on.lines) == len(values)
    assert drawing.figure.axes[0] is panel.on


@pytest.mark.long
def test_the_command_lists_writes_and_adds_data(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = ["--lab", str(folder)]
    assert main(["figure", "P-07", *lab]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert listed[0].startswith("response ")
    out = tmp_path / "fig.pdf"
    assert main(["figure", "P-07", "sensing", "--out", str(out), "--width", "double", "--data", *lab]) == 0
    assert out.read_bytes().startswith(b"%PDF")
    rows = list(csv.DictReader((tmp_path / "fig.csv").open()))
    assert set(rows[0]) == {"capacitive_strain_percent", "force_step_mn", "used"}
    assert "fig.csv: its data" in capsys.readouterr().out
    assert main(["figure", "RP-DEA lifetime", "all", "--out", str(tmp_path / "all"), *lab]) == 0
    assert {"survival.pdf", "lifetimes.pdf"} <= {p.name for p in (tmp_path / "all").iterdir()}


@pytest.mark.long_after(1)
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nobody", "response", "--out", "a.pdf"], 'nothing is called "nobody"'),
        (["P-07", "histogram", "--out", "a.pdf"], "expected one of response"),
        (["P-07", "response", "--out", "a.docx"], "ends in .pdf, .svg, .png"),
        (["P-07", "response"], "--out is missing"),
        (["P-07", "--out", "a.pdf"], "no figure is named"),
        (["P-07", "all", "--out", "a.pdf"], "expected a folder"),
    ],
)
def test_what_cannot_be_drawn_is_said(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["figure", *words, "--lab", str(folder)]) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_notebook_gets_a_figure(folder: Path, untouched: None) -> None:
    lab = Lab(folder)
    figure = lab.figure("P-07", "response", width="single")
    assert isinstance(figure, Figure)
    assert "3rd order ✓" in texts(figure)
    assert "response" in set(lab.figures("P-07")["name"])
    with pytest.raises(UsageError, match="no width"):
        lab.figure("P-07", "response", width="huge")
