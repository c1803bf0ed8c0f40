  // -- the live plot: logarithmic axes, error falling to the right ------------------------------------------
  const SVG = "http://www.w3.org/2000/svg";
  function svg(name, attributes, parent, text = "") {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.textContent = text;
    parent?.append(node);
    return node;
  }
  const superscript = (n) => String(n).replace(/[-0-9]/g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]);
  const power = (k) => (k === 0 ? "1" : k === 1 ? "10" : "10" + superscript(k));
  const number = (thousandths) => Number((10 ** (thousandths / 1000)).toPrecision(3)).toString();
  const PAD = { left: 56, right: 12, top: 8, bottom: 42 };
  const HEIGHT = 400;

  function livePlot(box) {
    const { panels, styles, settings } = data.live;
    const [first, second] = all("select", box);
    const plot = box.querySelector(".plot");
    const colours = box.querySelector("figcaption button");
    const hidden = new Set();
    let dots = [];
    let cursor = -1;

    const panel = () => panels[first.value][second.value];
    function fill(select, words) {
      const before = select.value;
      select.replaceChildren(...words.map((word) => html("option", {}, word)));
      if (words.includes(before)) select.value = before;
    }
    /** The least and greatest of what is shown, and a little more. */
    function range(curves, name, [low, high]) {
      const values = curves.flatMap((curve) => curve[name].filter((v, i) => v !== null && v >= low && v <= high && curve[name === "x" ? "y" : "x"][i] !== null));
      const [a, b] = [Math.min(...values), Math.max(...values)];
      return values.length ? [a - 100 - 0.03 * (b - a), b + 100 + 0.03 * (b - a)] : [-1000, 0];
    }
    function ticks([low, high], room) {
      const stride = Math.max(1, Math.ceil((high - low) / 1000 / room));
      const found = [];
      for (let k = Math.ceil(low / 1000); k <= high / 1000; k++) if (k % stride === 0) found.push(k);
      return found;
    }

    function draw() {
      const { title, x, y, ends } = panel();
      const curves = panel().curves.filter((curve) => !hidden.has(curve.name));
      const xs = range(curves, "x", [ends[0] ?? -Infinity, 300]);
      const inside = curves.map((c) => ({ ...c, y: c.y.map((v, i) => (c.x[i] !== null && c.x[i] >= xs[0] && c.x[i] <= xs[1] ? v : null)) }));
      const ys = range(inside, "y", [-Infinity, ends[1] ?? Infinity]);
      const width = plot.clientWidth;
      if (!width) return;
      const [right, bottom] = [width - PAD.right, HEIGHT - PAD.bottom];
      const X = (v) => PAD.left + ((xs[1] - v) / (xs[1] - xs[0])) * (right - PAD.left);
      const Y = (v) => bottom - ((v - ys[0]) / (ys[1] - ys[0])) * (bottom - PAD.top);
      const root = svg("svg", { viewBox: `0 0 ${width} ${HEIGHT}`, width, height: HEIGHT, tabindex: 0, role: "img", "aria-label": `${title}, ${curves.length} curves` });
      svg("rect", { x: PAD.left, y: PAD.top, width: right - PAD.left, height: bottom - PAD.top }, svg("clipPath", { id: "inside" }, root));
      for (const k of ticks(xs, width / 60)) {
        svg("line", { class: "grid", x1: X(1000 * k), x2: X(1000 * k), y1: PAD.top, y2: bottom }, root);
        svg("text", { x: X(1000 * k), y: bottom + 16, "text-anchor": "middle" }, root, power(k));
      }
      for (const k of ticks(ys, HEIGHT / 30)) {
        svg("line", { class: "grid", x1: PAD.left, x2: right, y1: Y(1000 * k), y2: Y(1000 * k) }, root);
        svg("text", { x: PAD.left - 6, y: Y(1000 * k) + 4, "text-anchor": "end" }, root, power(k));
      }
      svg("text", { x: (PAD.left + right) / 2, y: HEIGHT - 8, "text-anchor": "middle" }, root, x);
      svg("text", { transform: `translate(13 ${(PAD.top + bottom) / 2}) rotate(-90)`, "text-anchor": "middle" }, root, y);
      dots = [];
      for (const curve of curves) {
        const look = styles[curve.name];
        const grey = curve.muted && colours.ariaPressed !== "true";
        const group = svg("g", { class: grey ? "line muted" : "line", "data-name": curve.name, style: `--c: ${look.color}`, "clip-path": "url(#inside)" }, root);
        const points = curve.x.map((v, i) => (v === null || curve.y[i] === null ? null : { px: X(v), py: Y(curve.y[i]), curve, i }));
        const path = points.map((p, i) => p && `${points[i - 1] ? "L" : "M"}${p.px.toFixed(1)} ${p.py.toFixed(1)}`);
        svg("path", { class: "curve", d: path.filter(Boolean).join(""), "stroke-dasharray": grey ? "none" : look.dash || "none" }, group);
        for (const p of points) {
          if (!p || p.px < PAD.left || p.px > right || p.py < PAD.top || p.py > bottom) continue;
          dots.push(p);
          if (!grey) svg("path", { class: look.hollow ? "dot hollow" : "dot", d: look.marker, transform: `translate(${p.px.toFixed(1)} ${p.py.toFixed(1)}) scale(7)` }, group);
        }
      }
      plot.replaceChildren(root);
      cursor = -1;
      root.addEventListener("pointermove", (event) => {
        const area = plot.getBoundingClientRect();
        const far = (p) => Math.hypot(p.px - event.clientX + area.left, p.py - event.clientY + area.top);
        const nearest = dots.reduce((best, p, i) => (far(p) < (best < 0 ? 26 : far(dots[best])) ? i : best), -1);
        show(nearest);
      });
      root.addEventListener("pointerleave", () => show(-1));
      root.addEventListener("keydown", (event) => {
        const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
        if (step && dots.length) show((cursor + step + dots.length) % dots.length);
        if (event.key === "Escape") show(-1);
      });
    }
    /** Point out one point and its curve; none for −1. */
    function show(index) {
      cursor = index;
      plot.querySelector(".tip")?.remove();
      const dot = dots[index];
      light(dot?.curve.name);
      if (!dot) return;
      const { curve, i } = dot;
      const words = [settings[curve.at[i]], `error ${number(curve.x[i])}`, `${panel().y} ${number(curve.y[i])}`];
      const tip = html("div", { class: "tip", role: "status" }, html("b", {}, curve.name), ...words.flatMap((word) => [html("br"), word ?? ""]));
      plot.append(tip);
      tip.style.left = `${Math.max(0, Math.min(dot.px + 12, plot.clientWidth - tip.offsetWidth))}px`;
      tip.style.top = `${Math.max(0, Math.min(dot.py + 12, HEIGHT - tip.offsetHeight))}px`;
    }
    function light(name) {
      for (const line of all(".line", plot)) line.classList.toggle("faint", Boolean(name) && line.dataset.name !== name);
    }
    function keys() {
      const curves = [...panel().curves].sort((a, b) => a.muted - b.muted);
      box.querySelector(".keys").replaceChildren(...curves.map(({ name }) => {
        const glyph = svg("svg", { viewBox: "-.6 -.6 1.2 1.2", style: `--c: ${styles[name].color}` });
        svg("path", { class: styles[name].hollow ? "dot hollow" : "dot", d: styles[name].marker }, glyph);
        const button = html("button", { type: "button", class: "key", value: name, "aria-pressed": !hidden.has(name) }, glyph, name);
        button.addEventListener("click", () => {
          if (!hidden.delete(name)) hidden.add(name);
          button.ariaPressed = String(!hidden.has(name));
          draw();
        });
        button.addEventListener("pointerenter", () => light(name));
        button.addEventListener("pointerleave", () => light());
        return button;
      }));
    }
    function redraw() {
      fill(second, Object.keys(panels[first.value]));
      keys();
      draw();
    }
    fill(first, Object.keys(panels));
    for (const select of [first, second]) select.addEventListener("change", redraw);
    colours.addEventListener("click", () => {
      colours.ariaPressed = String(colours.ariaPressed !== "true");
      draw();
    });
    let width = 0;
    new ResizeObserver(() => {
      if (plot.clientWidth === width) return;
      width = plot.clientWidth;
      draw();
    }).observe(plot);
    redraw();
  }
  if (data.live) livePlot(document.getElementById("live"));
