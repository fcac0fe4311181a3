"""Drawings: scales, ticks, labels, marks, dense data, valid XML."""

from __future__ import annotations

import base64
import inspect
import io
import itertools
import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.lines import Line2D
from matplotlib.text import Text
from PIL import Image

from reports.figures import actuator, comparison, control, diagnosis, film, life_models, recording, steps, survival
from reports.figures.backend import DENSE, write_svg
from reports.figures.drawn import drawn_before
from reports.figures.palette import group, misfit
from reports.figures.panel import Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.responses import Curve, Lines, beyond, find_jump, residual, response
from reports.figures.scale import Scale, apart, linear, logarithmic, nice, tick_text
from reports.pages.campaign.places import tell_thinnest
from reports.pages.specimen import film as response_page

SVG = "{http://www.w3.org/2000/svg}"


def parsed(image: str) -> ElementTree.Element:
    found = re.search(r'base64,([^"]+)"', image)
    assert found
    return ElementTree.fromstring(base64.b64decode(found[1]))


def markup(image: str) -> str:
    """The SVG inside an image."""
    return ElementTree.tostring(parsed(image), encoding="unicode").replace("svg:", "").replace("ns0:", "")


def png(data: bytes) -> tuple[np.ndarray, np.ndarray, set[int]]:
    """Cells, palette and transparent indices of a PNG with a palette."""
    with Image.open(io.BytesIO(data)) as image:
        assert image.mode == "P"
        palette = np.array(image.getpalette(), dtype=np.uint8).reshape(-1, 3)
        clear = image.info.get("transparency")
        return np.asarray(image), palette, set() if clear is None else {clear}


@settings(deadline=None)
@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6), st.booleans())
def test_ticks_lie_inside_and_are_few(low: float, span: float, log: bool) -> None:
    scale = Scale(abs(low) + 1e-6, (abs(low) + 1e-6) * (1 + span), log=True) if log else Scale(low, low + span)
    labelled, minor = scale.ticks(6)
    slack = 1e-6 * max(abs(scale.low), abs(scale.high))
    assert len(labelled) <= 8
    assert all(scale.low - slack <= t <= scale.high + slack for t in [*labelled, *minor])
    assert len({tick_text(t) for t in labelled}) == len(labelled) or span < 1e-5 * max(abs(low), 1)


def test_ticks_of_a_decade_and_of_two() -> None:
    assert Scale(1, 100, log=True).ticks(8)[0] == pytest.approx([1, 2, 5, 10, 20, 50, 100])
    assert [tick_text(t) for t in Scale(0.01, 100, log=True).ticks(5)[0]] == ["0.01", "0.1", "1", "10", "100"]
    assert [tick_text(t) for t in Scale(-0.2, 0.2).ticks(4)[0]] == ["−0.2", "−0.1", "0", "0.1", "0.2"]


@settings(deadline=None)
@given(st.lists(st.floats(0, 300), max_size=12).map(sorted))
def test_names_do_not_touch(wanted: list[float]) -> None:
    placed = apart(wanted, 14, 0, 300)
    assert all(b - a >= 14 - 1e-9 for a, b in itertools.pairwise(placed))
    if placed and 14 * len(placed) < 300:
        assert placed[-1] <= 300 + 1e-9


def test_scales_survive_data_that_have_no_extent() -> None:
    for scale in (
        linear([1.0, 1.0]),
        linear([]),
        linear([np.nan]),
        logarithmic([]),
        logarithmic([-1.0, 0.0]),
        logarithmic([5.0]),
    ):
        assert scale.high > scale.low
        assert np.isfinite(scale.share([scale.low, scale.high])).all()


@settings(deadline=None)
@given(st.floats(1e-3, 1e3), st.floats(1.05, 1e4), st.integers(2, 8), st.booleans())
def test_an_axis_has_two_labels_at_least(low: float, ratio: float, most: int, log: bool) -> None:
    """One label, such as 1 on an axis from 0.9 to 1.1, says nothing about its length."""
    labelled, _ = Scale(low, low * ratio, log).ticks(most)
    assert len(labelled) >= 2


