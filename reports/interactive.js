// Pages that may be asked: tables that sort and filter, a search, values under the pointer, figures to zoom into and to lay
// over each other. One file, no library, no request: it reads what stands in the page and in the data beside each figure.
(() => {
"use strict";
const NS = "http://www.w3.org/2000/svg";
const SUPERSCRIPT = "⁰¹²³⁴⁵⁶⁷⁸⁹";
const COLOURS = ["#0069a8", "#b8420a", "#00735a", "#94386d", "#8a6400", "#5b3f9e", "#3f6212", "#525a63"];
const REACH = 28;

const element = (tag, attributes = {}, ...children) => {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
};
const drawn = (tag, attributes = {}, text = "") => {
  const made = document.createElementNS(NS, tag);
  for (const [name, value] of Object.entries(attributes)) if (value !== null) made.setAttribute(name, value);
  made.textContent = text;
  return made;
};

// ---- numbers -----------------------------------------------------------------------------------------------------

const power = (text) => Number([...text].map((c) => (c === "⁻" ? "-" : SUPERSCRIPT.indexOf(c))).join(""));

// The number that a cell begins with, in seconds where it is a duration; NaN where there is none.
const numberOf = (text) => {
  const plain = text.replace(/\u202f/g, "").replace(/\u00a0/g, " ").replace(/−/g, "-").trim();
  const minutes = plain.match(/^(\d+) min(?: (\d+) s)?$/);
  if (minutes) return 60 * Number(minutes[1]) + Number(minutes[2] || 0);
  const alone = plain.match(/^[<>≤≥]? ?10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)$/);
  if (alone) return 10 ** power(alone[1]);
  const found = plain.match(/^[^\w\d+-]*([+-]?\d+(?:\.\d+)?)([^×]*)(?:× 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?/);
  if (!found) return NaN;
  const value = Number(found[1]) * (found[3] ? 10 ** power(found[3]) : 1);
  return /^ h$/.test(found[2]) ? 3600 * value : value;
};

const shown = (value) => {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.floor(Math.log10(Math.abs(value)));
  if (size < -4 || size > 6) {
    const digits = [...String(size)].map((c) => (c === "-" ? "⁻" : SUPERSCRIPT[c])).join("");
    return `${(value / 10 ** size).toFixed(2)} × 10${digits}`.replace("-", "−");
  }
  return String(Number(value.toPrecision(4))).replace("-", "−");
};
const split = (title) => {
  const at = title.lastIndexOf(", ");
  return at < 0 ? [title, ""] : [title.slice(0, at), title.slice(at + 2)];
};
const quantity = (value, title) => {
  const unit = split(title)[1];
  return shown(value) + (unit ? `\u00a0${unit.split(";")[0]}` : "");
};

// ---- tables ------------------------------------------------------------------------------------------------------

const sortBy = (table, column, head) => {
  const body = table.tBodies[0];
  const rising = head.getAttribute("aria-sort") !== "ascending";
  for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", rising ? "ascending" : "descending");
  const rows = [...body.rows].map((row, place) => ({ row, place, text: row.cells[column].textContent.trim() }));
  for (const one of rows) {
    one.date = /^\d{1,2} [A-Z][a-z]+ \d{4}/.test(one.text) ? Date.parse(one.text) : NaN;
    one.number = Number.isNaN(one.date) ? numberOf(one.text) : one.date;
  }
  const filled = rows.filter((one) => one.text && one.text !== "–");
  const numeric = filled.length && filled.filter((one) => !Number.isNaN(one.number)).length > 0.6 * filled.length;
  const empty = (one) => (numeric ? Number.isNaN(one.number) : !one.text || one.text === "–");
  rows.sort((a, b) => {
    if (empty(a) !== empty(b)) return empty(a) - empty(b);
    const order = numeric ? a.number - b.number : a.text.localeCompare(b.text, "en", { numeric: true });
    return (rising ? order : -order) || a.place - b.place;
  });
  body.append(...rows.map((one) => one.row));
};

const openTable = (region, place) => {
  const table = region.querySelector("table");
  if (!table || !table.tHead || table.tBodies[0].rows.length < 2) return;
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const button = element("button", { type: "button", class: "sort" });
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => sortBy(table, column, head));
  });
  const rows = [...table.tBodies[0].rows];
  if (rows.length < 6) return;
  const input = element("input", { type: "search", id: `filter-${place}` });
  const count = element("output", { for: `filter-${place}` });
  region.before(element("div", { class: "tool filter" }, element("label", { for: `filter-${place}` }, "Filter rows"), input, count));
  input.addEventListener("input", () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    let kept = 0;
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
      kept += row.hidden ? 0 : 1;
    }
    count.textContent = words.length ? `${kept} of ${rows.length}` : "";
  });
};

