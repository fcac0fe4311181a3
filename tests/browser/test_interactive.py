"""Pages with a script: tables that filter and sort, a search, values under the pointer, zoom, specimens laid over each other.

The same pages without it, or with scripts switched off, still say everything.
"""

from __future__ import annotations

import base64
import hashlib
import re
from pathlib import Path
from typing import Any

import pytest

from reports import manifest
from reports.build import build_reports
from tests.browser.test_pages import ARTIFACTS, violations
from tests.helpers import chromium, synthetic_lab

SPECIMEN, RECORDING = "specimens/P-07.html", "recordings/P-07_step.html"


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of the lab that `site` is about, with the script."""
    lab = synthetic_lab.whole_story().write(tmp_path_factory.mktemp("asked") / "lab")
    build_reports(lab, interactive=True)
    return lab / "reports"


def mouse(browser: chromium.Chromium, kind: str, x: float, y: float, button: str = "none") -> None:
    held = 1 if button == "left" and kind != "mouseReleased" else 0
    browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=held, clickCount=1)


def write(browser: chromium.Chromium, selector: str, text: str) -> None:
    """Types into a field as a person does: focus, then letters."""
    browser.evaluate(f"document.querySelector({selector!r}).focus(); document.querySelector({selector!r}).select()")
    browser.call("Input.insertText", text=text)


def place_of(browser: chromium.Chromium, expression: str) -> Any:
    return browser.evaluate(
        f"(e => {{ e.scrollIntoView({{block: 'center'}}); const b = e.getBoundingClientRect();"
        f" return [b.x, b.y, b.width, b.height] }})({expression})"
    )


@pytest.mark.long_after(1)
@pytest.mark.parametrize(
    "page", ["index.html", SPECIMEN, RECORDING, "campaigns/film-dynamics.html", "control.html", "recordings.html"]
)
def test_only_our_script_runs_and_nothing_is_asked_for(browser: chromium.Chromium, asked: Path, page: str) -> None:
    heard = browser.open(asked / page)
    outside = [u for u in heard.requests if not u.startswith(("data:", (asked / page).resolve().as_uri()))]
    assert (outside, heard.complaints) == ([], [])
    assert browser.evaluate("document.querySelector('#search') !== null"), "the script ran"
    text = (asked / page).read_text(encoding="utf-8")
    (script,) = re.findall(r"<script>(.*?)</script>", text, flags=re.S)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in text.replace("&#39;", "'")
    assert browser.evaluate("document.documentElement.scrollWidth") <= 1100
    browser.screenshot(ARTIFACTS / f"interactive-{page.replace('/', '-')}.png")
    assert violations(browser) == []
    browser.open(asked / page, width=420)
    assert browser.evaluate("document.documentElement.scrollWidth") <= 420


@pytest.mark.long
def test_another_script_does_not_run(browser: chromium.Chromium, asked: Path) -> None:
    """The policy is held by its hash: one letter more, and the browser refuses."""
    text = (asked / "index.html").read_text(encoding="utf-8")
    changed = asked / "changed.html"
    changed.write_text(text.replace("<script>", "<script>1;"), encoding="utf-8")
    heard = browser.open(changed)
    changed.unlink()
    assert browser.evaluate("document.querySelector('#search')") is None
    assert any("Content Security Policy" in c for c in heard.complaints)


TABLE = "[...document.querySelectorAll('main .scroll table')].find(t => t.tBodies[0].rows.length > 7)"
VISIBLE = f"[...({TABLE}).tBodies[0].rows].filter(r => r.offsetParent !== null).map(r => r.cells[0].textContent.trim())"


@pytest.mark.long
def test_tables_filter(browser: chromium.Chromium, asked: Path) -> None:
    browser.open(asked / "recordings.html")
    before = browser.evaluate(VISIBLE)
    browser.evaluate(f"({TABLE}).closest('.scroll').previousElementSibling.querySelector('input').id = 'here'; 0")
    write(browser, "#here", "P-07 step")
    after = browser.evaluate(VISIBLE)
    assert 0 < len(after) < len(before)
    assert "P-07_step" in after
    said = browser.evaluate("document.querySelector('#here').parentElement.querySelector('output').textContent")
    assert said == f"{len(after)} of {len(before)}"
    write(browser, "#here", "no such thing")
    assert browser.evaluate(VISIBLE) == []
    write(browser, "#here", " ")
    assert browser.evaluate(VISIBLE) == before


@pytest.mark.long
def test_tables_sort_by_number_and_by_name(browser: chromium.Chromium, asked: Path) -> None:
    """Numbers of any form go by size: groups of thousands, powers of ten, true minus, ±, limits; what is absent goes last."""
    browser.open(asked / "specimens.html")
    cells = ["9 ± 2", "−3.5 (−4 to −3)", "–", "12\\u202f000", "1.5 × 10⁻³", "< 10⁻¹⁶", "2 min 05 s", "0.5 %"]
    browser.evaluate(
        f"(() => {{ const t = {TABLE}; const rows = [...t.tBodies[0].rows]; rows.slice({len(cells)}).forEach(r => r.remove());"
        f" {cells!r}.forEach((c, i) => {{ rows[i].cells[2].textContent = c }}) }})()".replace("\\\\u", "\\u")
    )
    column = f"[...({TABLE}).tBodies[0].rows].map(r => r.cells[2].textContent)"
    press = f"({TABLE}).tHead.rows[0].cells[2].querySelector('button').click()"
    browser.evaluate(press)
    rising = ["−3.5 (−4 to −3)", "< 10⁻¹⁶", "1.5 × 10⁻³", "0.5 %", "9 ± 2", "2 min 05 s", "12\u202f000", "–"]
    assert browser.evaluate(column) == rising
    assert browser.evaluate(f"({TABLE}).tHead.rows[0].cells[2].getAttribute('aria-sort')") == "ascending"
    browser.evaluate(press)
    assert browser.evaluate(column) == [*rising[-2::-1], "–"]
    name = f"({TABLE}).tHead.rows[0].cells[0].querySelector('button')"
    browser.evaluate(f"{name}.click()")
    names = browser.evaluate(f"[...({TABLE}).tBodies[0].rows].map(r => r.cells[0].textContent)")
    assert names == sorted(names, key=lambda n: [int(p) if p.isdigit() else p.lower() for p in re.split(r"(\d+)", n)])


@pytest.mark.long
def test_the_search_finds_pages_and_what_stands_on_this_one(browser: chromium.Chromium, asked: Path) -> None:
    browser.open(asked / "index.html")
    write(browser, "#search", "p-07_step")
    assert "P-07_step" in browser.evaluate("[...document.querySelectorAll('.hits li')].map(l => l.textContent)")
    write(browser, "#search", "zzz")
    assert browser.evaluate("document.querySelector('.hits').textContent") == "nothing found"
    write(browser, "#search", "p-07_step")
    browser.evaluate("document.querySelector('.hits button').click()")
    while browser._next().get("method") != "Page.loadEventFired":
        pass
    assert browser.evaluate("location.pathname").endswith(RECORDING)
    write(browser, "#search", "settings")
    browser.evaluate("document.querySelector('.hits button')?.click()")
    assert browser.evaluate("document.querySelectorAll('.hits li').length") > 0


FIGURE = "document.querySelector('figure span.plot')"


def drawn_ticks(browser: chromium.Chromium) -> list[str]:
    found: list[str] = browser.evaluate(
        f"[...({FIGURE}).querySelectorAll('svg.live text.tick[text-anchor=middle]')].map(t => t.textContent)"
    )
    return found


@pytest.mark.long
def test_the_pointer_says_values_and_a_drag_zooms(browser: chromium.Chromium, asked: Path) -> None:
    browser.open(asked / SPECIMEN)
    data = browser.evaluate(f"JSON.parse(({FIGURE}).nextElementSibling.textContent)")
    upper = data[0]
    dots = next(s for s in upper["series"] if s["kind"] == "d")
    i = len(dots["x"]) // 2
    left, top, width, height = upper["box"]
    x0, y0, shown, _ = place_of(browser, FIGURE)
    drawn_width = browser.evaluate(f"Number(({FIGURE}).querySelector('img').getAttribute('width'))")
    scale = shown / drawn_width

    def at(x: float, y: float) -> tuple[float, float]:
        import math

        def share(axis: list[Any], v: float) -> float:
            low, high, log = axis
            return math.log(v / low) / math.log(high / low) if log else (v - low) / (high - low)

        across = left + width * share(upper["x"], x)
        down = top + height * (1 - share(upper["y"], y))
        return x0 + scale * across, y0 + scale * down

    mouse(browser, "mouseMoved", *at(dots["x"][i], dots["y"][i]))
    said = browser.evaluate(f"({FIGURE}).querySelector('.value').textContent").replace("\u00a0", " ")
    found = re.fullmatch(r"(?:.*: )?([\d.]+) N/mm at ([\d.]+) Hz", said)
    assert found, said
    assert float(found[1]) == pytest.approx(dots["y"][i], rel=0.05)
    assert float(found[2]) == pytest.approx(dots["x"][i], rel=0.05)
    guides = browser.evaluate(f"({FIGURE}).querySelectorAll('svg.live .guide').length")
    assert guides == len(data), "the panels of a figure are linked"

    start, end = at(10, dots["y"][i]), at(40, dots["y"][i])
    mouse(browser, "mouseMoved", *start)
    mouse(browser, "mousePressed", *start, "left")
    mouse(browser, "mouseMoved", *end, "left")
    assert browser.evaluate(f"({FIGURE}).querySelectorAll('svg.live .chosen').length") == 1
    mouse(browser, "mouseReleased", *end, "left")
    ticks = [float(t) for t in drawn_ticks(browser)]
    assert ticks
    assert min(ticks) >= 10 * 0.98
    assert max(ticks) <= 40 * 1.02
    browser.screenshot(ARTIFACTS / "interactive-zoomed.png")
    browser.evaluate(f"({FIGURE}).querySelector('button.whole').click()")
    assert drawn_ticks(browser) == []


@pytest.mark.long
def test_a_record_can_be_zoomed_into_beyond_what_is_drawn(browser: chromium.Chromium, asked: Path) -> None:
    browser.open(asked / RECORDING)
    data = browser.evaluate(f"JSON.parse(({FIGURE}).nextElementSibling.textContent)")
    assert len(data) >= 2, "a panel for each channel"
    assert max(len(s["x"]) for p in data for s in p["series"]) > 100
    x, y, wide, high = place_of(browser, FIGURE)
    for kind, across in (("mousePressed", 0.4), ("mouseMoved", 0.5), ("mouseReleased", 0.5)):
        mouse(browser, kind, x + across * wide, y + 0.1 * high, "left")
    first = float(drawn_ticks(browser)[0].replace("\u202f", ""))
    assert first > data[0]["x"][0] + 0.3 * (data[0]["x"][1] - data[0]["x"][0])
    assert len(drawn_ticks(browser)) >= 2 * len(data), "all channels go along"


@pytest.mark.long
def test_specimens_are_laid_over_each_other(browser: chromium.Chromium, asked: Path) -> None:
    browser.open(asked / "index.html")
    boxes = "[...document.querySelectorAll('ul.many input[type=checkbox]')]"
    assert browser.evaluate(f"{boxes}.length") >= 3
    assert not browser.evaluate("document.querySelector('figure.overlay').offsetParent !== null")
    browser.evaluate(f"{boxes}[0].click(); {boxes}[1].click()")
    names = browser.evaluate(
        "[...document.querySelectorAll('ul.many figcaption bdi')].slice(0, 2).map(b => b.textContent)"
    )
    shown = browser.evaluate("[...document.querySelectorAll('figure.overlay text.name')].map(t => t.textContent)")
    assert set(names) <= set(shown)
    colours = browser.evaluate(
        "new Set([...document.querySelectorAll('figure.overlay svg.live path[fill=none][stroke]')].map(p => p.getAttribute('stroke'))).size"
    )
    assert colours == 2
    browser.screenshot(ARTIFACTS / "interactive-overlay.png")
    browser.evaluate(f"{boxes}[0].click(); {boxes}[1].click()")
    assert not browser.evaluate("document.querySelector('figure.overlay').offsetParent !== null")


@pytest.mark.long
@pytest.mark.parametrize("page", ["index.html", SPECIMEN, RECORDING])
def test_with_scripts_off_the_page_says_everything(
    browser: chromium.Chromium, asked: Path, site: Path, page: str
) -> None:
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    texts = []
    try:
        for report in (asked, site):
            browser.open(report / page)
            texts.append((browser.evaluate("document.body.innerText"), browser.evaluate("document.images.length")))
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)
    assert texts[0] == texts[1]
    assert len(texts[0][0]) > 500


@pytest.mark.long
def test_values_are_said_without_a_script(browser: chromium.Chromium, site: Path) -> None:
    """Over each measured point lies a title that the browser shows by itself."""
    browser.open(site / SPECIMEN)
    assert browser.evaluate("document.scripts.length") == 0
    browser.evaluate("document.querySelector('svg.said').scrollIntoView({block: 'center'})")
    hit = browser.evaluate(
        """(() => { const path = document.querySelectorAll('svg.said path')[5]; const b = path.getBoundingClientRect();
        return [document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2).closest('path')?.textContent, path.textContent] })()"""
    )
    assert hit[0], "the point answers to the pointer"
    assert re.fullmatch(r"[\d.]+ Hz: [\d.]+ N/mm", hit[1].replace("\u00a0", " "))


@pytest.mark.long
def test_pages_keep_their_form_until_told_otherwise(tmp_path: Path) -> None:
    lab = synthetic_lab.small_story().write(tmp_path / "lab")
    index = lab / "reports" / "index.html"

    def scripts() -> int:
        return index.read_text(encoding="utf-8").count("<script>")

    build_reports(lab)
    assert scripts() == 0
    assert build_reports(lab, interactive=True).pages_unchanged == 0
    assert scripts() == 1
    assert manifest.interactive(lab / "reports")
    assert build_reports(lab).pages_written == 0, "a night leaves them as they are"
    assert build_reports(lab, interactive=False).pages_unchanged == 0
    assert scripts() == 0