@pytest.mark.parametrize(("value", "expected"), [(3.7, 2), (0.1, 0.1), (0.0499, 0.02), (900, 500)])
def test_nice(value: float, expected: float) -> None:
    assert nice(value) == pytest.approx(expected)


def test_many_marks_become_one_image_of_bounded_size() -> None:
    random = np.random.default_rng(seed=1)
    sizes = []
    for count in (DENSE - 1, 50_000, 400_000):
        drawing = Drawing(480, 300)
        panel = Panel(drawing, 40, 20, 400, 250, Scale(0, 1), Scale(0, 1))
        panel.dots(random.random(count), random.random(count), "#0069a8", 3)
        sizes.append(len(write_svg(drawing)))
    assert sizes[2] < 1.5 * sizes[1] < 200_000


def test_dense_marks_lie_where_they_should() -> None:
    drawing = Drawing(100, 100)
    panel = Panel(drawing, 0, 0, 100, 100, Scale(0, 1), Scale(0, 1))
    panel.dots(np.full(DENSE + 1, 0.25), np.full(DENSE + 1, 0.25), "#b8420a", 6)
    uri = next(e for e in ElementTree.fromstring(write_svg(drawing)) if e.tag == SVG + "image").attrib["href"]
    cells, palette, transparent = png(base64.b64decode(uri.partition(",")[2]))
    assert cells.shape == (200, 200)
    assert palette[cells[150, 50]].tolist() == [0xB8, 0x42, 0x0A]
    assert transparent == {0}
    assert cells[50, 150] == 0
    assert 100 < (cells > 0).sum() < 200


def test_values_beyond_the_scale_are_marked_at_the_edge() -> None:
    drawing = Drawing(100, 100)
    panel = Panel(drawing, 0, 0, 100, 100, Scale(0, 1), Scale(-7, 7))
    panel.held([0.5, 0.5, 0.5], [0.0, 99.0, -99.0], "#0069a8")
    assert len([e for e in ElementTree.fromstring(write_svg(drawing)) if e.tag == SVG + "path"]) == 3


def test_a_gap_interrupts_the_line() -> None:
    drawing = Drawing(100, 100)
    panel = Panel(drawing, 0, 0, 100, 100, Scale(0, 4), Scale(0, 4))
    panel.curve([0, 1, 2, 3, 4], [1, 1, np.nan, 2, 2], "#000000")
    (line,) = [e for e in ElementTree.fromstring(write_svg(drawing)) if e.tag == SVG + "path"]
    assert re.sub(r"[^ML]", "", line.attrib["d"]) == "MLML"


@settings(deadline=None)
@given(st.integers(1, 5000))
def test_merging_an_envelope_keeps_its_extremes(count: int) -> None:
    random = np.random.default_rng(count)
    low = random.normal(size=count)
    thin = recording.Envelope("force", "N", np.arange(count, dtype=float), low, low + 1).merged(440)
    assert thin.time.size <= max(440, 1)
    assert thin.low.min() == low.min()
    assert thin.high.max() == low.max() + 1


def test_a_gap_in_the_samples_stays_one() -> None:
    time = np.concatenate([np.arange(50.0), np.arange(80.0, 130.0)])
    envelope = recording.Envelope("force", "N", time, np.zeros(100), np.ones(100))
    assert np.flatnonzero(envelope.gaps()).tolist() == [49]


def lines(n: int = 30) -> Lines:
    f = np.geomspace(1, 100, n)
    return Lines(f, 1 + 1j * f / 50, np.full(n, 0.02), np.ones(n, dtype=bool), np.where((f > 40) & (f < 60), 9.0, 1.0))


