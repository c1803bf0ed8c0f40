"use strict";
// What is chosen is `state`; `draw` shows it.  Names, looks and rows come from the tables (page.py).
const data = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);
const names = Object.keys(data.rows);
const rows = data.rows.scene.map((_, i) => Object.fromEntries(names.map((name) => [name, data.rows[name][i]])));
const columns = names.filter((name) => name !== "scene");
const numeric = new Set(names.filter((name) => data.rows[name].some((value) => typeof value === "number")));
const narrow = matchMedia("(max-width: 800px)");
const darkness = matchMedia("(prefers-color-scheme: dark)");
const state = { scene: Object.keys(data.scenes)[0], cost: 0, methods: null, sort: ["error", 1], theme: null };

// -- what is shown ---------------------------------------------------------------------------------
const cost = () => data.costs[state.cost];
const theme = () => state.theme ?? (darkness.matches ? "dark" : "light");
const preset = () => data.presets[state.scene][state.cost];
const chosen = () => new Set(state.methods ?? preset());
const fits = (row) => row.scene === state.scene && (!cost().engines || data.engines[row.engine] === cost().engines);
const drawn = (row) => row.status === "ok" && row.error !== null && row[cost().column] !== null;

/** Curves of the chosen methods: one for each way to set the step; of several engines the first, compiled ones first. */
function curves() {
  const found = new Map(), own = chosen();
  for (const row of rows.filter((row) => fits(row) && drawn(row) && own.has(row.method))) {
    const key = `${row.method}, ${row.control}`;
    if (!found.has(key)) found.set(key, new Map());
    const engines = found.get(key);
    if (!engines.has(row.engine)) engines.set(row.engine, []);
    engines.get(row.engine).push(row);
  }
  const rank = (engine) => Number(data.engines[engine] !== "compiled");
  const all = [...found.values()].map((engines) => engines.get([...engines.keys()].sort((a, b) => rank(a) - rank(b))[0]));
  const others = (own) => all.filter(([row]) => row.method === own.method && row.control !== own.control);
  return all.map((points) => {
    const [row] = points;
    const several = others(row).length > 0;
    const name = several ? `${row.method}, ${row.control}` : row.method;
    points.sort((a, b) => b.setting - a.setting);
    return { method: row.method, name, points, second: several && row.control !== "step" }; // drawn thinner
  });
}

const plain = (value) => (Math.abs(value) >= 1e-3 && Math.abs(value) < 1e6) || value === 0 || Number.isInteger(value)
  ? String(Number(value.toPrecision(6))) : value.toExponential(2);
const SI = [[1, "s"], [1e-3, "ms"], [1e-6, "µs"], [0, "ns"]];
function seconds(value) {
  if (value === 0) return "0 s";
  const [unit, name] = SI.find(([unit]) => value >= unit);
  return `${Number((value / (unit || 1e-9)).toPrecision(3))} ${name}`;
}
function text(name, value) {
  if (value === null || value === "") return "";
  if (typeof value !== "number") return value;
  if (name === "error") return value.toExponential(2);
  return name.endsWith("_s") ? seconds(value) : plain(value);
}

// -- the figure ------------------------------------------------------------------------------------
/** A logarithmic axis around some values; ticks at decades, and at 2 and 5 where there are few of them. */
function logarithmic(values, most, label, count = 9) {
  const low = Math.log10(Math.min(...values)), high = Math.log10(Math.min(Math.max(...values), most));
  const margin = 0.04 * (high - low) + 0.1, every = Math.ceil((high - low) / count);
  const decades = Array.from({ length: Math.max(0, Math.ceil(high) - Math.floor(low) + 2) }, (_, i) => Math.floor(low) + i);
  const steps = high - low < 2 ? [1, 2, 5] : [1];
  const ticks = decades.filter((n) => n % every === 0).flatMap((n) => steps.map((k) => Number(`${k}e${n}`)));
  return { type: "log", range: [low - margin, high + margin], tickmode: "array", tickvals: ticks, ticktext: ticks.map(label) };
}
const power = (value) => (value === 1 ? "1" : value.toExponential().replace(/^1e|e/, (e) => (e === "1e" ? "10<sup>" : "·10<sup>")).replace("+", "") + "</sup>").replace("-", "−");

function hover(name, row) {
  const lines = ["error", "least_s", "evaluations", "steps"].filter((column) => row[column] !== null)
    .map((column) => `${column === "least_s" ? "time" : column} ${text(column, row[column])}`);
  const how = row.control === "exact" ? "exact" : `${row.control} = ${plain(row.setting)}`;
  return [`<b>${name}</b>`, ...lines, how, `engine ${row.engine}`].join("<br>");
}