// ---- search ------------------------------------------------------------------------------------------------------

const openSearch = () => {
  const bar = document.querySelector("nav.bar .in");
  if (!bar) return;
  const input = element("input", { type: "search", id: "search", autocomplete: "off" });
  const hits = element("ul", { class: "hits", "aria-label": "Found" });
  hits.hidden = true;
  const form = element("form", { class: "tool search", role: "search" }, element("label", { for: "search" }, "Search"), input);
  bar.append(form);
  bar.parentElement.append(hits);
  const site = document.getElementById("site");
  const entries = site ? JSON.parse(site.textContent).map(([text, href]) => ({ text, href })) : [];
  document.querySelectorAll("main h2, main h3, main figcaption, main tbody tr").forEach((where) => {
    entries.push({ text: where.textContent.replace(/\s+/g, " ").trim(), where });
  });
  const go = (entry) => {
    if (entry.href) {
      location.href = entry.href;
      return;
    }
    const fold = entry.where.closest("details");
    if (fold) fold.open = true;
    entry.where.scrollIntoView({ block: "center" });
    entry.where.classList.add("hit");
    setTimeout(() => entry.where.classList.remove("hit"), 2500);
  };
  let found = [];
  input.addEventListener("input", () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    found = words.length ? entries.filter((e) => words.every((w) => e.text.toLowerCase().includes(w))).slice(0, 12) : [];
    hits.hidden = !words.length;
    hits.replaceChildren(...found.map((entry) => {
      const words_ = entry.text.length > 90 ? `${entry.text.slice(0, 89)}…` : entry.text;
      const button = element("button", { type: "button" }, words_);
      button.addEventListener("click", () => go(entry));
      return element("li", {}, button);
    }));
    if (words.length && !found.length) hits.append(element("li", {}, "nothing found"));
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (found.length) go(found[0]);
  });
};

// ---- figures -----------------------------------------------------------------------------------------------------

const share = ([low, high, log], value) =>
  log ? (value > 0 ? Math.log(value / low) / Math.log(high / low) : NaN) : (value - low) / (high - low);
const valueAt = ([low, high, log], part) => (log ? low * (high / low) ** part : low + part * (high - low));

const ticks = ([low, high, log], most) => {
  if (log && high / low > 3) {
    const all = [];
    for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); e += 1)
      for (const m of [1, 2, 5]) all.push(m * 10 ** e);
    let inside = all.filter((v) => v >= low * (1 - 1e-9) && v <= high * (1 + 1e-9));
    if (inside.length > most) inside = inside.filter((v) => /^1(?:0*|e.*)$|^0\.0*1$/.test(String(Number(v.toPrecision(6)))));
    while (inside.length > most) inside = inside.filter((_, i) => i % 2 === 0);
    return inside;
  }
  const raw = (high - low) / most;
  const decade = 10 ** Math.floor(Math.log10(raw));
  const step = decade * ([1, 2, 5, 10].find((s) => s * decade >= raw * (1 - 1e-9)) || 10);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i += 1) found.push(i * step);
  return found;
};

const around = (panel, values) => {
  const known = values.filter((v) => Number.isFinite(v) && (!panel.y[2] || v > 0));
  if (!known.length) return panel.y;
  const low = Math.min(...known), high = Math.max(...known);
  if (panel.y[2]) {
    const factor = Math.max((high / low) ** 0.06, 1.02);
    return [low / factor, high * factor, true];
  }
  const pad = high > low ? 0.06 * (high - low) : 0.1 * Math.abs(high) || 1;
  return [low - pad, high + pad, false];
};