def test_alt_text_and_markup_are_escaped() -> None:
    image = response(lines(), None, [], phase=False, alt='"><script>alert(1)</script>')
    assert "<script" not in image
    assert parsed(image).tag == SVG + "svg"


def test_response_with_all_orders_is_xml_and_names_them() -> None:
    data = lines()
    models = {n: data.value * (1 + 0.02 * (3 - n)) for n in (1, 2, 3)}
    curves = [Curve(n, n == 3, m, data.frequency, data.value, residual(data, m)) for n, m in models.items()]
    for phase in (False, True):
        texts = [
            e.text
            for e in parsed(response(data, data, curves, phase=phase, alt="x", alarm=True))
            if e.tag == SVG + "text"
        ]
        assert {"1st order", "2nd order", "3rd order ✓"} <= set(texts)


def test_a_misfit_is_named_by_the_measure_of_the_headline() -> None:
    """The headline says 4.2 times the noise, √ of reduced χ²; the picture gave its largest point alone: 16 SD."""
    data = lines()
    model = data.value * np.where(data.frequency > 50, 1.2, 1.0)
    curves = [Curve(1, True, model, data.frequency, data.value, residual(data, model), times_noise=4.2)]
    image = parsed(response(data, None, curves, phase=False, alt="x", alarm=True))
    texts = [e.text or "" for e in image if e.tag == SVG + "text"]
    assert "over all data 4.2 times the noise; most at 100 Hz" in " ".join(texts)
    assert not any(" SD at " in text for text in texts)
    # what the response alone leaves is another number: the caption tells both
    fit = {"spread": '{"gain_sd": 0.01, "relative_sd": 0.02}'}
    said = response_page._over_all(fit, curves)
    assert said.endswith("with what recordings differ by counted as noise, the first order leaves 4.2 times the noise.")
    assert "differ" not in response_page._over_all({"spread": None}, curves)
    same = replace(curves[0], times_noise=curves[0].residual.rms)
    assert response_page._over_all(fit, [same]) == ""


def test_names_of_lines_that_lie_on_each_other_stand_apart() -> None:
    """A film that hardly relaxes has the same line at 10 Hz and at the lowest: their names were printed over each other."""
    stroke, force = np.array([0.0, 0.2]), np.array([0.06, 0.0])
    both = [actuator.Line(n, stroke * f, force, force, force) for n, f in (("10 Hz", 1.0), ("0.0347 Hz", 1.001))]
    image = parsed(actuator.force_stroke(both, alt="x"))
    heights = [float(e.get("y") or "nan") for e in image.iter(SVG + "text") if "Hz" in "".join(e.itertext())]
    assert len(heights) == 2
    assert abs(heights[0] - heights[1]) > 12


def test_residual_is_in_sd_of_one_component() -> None:
    data = lines(40)
    random = np.random.default_rng(seed=3)
    n = 4000
    f = np.geomspace(1, 100, n)
    truth = 1 + 1j * f / 50
    noise = 0.02 / np.sqrt(2) * (random.normal(size=n) + 1j * random.normal(size=n))
    measured = Lines(f, truth + noise, np.full(n, 0.02), np.ones(n, dtype=bool), np.ones(n))
    found = residual(measured, truth)
    assert np.std(found.magnitude) == pytest.approx(1, rel=0.05)
    assert np.std(found.phase) == pytest.approx(1, rel=0.05)
    assert found.rms == pytest.approx(1, rel=0.04)
    blind = residual(
        Lines(data.frequency, data.value, np.full(40, np.nan), data.usable, data.amplification), 0.9 * data.value
    )
    assert not blind.in_sd
    assert blind.magnitude == pytest.approx(np.full(40, 10.0))


def test_unusable_stretches_reach_half_way_to_the_neighbours() -> None:
    f = np.array([1.0, 2.0, 4.0, 8.0])
    assert beyond(f, np.array([1.0, 9.0, 9.0, 1.0])) == [(pytest.approx(np.sqrt(2)), pytest.approx(np.sqrt(32)))]
    assert beyond(f, np.full(4, np.nan)) == []


