"""The pages in a browser, from disk: no request, no complaint, readable at every width, by keyboard and on paper."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from reports.build import build_reports
from tests.conftest import ROOT
from tests.helpers import chromium, synthetic_lab

ARTIFACTS = Path(os.environ.get("DEALAB_ARTIFACTS", ROOT / "artifacts")) / "pages"
AXE = Path(__file__).with_name("axe") / "axe.min.js"
KINDS = {
    "index": "index.html",
    "control": "control.html",
    "recordings": "recordings.html",
    "specimens": "specimens.html",
    "refused": "refused.html",
    "specimen": "specimens/P-07.html",
    "specimen-hostile": "specimens/script*.html",
    "specimen-cyclic": "specimens/K-01.html",
    "campaign": "campaigns/film-dynamics.html",
    "campaign-survival": "campaigns/RP-DEA*.html",
    "campaign-voltages": "campaigns/PET*.html",
    "campaign-conditions": "campaigns/Endurance.html",
    "campaign-hostile": "campaigns/style*.html",
    "recording": "recordings/P-05_chirp-2.html",
    "recording-step": "recordings/P-07_step.html",
    "recording-hostile": "recordings/hostile-1.html",
}


def path_of(site: Path, kind: str) -> Path:
    return next(iter(sorted(site.glob(KINDS[kind]))))


@pytest.mark.long_after(1)
@pytest.mark.parametrize("kind", KINDS)
def test_page(browser: chromium.Chromium, site: Path, kind: str) -> None:
    path = path_of(site, kind)
    heard = browser.open(path)
    outside = [u for u in heard.requests if not u.startswith(("data:", path.resolve().as_uri()))]
    assert not outside, f"requests: {outside}"
    assert not heard.complaints, heard.complaints
    images = browser.evaluate(
        "[...document.images].map(i => [i.complete && i.naturalWidth > 0, i.getBoundingClientRect().width, i.alt.length])"
    )
    assert all(loaded and width > 150 and alt > 20 for loaded, width, alt in images), images
    assert browser.evaluate("document.documentElement.scrollWidth") <= 1100
    browser.screenshot(ARTIFACTS / f"{kind}-1100.png")
    browser.open(path, width=420)
    assert browser.evaluate("document.documentElement.scrollWidth") <= 420, (
        "the page scrolls sideways on a narrow screen"
    )
    browser.screenshot(ARTIFACTS / f"{kind}-420.png")


_AXE_RUN = """axe.run(document, {resultTypes: ['violations']}).then(found => found.violations.map(v =>
  ({id: v.id, impact: v.impact, help: v.help, nodes: v.nodes.map(n => n.html.slice(0, 160) + ' ' + n.failureSummary)})))"""


def violations(browser: chromium.Chromium) -> list[dict[str, object]]:
    """What axe-core finds on the open page, by all of its rules."""
    browser.evaluate(AXE.read_text(encoding="utf-8") + "; 0")
    found: list[dict[str, object]] = browser.evaluate(_AXE_RUN)
    return found


@pytest.mark.long_after(1)
@pytest.mark.parametrize("width", [1100, 420])
@pytest.mark.parametrize("kind", KINDS)
def test_axe_finds_nothing(browser: chromium.Chromium, site: Path, kind: str, width: int) -> None:
    browser.open(path_of(site, kind), width=width)
    assert violations(browser) == []


def test_axe_would_find_something(browser: chromium.Chromium, tmp_path: Path) -> None:
    """The check can fail: an image without alternative text, text without contrast."""
    page = tmp_path / "page.html"
    page.write_text("<html><body><img src='data:,'><p style='color:#bbb;background:#fff'>pale</p></body></html>")
    browser.open(page)
    found = {v["id"] for v in violations(browser)}
    assert {"image-alt", "color-contrast", "html-has-lang"} <= found


@pytest.mark.long_after(1)
@pytest.mark.parametrize("story", ["only_refused", "small_story", "Story"])
def test_axe_finds_nothing_on_the_page_of_a_lab_with_little(
    browser: chromium.Chromium, tmp_path: Path, story: str
) -> None:
    browser.open(build_reports(getattr(synthetic_lab, story)().write(tmp_path / "lab")).index)
    assert violations(browser) == []


@pytest.mark.long_after(2)
@pytest.mark.parametrize("kind", ["index", "control", "specimen", "campaign-survival", "recording-hostile"])
def test_printing(browser: chromium.Chromium, site: Path, kind: str) -> None:
    browser.open(path_of(site, kind))
    pdf = browser.pdf()
    ARTIFACTS.mkdir(parents=True, exist_ok=True)
    (ARTIFACTS / f"{kind}.pdf").write_bytes(pdf)
    assert pdf.startswith(b"%PDF")
    sheets = len(re.findall(rb"/Type\s*/Page\b", pdf))
    assert 1 <= sheets <= 14


def test_keyboard(browser: chromium.Chromium, site: Path) -> None:
    browser.open(path_of(site, "index"))
    browser.press("Tab")
    assert browser.evaluate("document.activeElement.textContent") == "Skip to the content"
    assert browser.evaluate("document.activeElement.getBoundingClientRect().left") >= 0
    for _ in range(4):
        browser.press("Tab")
    focused = "getComputedStyle(document.activeElement).outlineWidth"
    assert browser.evaluate("document.activeElement.tagName") == "A"
    assert browser.evaluate(focused) == "3px"
    unreachable = browser.evaluate(
        "[...document.querySelectorAll('.scroll')].filter(e => e.tabIndex !== 0 || !e.getAttribute('aria-label')).length"
    )
    assert unreachable == 0


_CONTRAST = """(() => {
  const channel = v => { v /= 255; return v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4 }
  const light = c => { const [r, g, b] = c.match(/[\\d.]+/g).map(Number); return 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b) }
  const ground = e => { for (; e; e = e.parentElement) { const c = getComputedStyle(e).backgroundColor; if (!/rgba\\(.*, 0\\)/.test(c)) return c } return 'rgb(255,255,255)' }
  const worst = []
  for (const e of document.querySelectorAll('body *')) {
    if (![...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim()) || !e.getClientRects().length) continue
    const a = light(getComputedStyle(e).color), b = light(ground(e))
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05)
    if (ratio < 4.5) worst.push([e.tagName, e.textContent.slice(0, 30), ratio])
  }
  return worst
})()"""


@pytest.mark.parametrize("kind", ["index", "specimen", "campaign-survival"])
def test_text_stands_out_from_its_ground(browser: chromium.Chromium, site: Path, kind: str) -> None:
    browser.open(path_of(site, kind))
    assert browser.evaluate(_CONTRAST) == []


@pytest.mark.parametrize("kind", ["index", "specimen", "campaign-survival", "campaign-voltages", "recording"])
def test_text_in_figures_stays_inside_them(browser: chromium.Chromium, site: Path, kind: str) -> None:
    """Drawn with the reader's own font, no label leaves its figure."""
    browser.open(path_of(site, kind))
    outside = browser.evaluate(
        """[...document.images].flatMap(i => {
          const svg = new DOMParser().parseFromString(new TextDecoder().decode(
            Uint8Array.from(atob(i.src.split(',')[1]), c => c.charCodeAt(0))), 'image/svg+xml').documentElement
          document.body.append(svg)
          const box = svg.getBoundingClientRect()
          const bad = [...svg.querySelectorAll('text')].map(t => [t.textContent, t.getBoundingClientRect()])
            .filter(([, b]) => b.left < box.left - 3 || b.right > box.right + 3 || b.top < box.top - 3 || b.bottom > box.bottom + 3)
            .map(([text, b]) => [text, Math.round(b.left - box.left), Math.round(b.right - box.right)])
          svg.remove()
          return bad
        })"""
    )
    assert outside == []
