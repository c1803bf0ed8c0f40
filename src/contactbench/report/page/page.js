"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];
  const SVG = "http://www.w3.org/2000/svg";
  const at = Object.fromEntries(data.columns.map((name, i) => [name, i]));
  const names = Object.keys(data.methods);
  const number = Object.fromEntries(names.map((name, i) => [name, i]));

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

  // -- numbers as words -----------------------------------------------------------------------------
  const superscript = (n) => String(n).replace(/[-0-9]/g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]);
  const power = (k) => (k === 0 ? "1" : k === 1 ? "10" : "10" + superscript(k));
  const scientific = (v) => (v === null ? "—" : v.toExponential(1));
  const count = (v) => (v === null ? "—" : Math.round(v).toString().replace(/\B(?=(\d{3})+$)/g, "\u202f"));
  function duration(v) {
    if (v === null) return "—";
    for (const [unit, size] of [["s", 1], ["ms", 1e-3], ["µs", 1e-6]])
      if (v >= size * 0.9995) return Number((v / size).toPrecision(3)) + " " + unit;
    return Number((v / 1e-9).toPrecision(3)) + " ns";
  }
  const SHOW = { time_median_s: duration, rhs_equivalents: (v) => (v >= 1e5 ? powers(v) : count(v)) };

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
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      head.querySelector("button").addEventListener("click", () => {
        const ascending = head.getAttribute("aria-sort") !== "ascending";
        for (const other of heads) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", ascending ? "ascending" : "descending");
        sortBy(table, column, ascending);
      });
    });
  }

  // -- tabs -------------------------------------------------------------------------------------------
  for (const group of all("[data-tabs]")) {
    const panels = all("[data-tab]", group);
    if (panels.length < 2) continue;
    group.classList.add("tabbed");
    const list = html("div", { role: "tablist", "aria-label": "measure of cost" });
    const buttons = panels.map((panel, i) => {
      panel.id = "tab-" + i;
      panel.setAttribute("role", "tabpanel");
      const button = html("button", { type: "button", role: "tab", "aria-controls": panel.id }, panel.dataset.tab);
      button.addEventListener("click", () => choose(i));
      return button;
    });
    const choose = (i) => {
      panels.forEach((panel, k) => (panel.hidden = k !== i));
      buttons.forEach((button, k) => {
        button.setAttribute("aria-selected", k === i);
        button.tabIndex = k === i ? 0 : -1;
      });
    };
    list.addEventListener("keydown", (event) => {
      const move = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (!move) return;
      const next = (buttons.indexOf(document.activeElement) + move + buttons.length) % buttons.length;
      choose(next);
      buttons[next].focus();
    });
    list.append(...buttons);
    group.prepend(list);
    choose(0);
  }

  // -- the scene, one for the whole page ----------------------------------------------------------------
  const selects = all("select.scene");
  const state = { scene: selects.length ? selects[0].value : null, shown: new Set(names), track: null, single: null };
  function showScene(scene) {
    state.scene = scene;
    for (const select of selects) select.value = scene;
    for (const section of all(".per-scene")) section.hidden = section.dataset.scene !== scene;
    drawAll();
  }
  for (const select of selects) select.addEventListener("change", () => showScene(select.value));

  // -- figures --------------------------------------------------------------------------------------------
  const plots = all(".plot").map((box) => ({ box, y: box.dataset.y, dots: [], cursor: null }));
  const FLOOR = 5.5e-17;

  function rowsFor(plot) {
    const rows = (data.points[state.scene] || []).filter((row) => row[at[plot.y]] > 0);
    if (plot.y === "time_median_s") return rows.filter((row) => data.tracks[state.track].includes(row[at.engine]));
    const engine = {}; // evaluations do not depend on it: the first engine of each method
    for (const row of rows) engine[row[at.method]] ??= row[at.engine];
    return rows.filter((row) => row[at.engine] === engine[row[at.method]]);
  }
  const error = (row) => Math.max(row[at.solution_error], FLOOR);
  const span = (values) => {
    const logs = values.map(Math.log10);
    const [low, high] = [Math.min(...logs), Math.max(...logs)];
    const pad = Math.max(0.15, 0.04 * (high - low));
    return [low - pad, high + pad];
  };
  /** Powers of ten, not more than there is room for; steps between them where only few fit the range. */
  function ticks([low, high], room) {
    const step = Math.max(1, Math.ceil((high - low) / room));
    const inside = [];
    for (let k = Math.floor(low); k <= high; k++) {
      const parts = high - low < 0.7 ? [1, 1.5, 2, 3, 5, 7] : high - low < 1.5 ? [1, 2, 5] : k % step ? [] : [1];
      inside.push(...parts.map((part) => part * 10 ** k));
    }
    return inside.filter((v) => Math.log10(v) >= low && Math.log10(v) <= high);
  }
  function powers(v) {
    const k = Math.floor(Math.log10(v) + 1e-9);
    const part = Number((v / 10 ** k).toPrecision(2));
    return part === 1 ? power(k) : `${part}·${power(k)}`;
  }

  function draw(plot) {
    const { box } = plot;
    const width = box.clientWidth;
    if (!width) return;
    const height = Math.round(Math.min(440, Math.max(300, 0.72 * width)));
    const pad = { left: 58, right: 10, top: 8, bottom: 46 };
    const rows = rowsFor(plot);
    box.replaceChildren();
    plot.dots = [];
    plot.cursor = null;
    const figure = svg("svg", { viewBox: `0 0 ${width} ${height}`, width, height, tabindex: 0, role: "group" }, box);
    figure.setAttribute("aria-label", `cost against error on ${state.scene}: ${rows.length} points, arrow keys walk along them`);
    plot.tip = html("div", { class: "tip", hidden: "" });
    box.append(plot.tip);
    if (!rows.length) {
      svg("text", { x: width / 2, y: height / 2, "text-anchor": "middle" }, figure, "no run ended ok");
      return;
    }
    const xs = span(rows.map(error));
    const ys = span(rows.map((row) => row[at[plot.y]]));
    const X = (v) => pad.left + ((xs[1] - Math.log10(v)) / (xs[1] - xs[0])) * (width - pad.left - pad.right);
    const Y = (v) => pad.top + ((ys[1] - Math.log10(v)) / (ys[1] - ys[0])) * (height - pad.top - pad.bottom);
    const bottom = height - pad.bottom;
    for (const v of ticks(xs, (width - pad.left - pad.right) / 44)) {
      const x = X(v);
      svg("line", { class: "grid", x1: x, x2: x, y1: pad.top, y2: bottom }, figure);
      svg("text", { x, y: bottom + 17, "text-anchor": "middle" }, figure, powers(v));
    }
    for (const v of ticks(ys, (bottom - pad.top) / 28)) {
      const y = Y(v);
      svg("line", { class: "grid", x1: pad.left, x2: width - pad.right, y1: y, y2: y }, figure);
      svg("text", { x: pad.left - 7, y: y + 4, "text-anchor": "end" }, figure, SHOW[plot.y](v));
    }
    svg("rect", { class: "frame", x: pad.left, y: pad.top, width: width - pad.left - pad.right, height: bottom - pad.top }, figure);
    const middle = (pad.left + width - pad.right) / 2;
    svg("text", { x: middle, y: height - 8, "text-anchor": "middle" }, figure, `error (${data.labels.solution_error}) →`);

    const lines = new Map();
    for (const row of rows) {
      if (!state.shown.has(row[at.method])) continue;
      const key = row[at.method] + " " + row[at.engine];
      if (!lines.has(key)) lines.set(key, []);
      lines.get(key).push(row);
    }
    for (const line of lines.values()) {
      const method = line[0][at.method];
      const look = data.methods[method];
      const group = svg("g", { class: `line tint m-${number[method]}`, "data-method": method }, figure);
      const places = line.map((row) => [X(error(row)), Y(row[at[plot.y]])]);
      const run = places.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L");
      svg("path", { class: "curve", d: "M" + run }, group);
      places.forEach(([x, y], i) => {
        const dot = { class: look.hollow ? "dot hollow" : "dot", d: look.marker };
        svg("path", { ...dot, transform: `translate(${x.toFixed(1)} ${y.toFixed(1)}) scale(7.5)` }, group);
        plot.dots.push({ x, y, row: line[i], method });
      });
    }
    plot.ring = svg("circle", { class: "here", r: 8, visibility: "hidden" }, figure);
    figure.addEventListener("pointermove", (event) => point(plot, event));
    figure.addEventListener("pointerdown", (event) => point(plot, event));
    figure.addEventListener("pointerleave", () => leave(plot));
    figure.addEventListener("blur", () => leave(plot));
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
      const same = dot.method === here.method && dot.row[at.engine] === here.row[at.engine];
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
    const { x, y, row, method } = plot.dots[index];
    const iqr = row[at.time_iqr_s] ? ` ± ${duration(row[at.time_iqr_s] / 2)}` : "";
    const said = [
      ["setting", row[at.setting]],
      ["error", scientific(row[at.solution_error])],
      ["time", duration(row[at.time_median_s]) + iqr],
      ["evaluations", `${count(row[at.evaluations])} ${row[at.evaluation_kind] || ""}`.trim()],
      ...(row[at.rhs_equivalents] === row[at.evaluations] ? [] : [["as right-hand sides", count(row[at.rhs_equivalents])]]),
      ["steps", count(row[at.steps])],
      ["status", row[at.status]],
    ];
    const lines = said.map(([name, value]) => html("tr", {}, html("td", {}, name), html("td", {}, value)));
    plot.tip.replaceChildren(html("b", {}, `${method}, ${row[at.engine]}`), html("table", {}, html("tbody", {}, ...lines)));
    plot.tip.hidden = false;
    const [w, h] = [plot.tip.offsetWidth, plot.tip.offsetHeight];
    const left = x + 16 + w <= plot.box.clientWidth ? x + 16 : x - 16 - w;
    plot.tip.style.left = Math.max(0, Math.min(left, plot.box.clientWidth - w)) + "px";
    plot.tip.style.top = Math.max(0, Math.min(y - h / 2, plot.box.clientHeight - h)) + "px";
    plot.ring.setAttribute("cx", x);
    plot.ring.setAttribute("cy", y);
    plot.ring.setAttribute("visibility", "visible");
    light(method);
    if (aloud) document.getElementById("spoken").textContent = `${method}, ${said.map((pair) => pair.join(" ")).join(", ")}`;
  }
  function leave(plot) {
    plot.cursor = null;
    if (plot.tip) plot.tip.hidden = true;
    if (plot.ring) plot.ring.setAttribute("visibility", "hidden");
    light(null);
  }
  function light(method) {
    state.single = method;
    plots.forEach(single);
  }
  function single(plot) {
    const lines = all(".line", plot.box);
    const some = state.single !== null && lines.some((line) => line.dataset.method === state.single);
    plot.box.classList.toggle("single", some);
    for (const line of lines) line.classList.toggle("lit", line.dataset.method === state.single);
  }

  // -- the legend ---------------------------------------------------------------------------------------------
  const keys = document.getElementById("keys");
  function legend() {
    if (!keys) return;
    const here = new Set((data.points[state.scene] || []).map((row) => row[at.method]));
    for (const item of keys.children) item.hidden = !here.has(item.dataset.method);
    for (const button of all(".key", keys)) button.setAttribute("aria-pressed", state.shown.has(button.value));
  }
  function drawAll() {
    plots.forEach(draw);
    legend();
  }
  if (keys) {
    for (const method of names) {
      const glyph = svg("svg", { class: `glyph tint m-${number[method]}`, "aria-hidden": "true" });
      svg("use", { href: `#mark-${number[method]}` }, glyph);
      const button = html("button", { type: "button", class: "key", value: method }, glyph, method);
      button.addEventListener("click", () => {
        if (!state.shown.delete(method)) state.shown.add(method);
        drawAll();
        light(state.shown.has(method) ? method : null);
      });
      for (const kind of ["pointerenter", "focus"]) button.addEventListener(kind, () => light(method));
      for (const kind of ["pointerleave", "blur"]) button.addEventListener(kind, () => light(null));
      keys.append(html("li", { "data-method": method }, button));
    }
    for (const button of all("[data-show]")) {
      button.addEventListener("click", () => {
        const own = (method) => data.methods[method].own;
        const wanted = { all: () => true, own, others: (method) => !own(method), none: () => false }[button.dataset.show];
        state.shown = new Set(names.filter(wanted));
        drawAll();
      });
    }
  }

  // -- compiled or callbacks ------------------------------------------------------------------------------------
  const tracks = document.getElementById("tracks");
  if (tracks) {
    const buttons = Object.keys(data.tracks).map((track) => {
      const button = html("button", { type: "button", value: track }, track);
      button.addEventListener("click", () => choose(track));
      return button;
    });
    const choose = (track) => {
      state.track = track;
      for (const button of buttons) button.setAttribute("aria-pressed", button.value === track);
      document.getElementById("time-title").textContent = `Median time per solve, ${track}`;
      drawAll();
    };
    tracks.append(...buttons);
    choose(Object.keys(data.tracks)[0]);
  }

  // -- verdicts of the ledger -------------------------------------------------------------------------------------
  for (const button of all("#verdicts button")) {
    button.addEventListener("click", () => {
      button.setAttribute("aria-pressed", button.getAttribute("aria-pressed") !== "true");
      const hidden = new Set(all('#verdicts button[aria-pressed="false"]').map((other) => other.value));
      for (const row of all("#claims tbody tr")) row.hidden = hidden.has(row.querySelector(".verdict").textContent);
    });
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
    plots.forEach(draw);
  }).observe(document.body);
  if (state.scene !== null) showScene(state.scene);
})();