// plotly's others send the figure away
const BUTTONS = ["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"];

function plot() {
  const css = getComputedStyle(document.documentElement);
  const color = (name) => css.getPropertyValue(`--${name}`).trim();
  const own = curves();
  const traces = own.map(({ method, name, points, second }) => {
    const look = data.methods[method];
    return {
      name, mode: "lines+markers", type: "scatter", text: points.map((row) => hover(name, row)),
      x: points.map((row) => row[cost().column]), y: points.map((row) => Math.max(row.error, data.floor)),
      hovertemplate: "%{text}<extra></extra>",
      line: { color: look[theme()], dash: look.dash, width: second ? 1 : 2 },
      marker: { color: look[theme()], symbol: look.symbol, size: second ? 6 : 9, line: { width: second ? 1 : 1.6, color: look[theme()] } },
    };
  });
  const axis = { gridcolor: color("grid"), linecolor: color("line"), zeroline: false };
  const label = cost().column.endsWith("_s") ? seconds : (value) => value.toLocaleString("en");
  const below = narrow.matches;
  $("plot").style.height = below ? `${400 + 19 * own.length}px` : "";
  const layout = {
    paper_bgcolor: color("ground"), plot_bgcolor: color("ground"), hovermode: "closest", showlegend: true,
    font: { color: color("ink"), family: css.fontFamily || "sans-serif", size: below ? 12 : 13 },
    margin: below ? { l: 58, r: 8, t: 8, b: 64 + 19 * own.length } : { l: 70, r: 10, t: 30, b: 60 },
    xaxis: { ...axis, ...logarithmic(traces.flatMap((trace) => trace.x), Infinity, label, below ? 5 : 9), tickangle: 0, title: { text: cost().axis, standoff: 8 } },
    yaxis: { ...axis, ...logarithmic(traces.flatMap((trace) => trace.y), 10, power), title: { text: "relative error at the end" } },
    legend: below ? { orientation: "h", yref: "container", y: 0, yanchor: "bottom", x: 0, entrywidth: 1, entrywidthmode: "fraction" } : {},
    hoverlabel: { bgcolor: color("raised"), bordercolor: color("line"), font: { color: color("ink") }, align: "left" },
    annotations: own.length ? [] : [{ text: "no chosen method has a point here", showarrow: false, xref: "paper", yref: "paper", x: 0.5, y: 0.5 }],
  };
  layout.legend.itemclick = layout.legend.itemdoubleclick = false;
  const shown = new Set(own.map((curve) => curve.method));
  const absent = [...chosen()].filter((method) => !shown.has(method));
  $("missing").textContent = absent.length ? `No point by ${cost().name}: ${absent.join(", ")}.` : "";
  return Plotly.react("plot", traces, layout, { responsive: true, displaylogo: false, modeBarButtons: [BUTTONS] });
}

// -- the table -------------------------------------------------------------------------------------
const COMPARISON = /^(\w+)(<=|>=|<|>|=)(.*)$/;
const COMPARE = { "<": (a, b) => a < b, ">": (a, b) => a > b, "<=": (a, b) => a <= b, ">=": (a, b) => a >= b, "=": (a, b) => a === b };
function passes(row, term) {
  const [, name, sign, value] = COMPARISON.exec(term) ?? [];
  if (columns.includes(name)) {
    const bound = numeric.has(name) ? Number(value) : value;
    if (value === "" || Number.isNaN(bound)) return true; // it is still being typed
    return row[name] !== null && COMPARE[sign](numeric.has(name) ? row[name] : row[name].toLowerCase(), bound);
  }
  return columns.some((column) => text(column, row[column]).toLowerCase().includes(term));
}