def test_numbers_at_risk() -> None:
    curve = survival.GroupCurve(
        "a", group(0), np.array([5.0, 10.0, 240.0]), np.array([0.9, 0.8, 0.8]), np.full(3, np.nan), np.full(3, np.nan),
        np.array([10, 9, 8]), np.array([0, 0, 8]), np.array([1, 1, 0]),
    )  # fmt: skip
    assert [curve.still_at_risk(t) for t in (0, 5, 6, 10, 240, 241)] == [10, 10, 9, 9, 8, 0]
    assert (curve.total, curve.failed) == (10, 2)


def test_film_is_put_together_from_points_in_any_order() -> None:
    x, y = np.meshgrid([0.0, 1.0, 2.0], [0.0, 1.0])
    order = np.random.default_rng(seed=2).permutation(6)
    found = film.grid(x.ravel()[order], y.ravel()[order], (x + 10 * y).ravel()[order], (x > 0).ravel()[order])
    np.testing.assert_array_equal(found.relative, [[0, 1, 2], [10, 11, 12]])
    image = film.thickness_map(found, (0.7, 1.0), {"left": 1}, "film", alt="x")
    assert parsed(image).find(SVG + "image") is not None


def test_the_thinnest_place_is_under_the_electrode_with_its_mirror_images() -> None:
    x, y = np.meshgrid(np.linspace(-2, 2, 5), np.linspace(-3, 3, 7))
    relative = 1 - 0.1 * (np.abs(x) == 1) * (y == 2) - 0.3 * (np.abs(x) == 2)
    found = film.find_thinnest(film.grid(x.ravel(), y.ravel(), relative.ravel(), (np.abs(x) < 2).ravel()))
    assert found is not None
    assert (abs(found.x), found.y, found.relative) == (1, 2, pytest.approx(0.9)), "beside the electrode it is thinner"
    assert (found.mirrored_x, found.mirrored_y) == (True, False)
    assert found.place == "at x = ±1, y = 2 mm"
    told = tell_thinnest(film.grid(x.ravel(), y.ravel(), relative.ravel(), (np.abs(x) < 2).ravel())).replace(
        "\xa0", " "
    )
    assert told == (
        "Thinnest under the electrode at x = ±1, y = 2 mm: 90 % of the median thickness, so that the field there is 1.11 times"
        " that at the median."
    )
    assert film.find_thinnest(film.grid(x.ravel(), y.ravel(), relative.ravel(), np.zeros(x.size, dtype=bool))) is None


def test_misfit_colours_darken() -> None:
    assert misfit(1.0) == "#ffffff"
    assert misfit(50.0) == "#571b00"
    brightness = [sum(int(misfit(v)[i : i + 2], 16) for i in (1, 3, 5)) for v in np.linspace(1.3, 6.8, 12)]
    assert brightness == sorted(brightness, reverse=True)


def test_names_at_risk_are_whole() -> None:
    names = ("case 2: divided electrode", "case 3: divided electrode, contact outside")
    groups = [
        survival.GroupCurve(
            n, group(i), np.array([10.0, 20.0]), np.array([1 - i / 2, 1 - i / 2]), np.ones(2), np.ones(2), np.array([4, 3]),
            np.array([0, 3]), np.array([i, 0]),
        )
        for i, n in enumerate(names)
    ]  # fmt: skip
    texts = re.findall(r"<text[^>]*>([^<]*)</text>", markup(survival.kaplan_meier(groups, "Time, s", alt="a")))
    assert "…" not in " ".join(texts)
    for name in names:
        assert " ".join(texts).count(name.split()[-1]) >= 2, "beside the curve and beside its numbers"


