"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];
  const SVG = "http://www.w3.org/2000/svg";

  function svg(name, attributes = {}, parent = null, text = null) {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== null) node.textContent = text;
    if (parent) parent.append(node);
    return node;
  }
  function html(name, attributes = {}, ...children) {
    const node = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  }

  // -- what is shown: in the address after the section, so that it can be sent to somebody --------------
  const state = { hidden: new Set(), chosen: {}, single: null };
  function remember() {
    const parts = Object.entries(state.chosen).map(([name, value]) => `${name}=${encodeURIComponent(value)}`);
    if (state.hidden.size) parts.push("hide=" + [...state.hidden].map(encodeURIComponent).join(","));
    const section = location.hash.slice(1).split(";")[0];
    history.replaceState(null, "", parts.length || section ? "#" + [section, ...parts].join(";") : location.pathname);
  }
  function recall() {
    const [section, ...parts] = location.hash.slice(1).split(";");
    for (const part of parts) {
      const [name, value] = part.split("=");
      if (value === undefined) continue;
      if (name === "hide") state.hidden = new Set(value.split(",").map(decodeURIComponent));
      else state.chosen[name] = decodeURIComponent(value);
    }
    if (parts.length && section) document.getElementById(section)?.scrollIntoView();
  }

  // -- sortable tables: blanks last, whichever way ----------------------------------------------------
  function sortBy(table, column, ascending) {
    const body = table.tBodies[0];
    const key = (row) => {
      const cell = row.cells[column];
      if (cell.dataset.v !== undefined) return Number(cell.dataset.v);
      const text = cell.textContent.trim();
      return text === "" || text === "—" ? null : text;
    };
    const order = (a, b) => {
      if (a === null || b === null) return (a === null) - (b === null);
      if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
      const sign = ascending ? 1 : -1;
      return sign * (typeof a === "number" ? a - b : a.localeCompare(b, "en", { numeric: true }));
    };
    const keyed = [...body.rows].map((row) => [key(row), row]);
    keyed.sort((a, b) => order(a[0], b[0]));
    body.append(...keyed.map(([, row]) => row));
  }
  for (const table of all("table.sortable")) {
    const heads = all("tr.heads > th", table);
    heads.forEach((head, column) => {
      head.querySelector("button").addEventListener("click", () => {
        const ascending = head.getAttribute("aria-sort") !== "ascending";
        for (const other of heads) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", ascending ? "ascending" : "descending");
        sortBy(table, column, ascending);
      });
    });
  }
  for (const field of all("input.filter")) {
    const table = field.closest("label").nextElementSibling.querySelector("table");
    field.addEventListener("input", () => {
      const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
      for (const row of table.tBodies[0].rows) {
        const text = row.textContent.toLowerCase();
        row.hidden = !words.every((word) => text.includes(word));
      }
    });
  }

  // -- alternatives: one choice of a name for the whole page ----------------------------------------------
  function choose(name, value) {
    state.chosen[name] = value;
    for (const group of all(`[data-choice="${name}"]`)) {
      const options = [...group.children].filter((child) => child.dataset.option !== undefined);
      const wanted = options.some((option) => option.dataset.option === value) ? value : options[0].dataset.option;
      for (const option of options) option.hidden = option.dataset.option !== wanted;
      group.querySelector("select").value = wanted;
    }
    drawAll();
  }
  for (const select of all("[data-choice] > label select")) {
    select.addEventListener("change", () => {
      choose(select.closest("[data-choice]").dataset.choice, select.value);
      remember();
    });
  }

  // -- scales -------------------------------------------------------------------------------------------
  const superscript = (n) => String(n).replace(/[-0-9]/g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]);
  const power = (k) => (k === 0 ? "1" : k === 1 ? "10" : "10" + superscript(k));
  function powers(v) {
    const k = Math.floor(Math.log10(v) + 1e-9);
    const part = Number((v / 10 ** k).toPrecision(2));
    if (Math.abs(k) < 3) return String(Number(v.toPrecision(2)));
    return part === 1 ? power(k) : `${part}·${power(k)}`;
  }
  const plain = (v) => (v !== 0 && (Math.abs(v) < 1e-3 || Math.abs(v) >= 1e5) ? v.toExponential(2) : String(Number(v.toPrecision(4))));

  /** The range of an axis: what is drawn, a little more, or the limits it must have. */
  function range(axis, values) {
    const use = axis.log ? values.filter((v) => v > 0).map(Math.log10) : values;
    let low = use.reduce((a, b) => Math.min(a, b), Infinity);
    let high = use.reduce((a, b) => Math.max(a, b), -Infinity);
    if (!(low <= high)) [low, high] = [0, 1];
    const pad = Math.max(axis.log ? 0.1 : 1e-12 * Math.abs(high), 0.04 * (high - low)) || 0.5;
    const limit = (axis.limits || [null, null]).map((v) => (v === null || !axis.log ? v : Math.log10(v)));
    const [a, b] = [limit[0] ?? low - pad, limit[1] ?? high + pad];
    return a <= b ? [a, b] : [b, a];
  }
  function ticks(axis, [low, high], room) {
    if (axis.ticks) return axis.ticks.map(([v, text]) => [axis.log ? Math.log10(v) : v, text]);
    if (axis.log) {
      const step = Math.max(1, Math.ceil((high - low) / room));
      const inside = [];
      for (let k = Math.floor(low); k <= high; k++) {
        const parts = high - low < 0.7 ? [1, 1.5, 2, 3, 5, 7] : high - low < 1.5 ? [1, 2, 5] : k % step ? [] : [1];
        inside.push(...parts.map((part) => part * 10 ** k));
      }
      return inside.map((v) => [Math.log10(v), powers(v)]).filter(([v]) => v >= low && v <= high);
    }
    const rough = (high - low) / Math.max(2, room);
    const base = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((part) => part * base).find((s) => s >= rough);
    const inside = [];
    for (let i = Math.ceil(low / step); i * step <= high; i++) inside.push([i * step, plain(i * step)]);
    return inside;
  }

  // -- figures --------------------------------------------------------------------------------------------
  const DASH = "5 4";
  const figures = all("figure[data-figure]").map((box) => {
    const made = data.figures[box.dataset.figure];
    return { box, made, plots: all(".plot", box).map((place, i) => ({ box: place, panel: made.panels[i], dots: [] })) };
  });
  const nameOf = (curve) => curve.method || curve.label || "";
  const shown = (curve) => !state.hidden.has(nameOf(curve));

  function draw(plot) {
    const { box, panel } = plot;
    const width = box.clientWidth;
    if (!width) return;
    const height = Math.round(panel.equal ? Math.min(width, 460) : Math.min(400, Math.max(260, 0.72 * width)));
    const pad = { left: 58, right: 12, top: 24, bottom: 46 };
    const curves = panel.curves.filter(shown);
    box.replaceChildren();
    plot.dots = [];
    plot.cursor = null;
    const figure = svg("svg", { viewBox: `0 0 ${width} ${height}`, width, height, tabindex: 0, role: "group" }, box);
    figure.setAttribute("aria-label", `${panel.title}: ${curves.length} curves, arrow keys walk along their points`);
    plot.tip = html("div", { class: "tip", hidden: "" });
    box.append(plot.tip);
    svg("text", { class: "title", x: (pad.left + width - pad.right) / 2, y: 14, "text-anchor": "middle" }, figure, panel.title);
    const known = (name) => curves.flatMap((curve) => [...curve[name], ...(name === "y" ? [...(curve.low || []), ...(curve.high || [])] : [])])
      .concat(panel.heat ? panel.heat[name] : []).filter((v) => v !== null);
    let xs = range(panel.x, known("x"));
    let ys = range(panel.y, known("y"));
    const [w, h] = [width - pad.left - pad.right, height - pad.top - pad.bottom];
    if (panel.equal) {
      const unit = Math.max((xs[1] - xs[0]) / w, (ys[1] - ys[0]) / h);
      const widen = ([low, high], room) => [(low + high - unit * room) / 2, (low + high + unit * room) / 2];
      [xs, ys] = [widen(xs, w), widen(ys, h)];
    }
    const place = (axis, [low, high], v, from, to) => {
      const part = ((axis.log ? Math.log10(v) : v) - low) / (high - low);
      return from + (axis.inverted ? 1 - part : part) * (to - from);
    };
    const bottom = height - pad.bottom;
    const X = (v) => place(panel.x, xs, v, pad.left, width - pad.right);
    const Y = (v) => place(panel.y, ys, v, bottom, pad.top);
    const back = (axis, v) => (axis.log ? 10 ** v : v);
    const clip = "clip-" + Math.random().toString(36).slice(2);
    svg("rect", { x: pad.left, y: pad.top, width: w, height: h }, svg("clipPath", { id: clip }, figure));
    for (const [axis, low, high, label] of panel.spans || []) {
      const [a, b] = axis === "x" ? [X(low), X(high)] : [Y(high), Y(low)];
      const where = axis === "x" ? { x: Math.min(a, b), width: Math.max(1, Math.abs(b - a)), y: pad.top, height: h } : { y: Math.max(pad.top, a), height: Math.max(1, Math.min(b, bottom) - Math.max(pad.top, a)), x: pad.left, width: w };
      svg("rect", { class: "span", ...where, "clip-path": `url(#${clip})` }, figure);
      if (label) svg("text", { class: "soft", x: where.x + 4, y: Math.min(bottom - 4, where.y + 12) }, figure, label);
    }
    if (panel.heat) {
      const cell = (values) => Math.abs((values[values.length - 1] - values[0]) / Math.max(1, values.length - 1));
      const [dx, dy] = [cell(panel.heat.x), cell(panel.heat.y)];
      panel.heat.colors.forEach((row, j) => row.forEach((fill, i) => {
        const [x, y] = [panel.heat.x[i], panel.heat.y[j]];
        svg("rect", { fill, x: X(x - dx / 2), y: Y(y + dy / 2), width: X(x + dx / 2) - X(x - dx / 2) + 0.5, height: Y(y - dy / 2) - Y(y + dy / 2) + 0.5, "clip-path": `url(#${clip})` }, figure);
      }));
    }
    for (const [v, text] of ticks(panel.x, xs, w / 52)) {
      const x = X(back(panel.x, v));
      svg("line", { class: "grid", x1: x, x2: x, y1: pad.top, y2: bottom }, figure);
      svg("text", { x, y: bottom + 17, "text-anchor": "middle" }, figure, text);
    }
    for (const [v, text] of ticks(panel.y, ys, h / 30)) {
      const y = Y(back(panel.y, v));
      svg("line", { class: "grid", x1: pad.left, x2: width - pad.right, y1: y, y2: y }, figure);
      svg("text", { x: pad.left - 7, y: y + 4, "text-anchor": "end" }, figure, text);
    }
    svg("rect", { class: "frame", x: pad.left, y: pad.top, width: w, height: h }, figure);
    svg("text", { x: (pad.left + width - pad.right) / 2, y: height - 8, "text-anchor": "middle" }, figure, panel.x.label);
    svg("text", { transform: `translate(13 ${(pad.top + bottom) / 2}) rotate(-90)`, "text-anchor": "middle" }, figure, panel.heat ? panel.y.label + " · colour: " + panel.heat.label : panel.y.label);
    if (!curves.length && !panel.heat) svg("text", { x: width / 2, y: height / 2, "text-anchor": "middle" }, figure, "nothing to show");

    for (const curve of curves) {
      const look = data.styles[curve.style];
      const group = svg("g", { class: `line tint m-${look.n}${curve.emphasis ? " strong" : ""}`, "data-name": nameOf(curve), "clip-path": `url(#${clip})` }, figure);
      const places = curve.x.map((x, i) => (x === null || curve.y[i] === null || (panel.x.log && x <= 0) || (panel.y.log && curve.y[i] <= 0) ? null : [X(x), Y(curve.y[i])]));
      if (curve.line !== false) {
        let pen = "M";
        const d = places.map((at) => {
          if (at === null) { pen = "M"; return ""; }
          const out = `${pen}${at[0].toFixed(1)} ${at[1].toFixed(1)}`;
          pen = "L";
          return out;
        }).join("");
        svg("path", { class: "curve", d, "stroke-width": look.width, ...(curve.dashed ? { "stroke-dasharray": DASH } : {}) }, group);
      }
      (curve.low || []).forEach((low, i) => {
        if (places[i] && low !== null && curve.high[i] !== null) svg("line", { class: "bar", x1: places[i][0], x2: places[i][0], y1: Y(low), y2: Y(curve.high[i]) }, group);
      });
      places.forEach((at, i) => {
        if (at === null) return;
        plot.dots.push({ x: at[0], y: at[1], curve, i });
        if (curve.markers === false || i % (curve.every || 1)) return;
        svg("path", { class: look.hollow ? "dot hollow" : "dot", d: look.marker, transform: `translate(${at[0].toFixed(1)} ${at[1].toFixed(1)}) scale(${curve.emphasis ? 9 : 7})` }, group);
      });
      const last = places.filter(Boolean).pop();
      if (curve.note && last) svg("text", { class: "note-text", x: Math.min(last[0] + 5, width - 4), y: last[1] + 4, "text-anchor": last[0] > width - 60 ? "end" : "start" }, group, curve.note);
    }
    for (const [x, y, text] of panel.notes || []) svg("text", { class: "word", x: X(x), y: Y(y) + 4, "text-anchor": "middle" }, figure, text);
    plot.ring = svg("circle", { class: "here", r: 8, visibility: "hidden" }, figure);
    for (const kind of ["pointermove", "pointerdown"]) figure.addEventListener(kind, (event) => point(plot, event));
    for (const kind of ["pointerleave", "blur"]) figure.addEventListener(kind, () => leave(plot));
    figure.addEventListener("keydown", (event) => walk(plot, event));
    single(plot);
  }

  function point(plot, event) {
    const area = plot.box.getBoundingClientRect();
    const [x, y] = [event.clientX - area.left, event.clientY - area.top];
    let best = null;
    let least = event.pointerType === "touch" ? 40 : 26;
    plot.dots.forEach((dot, i) => {
      const distance = Math.hypot(dot.x - x, dot.y - y);
      if (distance < least) [best, least] = [i, distance];
    });
    if (best === null) leave(plot);
    else tell(plot, best);
  }

  /** Along a curve with left and right; up and down to the nearest point of another curve. */
  function walk(plot, event) {
    if (event.key === "Escape") return leave(plot);
    if (!event.key.startsWith("Arrow") || !plot.dots.length) return;
    event.preventDefault();
    if (plot.cursor === null) return tell(plot, 0, true);
    const here = plot.dots[plot.cursor];
    const [dx, dy] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    let best = null;
    let least = Infinity;
    plot.dots.forEach((dot, i) => {
      const same = dot.curve === here.curve;
      if (i === plot.cursor || same !== (dx !== 0)) return;
      const ahead = (dot.x - here.x) * dx + (dot.y - here.y) * dy;
      const aside = Math.abs((dot.x - here.x) * dy) + Math.abs((dot.y - here.y) * dx);
      const distance = ahead + (dx ? 0 : 3 * aside);
      if (ahead > 0 && distance < least) [best, least] = [i, distance];
    });
    if (best !== null) tell(plot, best, true);
  }

  function tell(plot, index, aloud = false) {
    plot.cursor = index;
    const { x, y, curve, i } = plot.dots[index];
    const { panel } = plot;
    const said = [[panel.x.label || "x", plain(curve.x[i])], [panel.y.label || "y", plain(curve.y[i])]];
    const lines = said.map(([name, value]) => html("tr", {}, html("td", {}, name), html("td", {}, value)));
    const hint = (curve.hints || [])[i] || "";
    const name = nameOf(curve) || curve.label || panel.title;
    plot.tip.replaceChildren(html("b", {}, name), html("table", {}, html("tbody", {}, ...lines)), html("span", {}, hint));
    plot.tip.hidden = false;
    const [w, h] = [plot.tip.offsetWidth, plot.tip.offsetHeight];
    const left = x + 16 + w <= plot.box.clientWidth ? x + 16 : x - 16 - w;
    plot.tip.style.left = Math.max(0, Math.min(left, plot.box.clientWidth - w)) + "px";
    plot.tip.style.top = Math.max(0, Math.min(y - h / 2, plot.box.clientHeight - h)) + "px";
    for (const [key, value] of [["cx", x], ["cy", y], ["visibility", "visible"]]) plot.ring.setAttribute(key, value);
    light(nameOf(curve));
    if (aloud) document.getElementById("spoken").textContent = [name, ...said.map((pair) => pair.join(" ")), hint].filter(Boolean).join(", ");
  }
  function leave(plot) {
    plot.cursor = null;
    if (plot.tip) plot.tip.hidden = true;
    if (plot.ring) plot.ring.setAttribute("visibility", "hidden");
    light(null);
  }
  function light(name) {
    if (state.single === name) return;
    state.single = name;
    for (const figure of figures) figure.plots.forEach(single);
  }
  function single(plot) {
    const lines = all(".line", plot.box);
    const some = Boolean(state.single) && lines.some((line) => line.dataset.name === state.single);
    plot.box.classList.toggle("single", some);
    for (const line of lines) line.classList.toggle("lit", line.dataset.name === state.single);
  }

  // -- legends: what is hidden is hidden everywhere, and the rest takes the room -------------------------------
  function legend({ box, made }) {
    const list = box.querySelector(".keys");
    const entries = new Map();
    for (const panel of made.panels) for (const curve of panel.curves) if (nameOf(curve) && (curve.label || curve.method) && !entries.has(nameOf(curve))) entries.set(nameOf(curve), curve);
    if (entries.size < 2) return;
    for (const [name, curve] of entries) {
      const look = data.styles[curve.style];
      const glyph = svg("svg", { class: `glyph tint m-${look.n}`, "aria-hidden": "true" });
      svg("use", { href: `#mark-${look.n}` }, glyph);
      const button = html("button", { type: "button", class: "key", value: name, "aria-pressed": !state.hidden.has(name) }, glyph, name);
      button.addEventListener("click", () => {
        if (!state.hidden.delete(name)) state.hidden.add(name);
        drawAll();
        remember();
        light(state.hidden.has(name) ? null : name);
      });
      for (const kind of ["pointerenter", "focus"]) button.addEventListener(kind, () => light(name));
      for (const kind of ["pointerleave", "blur"]) button.addEventListener(kind, () => light(null));
      list.append(html("li", {}, button));
    }
    for (const [text, hide] of [["all", false], ["none", true]]) {
      const button = html("button", { type: "button", class: "key every", value: text }, text);
      button.addEventListener("click", () => {
        for (const name of entries.keys()) hide ? state.hidden.add(name) : state.hidden.delete(name);
        drawAll();
        remember();
      });
      list.append(html("li", {}, button));
    }
    const save = html("button", { type: "button", class: "key every", value: "save" }, "save as SVG");
    save.addEventListener("click", () => saved(box));
    list.append(html("li", {}, save));
  }
  /** The panels as SVG files, with the colours they have on the page. */
  function saved(box) {
    all(".plot > svg", box).forEach((figure, i) => {
      const copy = figure.cloneNode(true);
      const originals = [figure, ...all("*", figure)];
      [copy, ...all("*", copy)].forEach((node, k) => {
        const style = getComputedStyle(originals[k]);
        for (const name of ["fill", "stroke", "stroke-width", "stroke-dasharray", "opacity", "font-size", "font-family"]) node.style.setProperty(name, style.getPropertyValue(name));
      });
      copy.setAttribute("xmlns", SVG);
      const link = html("a", { download: `${box.dataset.figure}-${i + 1}.svg`, href: "data:image/svg+xml;charset=utf-8," + encodeURIComponent(copy.outerHTML) });
      link.click();
    });
  }
  function drawAll() {
    for (const figure of figures) figure.plots.forEach(draw);
    for (const button of all(".key:not(.every)")) button.setAttribute("aria-pressed", !state.hidden.has(button.value));
  }

  // -- paper: everything open; and which section one is in -------------------------------------------------------
  let opened = [];
  window.addEventListener("beforeprint", () => {
    opened = all("details:not([open])");
    for (const item of opened) item.open = true;
  });
  window.addEventListener("afterprint", () => {
    for (const item of opened) item.open = false;
  });
  const links = new Map(all("nav a").map((link) => [link.getAttribute("href").slice(1), link]));
  const watch = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) {
        if (!entry.isIntersecting) continue;
        for (const link of links.values()) link.removeAttribute("aria-current");
        links.get(entry.target.id)?.setAttribute("aria-current", "true");
      }
    },
    { rootMargin: "-20% 0px -75% 0px" },
  );
  for (const section of all("main > section")) watch.observe(section);

  let width = 0;
  new ResizeObserver(() => {
    if (document.body.clientWidth === width) return;
    width = document.body.clientWidth;
    drawAll();
  }).observe(document.body);
  recall();
  figures.forEach(legend);
  const names = new Set(all("[data-choice]").map((group) => group.dataset.choice));
  for (const name of names) choose(name, state.chosen[name] ?? document.querySelector(`[data-choice="${name}"] select`).value);
  if (!names.size) drawAll();
})();