function listed(of) {
  const terms = $("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  const [by, sign] = state.sort;
  const blank = (row) => row[by] === null || row[by] === "";
  const order = (a, b) => (a < b ? -sign : a > b ? sign : 0);
  return of.filter((row) => terms.every((term) => passes(row, term)))
    .sort((a, b) => blank(a) - blank(b) || order(a[by], b[by])); // blanks come last in either order
}

function element(tag, properties, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function fill() {
  const [by, sign] = state.sort;
  const own = chosen();
  const all = rows.filter((row) => fits(row) && own.has(row.method));
  const used = columns.filter((name) => all.some((row) => row[name] !== null && row[name] !== ""));
  const found = listed(all);
  const kind = (name) => (numeric.has(name) ? "number" : "");
  const heads = used.map((name) => {
    const button = element("button", { type: "button", title: data.meanings[name], onclick: () => sortBy(name) }, name);
    const head = element("th", { className: kind(name), scope: "col" }, button);
    head.setAttribute("aria-sort", name !== by ? "none" : sign > 0 ? "ascending" : "descending");
    return head;
  });
  document.querySelector("thead").replaceChildren(element("tr", {}, ...heads));
  const line = (row) => element("tr", {}, ...used.map((name) => element("td", { className: kind(name) }, text(name, row[name]))));
  document.querySelector("tbody").replaceChildren(...found.map(line));
  $("count").textContent = `${found.length} rows`;
}

function sortBy(name) {
  state.sort = [name, state.sort[0] === name ? -state.sort[1] : 1];
  fill();
  [...document.querySelectorAll("th button")].find((button) => button.textContent === name).focus();
}

// -- the choice ------------------------------------------------------------------------------------
function offer() {
  const here = new Set(rows.filter((row) => fits(row) && drawn(row)).map((row) => row.method));
  const own = chosen();
  const groups = data.families.map((family) => [family, Object.keys(data.methods).filter((m) => data.methods[m].family === family)]);
  const entry = (method) => {
    const box = element("input", { type: "checkbox", value: method, checked: own.has(method), onchange: () => toggle(method) });
    const swatch = element("span", { className: "swatch" });
    swatch.style.background = data.methods[method][theme()];
    return element("label", { className: here.has(method) ? "" : "absent", title: here.has(method) ? "" : "no point here" }, box, swatch, method);
  };
  const sets = groups.filter(([, methods]) => methods.length)
    .map(([family, methods]) => element("fieldset", {}, element("legend", {}, family), ...methods.map(entry)));
  $("methods").replaceChildren(...sets);
  $("chosen").textContent = `${own.size} of ${Object.keys(data.methods).length}`;
}

function toggle(method) {
  const own = chosen();
  if (!own.delete(method)) own.add(method);
  choose([...own]);
  document.querySelector(`#methods input[value="${CSS.escape(method)}"]`).focus();
}

function choose(methods) {
  state.methods = methods;
  draw();
}

function draw() {
  document.documentElement.dataset.theme = theme();
  $("theme").textContent = theme() === "dark" ? "Light" : "Dark";
  $("scene").value = state.scene;
  $("cost").value = state.cost;
  $("title").textContent = `${state.scene}: error against ${cost().name}`;
  $("about").textContent = data.scenes[state.scene];
  $("about").innerHTML = $("about").innerHTML.replace(/\^\{([^}]*)\}/g, "<sup>$1</sup>");
  $("query").textContent = `cb.results("runs").query("scene == '${state.scene}' and saved == 1")`;
  const scroll = $("methods").scrollTop;
  offer();
  $("methods").scrollTop = scroll;
  fill();
  const said = new URLSearchParams({ scene: state.scene, cost: cost().name });
  if (state.methods) said.set("methods", state.methods.join(" "));
  history.replaceState(null, "", `#${said}`);
  return plot();
}

/** Take the choice from the address, so that a view can be linked to. */
function read() {
  const said = new URLSearchParams(location.hash.slice(1));
  if (said.get("scene") in data.scenes) state.scene = said.get("scene");
  state.cost = Math.max(0, data.costs.findIndex((each) => each.name === said.get("cost")));
  state.methods = said.has("methods") ? said.get("methods").split(" ").filter((name) => name in data.methods) : null;
}

$("scene").append(...Object.keys(data.scenes).map((name) => new Option(name)));
$("cost").append(...data.costs.map((each, i) => new Option(each.name, i)));
$("scene").onchange = (event) => { state.scene = event.target.value; draw(); };
$("cost").onchange = (event) => { state.cost = Number(event.target.value); draw(); };
$("preset").onclick = () => choose(null);
$("all").onclick = () => choose(Object.keys(data.methods));
$("none").onclick = () => choose([]);
$("theme").onclick = () => { state.theme = theme() === "dark" ? "light" : "dark"; draw(); };
$("filter").oninput = fill;
$("choice").onsubmit = (event) => event.preventDefault();
addEventListener("hashchange", () => { read(); draw(); });
darkness.addEventListener("change", draw);
narrow.addEventListener("change", draw);
$("choose").open = !narrow.matches;
read();
draw();