def curves_of_lives(scales: tuple[float, ...]) -> list[survival.GroupCurve]:
    """Groups of 24 lives each, of one law but for its scale, all failed: step curves that lie close to each other."""
    left, ones = np.arange(24, 0, -1), np.ones(24, dtype=int)
    groups = []
    for i, scale in enumerate(scales):
        time = scale * (-np.log((left - 0.5) / 24)) ** (1 / 1.4)
        alive = (left - 1) / 24
        band = np.clip(alive - 0.1, 0, 1), np.clip(alive + 0.1, 0, 1)
        groups.append(survival.GroupCurve(f"{i + 4} kV", group(i), time, alive, *band, left, 0 * ones, ones))
    return groups


@pytest.mark.parametrize("scales", [(1300.0, 600.0, 250.0), (600.0, 500.0, 450.0), (3000.0, 100.0, 90.0)])
def test_the_name_of_a_curve_is_nearer_to_it_than_to_others_or_a_line_leads_there(scales: tuple[float, ...]) -> None:
    groups = curves_of_lives(scales)
    drawing = inspect.unwrap(survival.kaplan_meier)(groups, "Time, s", alt="a")
    (plot,) = drawing.plots
    left, top, width, height = plot.box
    steps = [s for s in plot.series if s.kind == "t"]
    paths = []
    for s in steps:
        x, y = np.repeat(s.x, 2)[1:], np.repeat(s.y, 2)[:-1]
        fine = np.linspace(0, 1, 200)[:, None]
        h, v = left + width * Scale(*plot.x).share(np.maximum(x, plot.x[0])), top + height * (1 - y / plot.y[1])
        at = np.column_stack([h, v])
        paths.append(np.vstack([a + fine * (b - a) for a, b in itertools.pairwise(at)]))
    leading = [
        np.column_stack(line.get_data()) for line in drawing.figure.findobj(Line2D) if len(line.get_xdata()) == 2
    ]
    for i, g in enumerate(groups):
        (words,) = (t for t in drawing.figure.findobj(Text) if t.get_text() == g.name and t.get_position()[0] > left)
        x, y = words.get_position()
        box = (x, x + 6.6 * len("24 of 24 failed"), y - 11, y + 17)
        away = [float(survival._distances(box, path).min()) for path in paths]
        led = any(
            survival._distances(box, one).min() < 1 and np.hypot(*(paths[i] - one[1]).T).min() < 2 for one in leading
        )
        assert int(np.argmin(away)) == i or led, (g.name, away)
        assert away[i] <= 16 or led, (g.name, away)


def test_what_is_left_of_a_line_has_its_unit_and_held_out_errors_few_digits() -> None:
    volts = np.array([3.0, 4.0, 5.0])
    shown = markup(steps.against_square(volts, volts**2, np.zeros(3, dtype=bool), 1.1, "Drop of tension, mN", alt="a"))
    assert "Off the line, mN" in shown
    assert "980 → 3.2" in markup(diagnosis.held_out(["all together"], [979.63], [3.2], alt="a"))


def test_limits_hide_no_axis() -> None:
    """A band that reaches the edge is drawn before the axis line, not over it."""
    flat = np.full(3, 20.0)
    item = control.Chart(["a", "b", "c"], flat, np.ones(3), flat, flat - 90, flat + 90, np.array([False, True, False]))
    drawing = inspect.unwrap(control.chart)(item, "Stiffness, N/mm", "Specimen", alt="a")
    (axes,) = drawing.figure.axes
    (band,) = axes.collections[:1]
    assert band.get_zorder() < axes.spines["bottom"].get_zorder()


def test_places_in_an_order_have_no_fractions() -> None:
    four = np.arange(4.0)
    data = comparison.Compared(four, four + 1, four, None, np.ones(4), "Response, N", "Values in order", False, False)
    texts = re.findall(r"<text[^>]*>([^<]*)</text>", markup(comparison.comparison(data, alt="a")))
    assert {"0", "1", "2", "3"} <= set(texts)
    assert not {"0.5", "1.5"} & set(texts)