// A figure over its picture: what is under the pointer, and the panels drawn anew where somebody zooms.
class Chart {
  constructor(span, panels) {
    this.span = span;
    this.panels = panels.map((panel) => ({ ...panel, now: { x: panel.x, y: panel.y } }));
    const image = span.querySelector("img");
    const [width, height] = image ? [image.width, image.height].map((_, i) => Number(image.getAttribute(i ? "height" : "width"))) : span.size;
    this.svg = drawn("svg", { viewBox: `0 0 ${width} ${height}`, class: "live", "aria-hidden": "true" });
    this.drawing = drawn("g");
    this.pointer = drawn("g");
    this.svg.append(this.drawing, this.pointer);
    span.append(this.svg);
    this.words = element("span", { class: "value", role: "status" });
    this.reset = element("button", { type: "button", class: "tool whole" }, "Whole range");
    this.reset.hidden = true;
    span.append(this.words, this.reset);
    this.reset.addEventListener("click", () => this.zoom(null));
    this.svg.addEventListener("pointermove", (event) => this.move(event));
    this.svg.addEventListener("pointerleave", () => this.leave());
    this.svg.addEventListener("pointerdown", (event) => this.grab(event));
    this.svg.addEventListener("pointerup", (event) => this.drop(event));
    this.svg.addEventListener("dblclick", () => this.zoom(null));
  }

  at(event) {
    const box = this.svg.getBoundingClientRect();
    const view = this.svg.viewBox.baseVal;
    return [((event.clientX - box.left) * view.width) / box.width, ((event.clientY - box.top) * view.height) / box.height];
  }

  panelAt(x, y) {
    return this.panels.find((p) => x >= p.box[0] - 6 && x <= p.box[0] + p.box[2] + 6 && y >= p.box[1] - 6 && y <= p.box[1] + p.box[3] + 6);
  }

  place(panel, x, y) {
    const [left, top, width, height] = panel.box;
    if (x === null || y === null) return [NaN, NaN];
    return [left + width * share(panel.now.x, x), top + height * (1 - share(panel.now.y, y))];
  }

  nearest(panel, x, y) {
    let best = null;
    let least = REACH ** 2;
    for (const series of panel.series) {
      for (let i = 0; i < series.x.length; i += 1) {
        const [a, b] = this.place(panel, series.x[i], series.y[i]);
        const apart = (a - x) ** 2 + (b - y) ** 2 + (series.kind === "d" ? 0 : 16);
        if (apart < least) {
          least = apart;
          best = { series, i, a, b };
        }
      }
    }
    return best;
  }

  move(event) {
    const [x, y] = this.at(event);
    const panel = this.panelAt(x, y);
    this.pointer.replaceChildren();
    if (this.start && panel) this.mark(panel, this.start.x, x);
    const best = panel && this.nearest(panel, x, y);
    if (!best) {
      this.words.textContent = "";
      return;
    }
    const value = best.series.x[best.i];
    for (const other of this.panels.filter((p) => p.xt === panel.xt || p === panel)) {
      const [a] = this.place(other, value, other.y[0]);
      this.pointer.append(drawn("line", { x1: a, x2: a, y1: other.box[1], y2: other.box[1] + other.box[3], class: "guide" }));
    }
    this.pointer.append(drawn("circle", { cx: best.a, cy: best.b, r: 6, class: "ring", stroke: best.series.colour }));
    const name = best.series.name ? `${best.series.name}: ` : "";
    this.words.textContent = `${name}${quantity(best.series.y[best.i], panel.yt)} at ${quantity(value, panel.xt)}`;
    const box = this.svg.viewBox.baseVal;
    this.words.style.left = `${Math.min(78, (100 * best.a) / box.width)}%`;
    this.words.style.top = `${(100 * (best.b + 10)) / box.height}%`;
  }

  leave() {
    this.start = null;
    this.pointer.replaceChildren();
    this.words.textContent = "";
  }

  mark(panel, from, to) {
    const [left, top, width, height] = panel.box;
    const [a, b] = [from, to].map((v) => Math.min(Math.max(v, left), left + width)).sort((p, q) => p - q);
    this.pointer.append(drawn("rect", { x: a, y: top, width: b - a, height, class: "chosen" }));
  }

