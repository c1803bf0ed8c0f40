  // -- figures --------------------------------------------------------------------------------------------
  const DASH = "5 4";
  const figures = all("figure[data-figure]").map((box) => {
    const made = data.figures[box.dataset.figure];
    return { box, made, plots: all(".plot", box).map((place, i) => ({ box: place, panel: made.panels[i], own: made.own, dots: [] })) };
  });
  const nameOf = (curve) => curve.method || curve.label || "";
  const shown = (curve) => !state.hidden.has(nameOf(curve));

  function draw(plot) {
    const { box } = plot;
    const panel = { ...plot.panel, x: chosenAxis(plot.panel.x), y: chosenAxis(plot.panel.y) };
    plot.axes = panel;
    const bars = panel.y === plot.panel.y;
    const width = box.clientWidth;
    if (!width) return;
    const height = Math.round(panel.equal ? Math.min(width, 460) : Math.min(400, Math.max(300, 0.72 * width)));
    const pad = { left: 58, right: 12, top: plot.panel.remark ? 36 : 24, bottom: 46 };
    const curves = panel.curves.filter(shown).map((curve) => ({
      ...curve, of: curve, x: values(curve, "x", plot.panel.x), y: values(curve, "y", plot.panel.y),
      low: bars && !curve.muted ? curve.low : null, high: bars && !curve.muted ? curve.high : null,
    }));
    box.replaceChildren();
    plot.dots = [];
    plot.cursor = null;
    const figure = svg("svg", { viewBox: `0 0 ${width} ${height}`, width, height, tabindex: 0, role: "group" }, box);
    figure.setAttribute("aria-label", `${panel.title}: ${curves.length} curves, arrow keys walk along their points`);
    plot.tip = html("div", { class: "tip", hidden: "" });
    box.append(plot.tip);
    svg("text", { class: "title", x: (pad.left + width - pad.right) / 2, y: 14, "text-anchor": "middle" }, figure, panel.runs || panel.title);
    if (panel.remark) svg("text", { class: "soft remark", x: (pad.left + width - pad.right) / 2, y: 28, "text-anchor": "middle" }, figure, panel.remark);
    const known = (name) => {
      const other = name === "x" ? "y" : "x";
      const seen = curves.flatMap((curve) => (name === "y" ? [curve.y, curve.low || [], curve.high || []] : [curve.x])
        .flatMap((list) => list.filter((v, i) => reaches(panel[other], curve[other][i]))));
      return seen.concat(panel.heat ? panel.heat[name] : []).filter((v) => v !== null);
    };
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
    const near = (v) => Math.max(-1e4, Math.min(1e4, v)); // SVG refuses numbers of any size
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
    svg("text", { x: (pad.left + width - pad.right) / 2, y: height - 8, "text-anchor": "middle" }, figure, panel.x.runs || panel.x.label);
    svg("text", { transform: `translate(13 ${(pad.top + bottom) / 2}) rotate(-90)`, "text-anchor": "middle" }, figure, panel.y.runs || panel.y.label);
    if (!curves.length && !panel.heat) svg("text", { x: width / 2, y: height / 2, "text-anchor": "middle" }, figure, "nothing to show");

    const named = [];
    for (const curve of curves) {
      const look = data.styles[curve.style];
      const group = svg("g", { class: `line tint m-${look.n}${curve.emphasis ? " strong" : ""}${curve.muted && state.colours !== "all" ? " muted" : ""}`, "data-name": nameOf(curve), "clip-path": `url(#${clip})` }, figure);
      const places = curve.x.map((x, i) => (x === null || curve.y[i] === null || (panel.x.log && x <= 0) || (panel.y.log && curve.y[i] <= 0) ? null : [near(X(x)), near(Y(curve.y[i]))]));
      if (curve.line !== false) {
        let pen = "M";
        const d = places.map((at) => {
          if (at === null) { pen = "M"; return ""; }
          const out = `${pen}${at[0].toFixed(1)} ${at[1].toFixed(1)}`;
          pen = "L";
          return out;
        }).join("");
        svg("path", { class: "curve", d, "stroke-width": look.width, ...(curve.dashed ? { "stroke-dasharray": DASH } : look.dash ? { "stroke-dasharray": look.dash } : {}) }, group);
      }
      (curve.low || []).forEach((low, i) => {
        if (places[i] && low !== null && curve.high[i] !== null && (!panel.y.log || low > 0)) svg("line", { class: "bar", x1: places[i][0], x2: places[i][0], y1: Y(low), y2: Y(curve.high[i]) }, group);
      });
      places.forEach((at, i) => {
        if (at === null) return;
        if (at[0] < pad.left || at[0] > width - pad.right || at[1] < pad.top || at[1] > bottom) return;
        plot.dots.push({ x: at[0], y: at[1], curve, i });
        if (curve.markers === false || i % (curve.every || 1)) return;
        svg("path", { class: look.hollow ? "dot hollow" : "dot", d: look.marker, transform: `translate(${at[0].toFixed(1)} ${at[1].toFixed(1)}) scale(${curve.emphasis ? 9 : 7})` }, group);
      });
      const name = curve.muted ? "" : [curve.method && !plot.own ? curve.label : "", curve.note].filter(Boolean).join(" ");
      if (name) named.push({ name, group, places: places.filter((at) => at && at[0] >= pad.left && at[0] <= width - pad.right && at[1] >= pad.top && at[1] <= bottom) });
    }
    write(named, { left: pad.left + 2, right: width - pad.right - 2, top: pad.top + 2, bottom: bottom - 2 });
    for (const [x, y, text] of panel.notes || []) svg("text", { class: "word", x: X(x), y: Y(y) + 4, "text-anchor": "middle" }, figure, text);
    plot.ring = svg("circle", { class: "here", r: 8, visibility: "hidden" }, figure);
    for (const kind of ["pointermove", "pointerdown"]) figure.addEventListener(kind, (event) => point(plot, event));
    for (const kind of ["pointerleave", "blur"]) figure.addEventListener(kind, () => leave(plot));
    figure.addEventListener("keydown", (event) => walk(plot, event));
    single(plot);
  }

  /** Names at the curves, each where it hides least of the others; one that fits nowhere is left to the legend. */
  function write(named, frame) {
    const lines = named.map(({ places }) => places.flatMap((a, i) => {
      const b = places[i + 1] || a;
      const n = Math.max(1, Math.ceil(Math.hypot(b[0] - a[0], b[1] - a[1]) / 6));
      return Array.from({ length: n }, (_, k) => [a[0] + (k / n) * (b[0] - a[0]), a[1] + (k / n) * (b[1] - a[1])]);
    }));
    const used = [];
    named.forEach(({ name, group, places }, own) => {
      const [w, h] = [6.1 * name.length, 12];
      let [best, least] = [null, 5];
      const order = places.map((_, i) => i).reverse();
      order.forEach((i, n) => {
        const [x, y] = places[i];
        for (const [left, top] of [[x + 7, y - h / 2], [x - 7 - w, y - h / 2], [x - w / 2, y - 7 - h], [x - w / 2, y + 7], [x + 7, y - h - 3], [x - 7 - w, y - h - 3], [x + 7, y + 3], [x - 7 - w, y + 3]]) {
          const box = [left, top, left + w, top + h];
          if (left < frame.left || box[2] > frame.right || top < frame.top || box[3] > frame.bottom) continue;
          if (used.some((u) => box[0] < u[2] && u[0] < box[2] && box[1] < u[3] && u[1] < box[3])) continue;
          const on = (line) => line.filter(([px, py]) => px > box[0] && px < box[2] && py > box[1] && py < box[3]).length;
          const hidden = lines.reduce((sum, line, k) => sum + (k === own ? 1 : 2) * on(line), 0.1 * n);
          if (hidden < least) [best, least] = [box, hidden];
        }
      });
      if (best === null) return;
      used.push(best);
      svg("text", { class: "note-text", x: best[0], y: best[3] - 3 }, group, name);
    });
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
      const same = dot.curve.of === here.curve.of;
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
    const panel = plot.axes;
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
    const curves = made.panels.flatMap((panel) => panel.curves);
    for (const curve of [...curves.filter((c) => !c.muted), ...curves.filter((c) => c.muted)]) if (nameOf(curve) && (curve.label || curve.method) && !entries.has(nameOf(curve))) entries.set(nameOf(curve), curve);
    axisChoices(box, made);
    if (curves.some((curve) => curve.muted)) {
      const button = html("button", { type: "button", class: "key every", value: "colours", "aria-pressed": state.colours === "all" }, "all in colour");
      button.addEventListener("click", () => {
        state.colours = state.colours === "all" ? "best" : "all";
        drawAll();
        remember();
      });
      list.append(html("li", {}, button));
    }
    if (entries.size < 2) {
      list.append(html("li", {}, saver(box)));
      return;
    }
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
    list.append(html("li", {}, saver(box)));
  }
  function saver(box) {
    const save = html("button", { type: "button", class: "key every", value: "save" }, "save as SVG");
    save.addEventListener("click", () => saved(box));
    return save;
  }
  /** A choice for every axis of a figure that has more than one quantity; equal axes of all figures follow. */
  function axisChoices(box, made) {
    const axes = new Map(made.panels.flatMap((panel) => [panel.x, panel.y]).filter((axis) => axis.others).map((axis) => [axis.key, axis]));
    for (const axis of axes.values()) {
      const select = html("select", { "data-axis": axis.key, "aria-label": `instead of ${axis.label}` });
      for (const other of quantities(axis)) select.append(html("option", { value: other.key }, other.label));
      select.value = chosenAxis(axis).key;
      select.addEventListener("change", () => {
        if (select.value === axis.key) delete state.axes[axis.key];
        else state.axes[axis.key] = select.value;
        drawAll();
        remember();
      });
      box.querySelector(".axes").append(html("label", { class: "choice" }, made.panels.some((panel) => panel.x.key === axis.key) ? "x axis" : "y axis", select));
    }
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
    if (!state.ready) return;
    for (const figure of figures) figure.plots.forEach(draw);
    for (const select of all("select[data-axis]")) select.value = state.axes[select.dataset.axis] || select.dataset.axis;
    for (const button of all('.key[value="colours"]')) button.setAttribute("aria-pressed", state.colours === "all");
    for (const button of all(".key:not(.every)")) button.setAttribute("aria-pressed", !state.hidden.has(button.value));
  }