def test_effects_say_their_limits() -> None:
    effects = [life_models.Effect("voltage", "6 kV over 4 kV", 0.163, 0.118, 0.225, None)]
    texts = re.findall(r"<text[^>]*>([^<]*)</text>", markup(life_models.forest(effects, alt="a")))
    assert "× 0.163\u00a0(0.118–0.225)" in texts


def test_a_jump_of_the_points_is_found_where_it_is() -> None:
    f = np.geomspace(1, 100, 80)
    model = (1 + f / 10).astype(complex)
    value = np.where(f > 50, 1.9, 1.0) * model
    lines = Lines(f, value, np.full(80, 0.01), np.ones(80, dtype=bool), np.ones(80))
    found = find_jump(lines, model)
    assert found is not None
    assert found == pytest.approx((50, 1.9), rel=0.05)
    assert find_jump(Lines(f, model, lines.error, lines.usable, lines.amplification), model) is None


def test_a_record_is_kept_denser_than_it_is_drawn() -> None:
    time = np.arange(3000.0)
    time[1500:] += 500.0
    low = np.sin(time / 40)
    one = recording.Envelope("force", "N", time, low, low + 0.1)
    image = recording.channels([one], [], alt="a")
    (plot,) = image.draw().plots
    (series,) = plot.series
    assert series.x.size > 4 * recording.COLUMNS
    assert np.nanmin(series.y) == low.min()
    assert np.nanmax(series.y) == low.max() + 0.1
    assert np.isnan(series.y).any(), "no line across the gap"


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(1, 99), st.floats(-1, 1)), min_size=1, max_size=200))
def test_values_are_said_where_they_are(points: list[tuple[float, float]]) -> None:
    """At most 40 titles a panel, each over its point, in the unit of the axis; and the JSON of the same values is safe in HTML."""
    x, y = (np.array(v) for v in zip(*points, strict=True))
    panels = []

    @pictured("points")
    def draw_points(*, alt: str) -> Drawing:
        drawing = Drawing(400, 300)
        panel = Panel(drawing, 40, 20, 300, 200, Scale(1, 100, log=True), Scale(-1, 1))
        panel.axes("Drop </script> & more, mN", "Frequency, Hz")
        panel.dots(x, y, "#000000")
        panels.append(panel)
        return drawing.told(alt)

    image = draw_points(alt="a")
    (panel,) = panels
    marks = re.findall(r'<path d="M(-?\d+) (-?\d+)h0"><title>([^<]*)</title>', image)
    assert 1 <= len(marks) <= 40
    for across, down, words in marks:
        at_x, at_y = words.replace("\u00a0", " ").replace("−", "-").split(": ")
        assert at_x.endswith(" Hz")
        assert at_y.endswith(" mN")
        f, value = float(at_x.split()[0]), float(at_y.split(" ×")[0].split()[0]) if "×" not in at_y else 0.0
        assert float(panel.px(f)) == pytest.approx(float(across), abs=1.5)
        assert float(panel.py(value)) == pytest.approx(float(down), abs=1.5)
    assert "<" not in image.plot
    kept = json.loads(image.plot)[0]["series"][0]
    assert kept["x"] == pytest.approx(x.tolist(), rel=1e-4)
    assert kept["y"] == pytest.approx(y.tolist(), rel=1e-4, abs=1e-12)


def test_a_page_has_the_same_bytes_twice_and_text_as_text() -> None:
    """No date, no random name, no glyph as a path; a name with dollar signs is a name, not a formula."""
    data = lines()

    def draw() -> str:
        drawing = Drawing(480, 300)
        panel = Panel(drawing, 40, 20, 300, 200, Scale(1, 100, log=True), Scale(0, 3))
        panel.axes("Force of $a$ < b, mN", "Frequency, Hz")
        panel.curve(data.frequency, np.abs(data.value), "#0069a8")
        panel.names([(1.0, "$PA-3$ & co", "#0069a8", True)])
        return write_svg(drawing)

    first = draw()
    assert first == draw()
    texts = [e.text for e in ElementTree.fromstring(first) if e.tag == SVG + "text"]
    assert {"Force of $a$ < b, mN", "Frequency, Hz", "$PA-3$ & co", "100"} <= set(texts)
    assert len(first) < 6000, "a curve with its axes weighs what a page can bear"