  grab(event) {
    const [x, y] = this.at(event);
    const panel = this.panelAt(x, y);
    this.start = panel ? { x, panel } : null;
    event.preventDefault();
  }

  drop(event) {
    if (!this.start) return;
    const { x: from, panel } = this.start;
    const [to] = this.at(event);
    this.start = null;
    if (Math.abs(to - from) < 8) return;
    const [left, , width] = panel.box;
    const ends = [from, to].map((v) => Math.min(1, Math.max(0, (v - left) / width))).sort((p, q) => p - q);
    this.zoom([valueAt(panel.now.x, ends[0]), valueAt(panel.now.x, ends[1])], panel);
  }

  // All panels with the same axis go along; null shows the whole range again.
  zoom(range, source = null) {
    const linked = source ? this.panels.filter((p) => p === source || (p.xt === source.xt && p.x[2] === source.x[2])) : this.panels;
    for (const panel of linked) {
      if (!range) {
        panel.now = { x: panel.x, y: panel.y };
        continue;
      }
      panel.now.x = [range[0], range[1], panel.x[2]];
      const inside = [];
      for (const series of panel.series)
        series.x.forEach((x, i) => {
          if (x >= range[0] && x <= range[1] && series.y[i] !== null) inside.push(series.y[i]);
        });
      panel.now.y = around(panel, inside);
    }
    this.reset.hidden = !range;
    this.pointer.replaceChildren();
    this.draw(range ? linked : []);
    this.span.dispatchEvent(new CustomEvent("zoomed", { detail: range }));
  }

  draw(panels) {
    this.drawing.replaceChildren();
    for (const panel of panels) this.drawPanel(panel);
  }

  drawPanel(panel) {
    const [left, top, width, height] = panel.box;
    const view = this.svg.viewBox.baseVal;
    // Panels that lie close under each other share the numbers under the last.
    const labelled = !this.panels.some((p) => p.xt === panel.xt && p.box[0] === left && p.box[1] > top && p.box[1] - top - height < 34);
    const foot = labelled ? 21 : 8;
    this.drawing.append(drawn("rect", { x: 0, y: top - 3, width: view.width, height: height + foot, fill: "#fff" }));
    const id = `zoom-${(Chart.count += 1)}`;
    const clip = drawn("clipPath", { id });
    clip.append(drawn("rect", { x: left - 3, y: top - 3, width: width + 6, height: height + 6 }));
    this.drawing.append(clip);
    const inside = drawn("g", { "clip-path": `url(#${id})` });
    for (const series of panel.series) this.drawSeries(panel, series, inside);
    this.drawing.append(inside, drawn("path", { d: `M${left} ${top}V${top + height}H${left + width}`, class: "axis" }));
    for (const value of ticks(panel.now.x, 8)) {
      const [x] = this.place(panel, value, panel.now.y[0]);
      this.drawing.append(drawn("path", { d: `M${x} ${top + height}v4.5`, class: "axis" }));
      if (labelled) this.drawing.append(drawn("text", { x, y: top + height + 17, "text-anchor": "middle", class: "tick" }, shown(value)));
    }
    for (const value of ticks(panel.now.y, 5)) {
      const [, y] = this.place(panel, panel.now.x[0], value);
      this.drawing.append(drawn("path", { d: `M${left - 4.5} ${y}h4.5`, class: "axis" }));
      this.drawing.append(drawn("text", { x: left - 7, y: y + 4, "text-anchor": "end", class: "tick" }, shown(value)));
    }
    this.drawNames(panel);
  }

  drawSeries(panel, series, group) {
    const places = series.x.map((x, i) => this.place(panel, x, series.y[i]));
    if (series.kind === "d") {
      for (const [x, y] of places)
        if (Number.isFinite(x) && Number.isFinite(y))
          group.append(drawn("circle", { cx: x, cy: y, r: 2.4, fill: series.open ? "#fff" : series.colour, stroke: series.colour }));
      return;
    }
    let path = "";
    let before = null;
    for (const [x, y] of places) {
      if (!Number.isFinite(x) || !Number.isFinite(y)) before = null;
      else {
        path += before ? (series.kind === "t" ? `H${x.toFixed(1)}V${y.toFixed(1)}` : `L${x.toFixed(1)} ${y.toFixed(1)}`) : `M${x.toFixed(1)} ${y.toFixed(1)}`;
        before = [x, y];
      }
    }
    group.append(drawn("path", { d: path, fill: "none", stroke: series.colour, "stroke-width": series.width || 1.6, "stroke-dasharray": series.dash || null }));
  }

  // Names follow the last value of the curve of their colour that is still to be seen.
  drawNames(panel) {
    const [left, top, width, height] = panel.box;
    const wanted = (panel.names || []).map(([y, text, colour]) => {
      const own = panel.series.find((s) => s.colour === colour);
      let value = y;
      if (own) own.x.forEach((x, i) => { if (x <= panel.now.x[1] && Number.isFinite(own.y[i])) value = own.y[i]; });
      const [, place] = this.place(panel, panel.now.x[1], value);
      return { text, colour, place: Math.min(Math.max(place, top), top + height) };
    });
    wanted.sort((a, b) => a.place - b.place);
    wanted.forEach((one, i) => {
      if (i) one.place = Math.max(one.place, wanted[i - 1].place + 14);
      this.drawing.append(drawn("text", { x: left + width + 6, y: one.place + 4, fill: one.colour, class: "name" }, one.text));
    });
  }
}
Chart.count = 0;

const charts = new Map();
const openFigures = () => {
  document.querySelectorAll("script.values").forEach((data) => {
    const span = data.previousElementSibling;
    if (span && span.classList.contains("plot")) charts.set(span, new Chart(span, JSON.parse(data.textContent)));
  });
};

// ---- overlay -----------------------------------------------------------------------------------------------------

const openOverlay = (list) => {
  const items = [...list.querySelectorAll("li")].map((item) => {
    const chart = charts.get(item.querySelector("span.plot"));
    return { item, panel: chart && chart.panels[0], name: item.querySelector("figcaption bdi")?.textContent || "" };
  }).filter((one) => one.panel && one.panel.series.length);
  if (items.length < 2) return;
  const span = element("span", { class: "plot overlay" });
  span.size = [1000, 420];
  const figure = element("figure", { class: "overlay" }, span, element("figcaption", {}, "Chosen specimens on the same axes: dots measured, lines models."));
  figure.hidden = true;
  list.before(figure);
  const draw = () => {
    const chosen = items.filter((one) => one.box.checked);
    figure.hidden = !chosen.length;
    span.replaceChildren();
    if (!chosen.length) return;
    const first = chosen[0].panel;
    const ends = (axis) => around({ y: first[axis] }, chosen.flatMap((c) => c.panel.series.flatMap((s) => s[axis])));
    const panel = { box: [60, 24, 780, 350], x: ends("x"), y: ends("y"), xt: "Frequency, Hz", yt: "Dynamic stiffness |k|, N/mm", series: [], names: [] };
    for (const one of chosen) {
      const colour = COLOURS[items.indexOf(one) % COLOURS.length];
      for (const series of one.panel.series) panel.series.push({ ...series, colour, name: one.name, open: false });
      const last = one.panel.series[0];
      panel.names.push([last.y[last.y.length - 1], one.name, colour]);
    }
    const chart = new Chart(span, [panel]);
    chart.draw(chart.panels);
    chart.span.addEventListener("zoomed", (event) => { if (!event.detail) chart.draw(chart.panels); });
    chart.svg.append(drawn("text", { x: 60, y: 14, class: "name" }, panel.yt), drawn("text", { x: 450, y: 412, "text-anchor": "middle", class: "name" }, panel.xt));
  };
  items.forEach((one, i) => {
    one.box = element("input", { type: "checkbox", id: `overlay-${i}` });
    one.box.addEventListener("change", draw);
    one.item.append(element("label", { class: "tool", for: `overlay-${i}` }, one.box, " overlay"));
  });
};

openSearch();
document.querySelectorAll("main .scroll").forEach(openTable);
openFigures();
document.querySelectorAll("ul.many").forEach(openOverlay);
})();