def test_what_lies_outside_the_axes_is_cut_without_a_clipping_path() -> None:
    drawing = Drawing(100, 100)
    panel = Panel(drawing, 20, 20, 60, 60, Scale(0, 1), Scale(0, 1))
    panel.curve([-1, 0.5, 2], [-5, 0.5, 6], "#0069a8")
    panel.band([0, 1], [-9, -9], [9, 9], "#0069a8")
    text = write_svg(drawing)
    assert "clip" not in text
    places = np.array([[float(v) for v in p] for p in re.findall(r"[ML]([-\d.]+),([-\d.]+)", text)])
    assert len(places) > 5
    assert places.min() >= 20 - 3.1
    assert places.max() <= 80 + 3.1


@pytest.mark.parametrize("steps", [True, False])
def test_a_band_smaller_than_the_figure_is_drawn(steps: bool) -> None:
    """matplotlib draws it as if it were a mark at the figure's corner, which lies outside the axes."""
    drawing = Drawing(480, 300)
    panel = Panel(drawing, 40, 20, 300, 200, Scale(0, 10), Scale(0, 100))
    panel.band([0, 2, 5], [80, 50, np.nan], [90, 70, np.nan], "#0069a8", ".14", steps=steps)
    (band,) = [e for e in ElementTree.fromstring(write_svg(drawing)) if e.tag == SVG + "path"]
    assert (band.attrib["fill"], band.attrib["fill-opacity"]) == ("#0069a8", "0.14")
    x, y = np.array([[float(v) for v in p] for p in re.findall(r"[ML]([\d.]+),([\d.]+)", band.attrib["d"])]).T
    assert (x.min(), x.max()) == (40, 190 if steps else 100)
    assert (y.min(), y.max()) == (40, 120)


def test_a_page_takes_over_the_figures_that_it_had_from_the_same_data(tmp_path: Path) -> None:
    """Not drawn again: the same data; drawn again: other data, a figure changed by hand, values that the old page has not."""
    drawn: list[float] = []

    @pictured("points")
    def draw_points(x: float, *, alt: str) -> Drawing:
        drawn.append(x)
        drawing = Drawing(100, 100)
        panel = Panel(drawing, 20, 20, 60, 60, Scale(0, 10), Scale(0, 10))
        panel.axes("Force, mN")
        panel.dots([x], [1.0], "#000000")
        return drawing.told(alt)

    page = tmp_path / "page.html"
    first, second = draw_points(1.0, alt="a < b"), draw_points(2.0, alt="a")
    page.write_text(f"<p>{first}</p>{second}".replace(" mN", "\u00a0mN"), encoding="utf-8")
    drawn.clear()
    with drawn_before(page, with_values=False):
        again = draw_points(1.0, alt="a < b")
        assert (str(again).replace("\u00a0", " "), again.finding) == (str(first).replace("\u00a0", " "), "a < b")
        assert drawn == []
        draw_points(1.5, alt="a < b")
        draw_points(1.0, alt="other words")
        assert drawn == [1.5, 1.0]
    drawn.clear()
    with drawn_before(page, with_values=True):
        assert draw_points(1.0, alt="a < b").plot
    page.write_text(page.read_text(encoding="utf-8").replace("M", "m", 1), encoding="utf-8")
    with drawn_before(page, with_values=False):
        assert str(draw_points(1.0, alt="a < b")) == str(first)
        draw_points(2.0, alt="a")
    assert drawn == [1.0, 1.0]
    with drawn_before(tmp_path / "no page.html", with_values=False):
        draw_points(2.0, alt="a")
    assert drawn == [1.0, 1.0, 2.0]


@pytest.mark.parametrize("fall", [60.0, 100.0, 170.0])
def test_the_name_of_what_was_recorded_stands_at_one_of_its_points(fall: float) -> None:
    """Where the phase leaves the panel far below, its name stood beside the curve's steep part, on its points."""
    data = lines(40)
    falls = fall * np.clip((data.frequency - 20) / 60, 0, 1)
    recorded = Lines(
        data.frequency, data.value * np.exp(-1j * np.radians(falls)), data.error, data.usable, data.amplification
    )
    drawing = inspect.unwrap(response)(data, recorded, [], phase=True, alt="x")
    plot = drawing.plots[0]
    (name,) = (t for t in drawing.figure.findobj(Text) if t.get_text() == "as recorded")
    points = np.column_stack([plot.box[0] + plot.box[2] * Scale(*plot.x).share(data.frequency),
                              plot.box[1] + plot.box[3] * (1 - Scale(*plot.y).share(np.degrees(np.angle(recorded.value))))])  # fmt: skip
    x, y = name.get_position()
    assert np.hypot(*(points - [x, y - 4]).T).min() < 12
    inside = (points[:, 0] > x - 66) & (points[:, 0] < x) & (np.abs(points[:, 1] - y + 4) < 5)
    assert not inside.any()


def test_points_far_to_the_right_have_their_name() -> None:
    """A film whose first usable lines lie beyond the words that name them: there was no page."""
    data = lines(40)
    late = Lines(data.frequency, data.value, data.error, data.frequency > 60, data.amplification)
    texts = [e.text for e in parsed(response(late, data, [], phase=False, alt="x")) if e.tag == SVG + "text"]
    assert "corrected for clamp" in texts


def test_a_stripe_hides_no_line() -> None:
    """The instant that a migration begins is drawn over the stripe of its uncertainty, which is narrower than the line."""
    drawing = Drawing(480, 300)
    panel = Panel(drawing, 40, 20, 300, 200, Scale(0, 10), Scale(0, 100))
    panel.column(4.9, 5.1, "#eef0f2")
    panel.across(-2, 2, "#eef0f2")
    drawing.line([(190, 20), (190, 220)], "#b8420a", 1.2)
    panel.curve([0, 10], [0, 100], "#0069a8")
    looks = [e.attrib.get("stroke") or e.attrib["fill"] for e in ElementTree.fromstring(write_svg(drawing))]
    assert looks == ["#eef0f2", "#eef0f2", "#b8420a", "#0069a8"]


@pytest.mark.parametrize(("end", "shown"), [(1e6 / 3600, "277"), (48.3, "48.3"), (1.0 / 3, "0.333"), (5000.0, None)])
def test_the_end_of_a_survival_axis_has_few_digits(end: float, shown: str | None) -> None:
    """A million cycles at 1 Hz are 277.777… hours: all of the digits stood over the tick beside it."""
    none = np.zeros(2, dtype=np.int64)
    one = np.ones(2)
    curve = survival.GroupCurve("a", group(0), np.array([0.4, 1.0]) * end, one, one, one, none, none, none)
    _, ticks = survival.survival_time_scale([curve])
    assert ticks[-1] <= end * (1 + 1e-9)
    if shown is not None and ticks[-1] > 0.9 * end:
        assert tick_text(ticks[-1]) == shown
    assert all(len(tick_text(tick)) <= 6 for tick in ticks)


def test_steps_of_groups_of_the_second_row_are_dashed() -> None:
    for index, expected in ((0, "-"), (6, "--")):
        drawing = Drawing(300, 200)
        panel = Panel(drawing, 40, 20, 200, 120, Scale(0.0, 1.0), Scale(0.0, 1.0))
        panel.steps([0.0, 1.0], [0.0, 1.0], group(index).colour, dash=group(index).dash)
        assert [line.get_linestyle() for line in panel.on.lines] == [expected]
