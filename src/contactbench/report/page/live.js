  // -- the live plot: logarithmic axes, error falling to the right, ranges of what is shown ------------------
  function svg(name, attributes, parent, text = "") {
    const node = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.textContent = text;
    parent?.append(node);
    return node;
  }
  const power = (k) => (k === 0 ? "1" : k === 1 ? "10" : "10" + String(k).replace(/[-0-9]/g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]));
  const [LEFT, RIGHT, TOP, BOTTOM, HEIGHT] = [52, 12, 8, 40, 400];

  function livePlot(box, { panels, looks }) {
    const [scene, cost] = all("select", box);
    const [plot, keys] = [box.querySelector(".plot"), box.querySelector(".keys")];
    const hidden = new Set();
    const family = (curve) => looks[curve.name].family;
    const curvesHere = () => panels[scene.value][cost.value].curves;
    let dots = [];
    let cursor = -1;

    function fill(select, words) {
      const before = select.value;
      select.replaceChildren(...words.map((word) => html("option", {}, word)));
      if (words.includes(before)) select.value = before;
    }
    /** The decades of some values, and a little more. */
    function range(values) {
      const [low, high] = [Math.log10(Math.min(...values)), Math.log10(Math.max(...values))];
      const room = 0.1 + 0.03 * (high - low);
      return values.length ? [low - room, high + room] : [-1, 0];
    }
    function ticks([low, high], most) {
      const stride = Math.ceil((high - low) / most);
      return Array.from({ length: Math.floor(high / stride) - Math.ceil(low / stride) + 1 }, (_, i) => stride * (Math.ceil(low / stride) + i));
    }
    function marker(name, parent, place = "") {
      const { outline, filled, color } = looks[name];
      svg("path", { class: "dot", d: outline, transform: place, style: `--c: ${color}`, fill: filled ? color : "#fff" }, parent);
    }
    function draw() {
      const { x, y, ends } = panels[scene.value][cost.value];
      const curves = curvesHere().filter((curve) => !hidden.has(family(curve)));
      const few = new Set(curves.map(family)).size < 3; // then all their methods are in colour
      const points = curves.flatMap((curve) => curve.points).filter(([error, spent]) => error >= ends[0] && error <= ends[1] && spent <= (ends[2] ?? Infinity));
      const [xs, ys] = [0, 1].map((i) => range(points.map((point) => point[i])));
      const [right, bottom] = [plot.clientWidth - RIGHT, HEIGHT - BOTTOM];
      const X = (decade) => LEFT + ((xs[1] - decade) / (xs[1] - xs[0])) * (right - LEFT);
      const Y = (decade) => bottom - ((decade - ys[0]) / (ys[1] - ys[0])) * (bottom - TOP);
      const root = svg("svg", { width: plot.clientWidth, height: HEIGHT, tabindex: 0, role: "img", "aria-label": `${scene.value}, ${cost.value}: ${curves.length} methods` });
      svg("rect", { x: LEFT, y: TOP, width: right - LEFT, height: bottom - TOP }, svg("clipPath", { id: "inside" }, root));
      for (const k of ticks(xs, plot.clientWidth / 60)) {
        svg("path", { class: "grid", d: `M${X(k)} ${TOP}V${bottom}` }, root);
        svg("text", { x: X(k), y: bottom + 16, "text-anchor": "middle" }, root, power(k));
      }
      for (const k of ticks(ys, HEIGHT / 30)) {
        svg("path", { class: "grid", d: `M${LEFT} ${Y(k)}H${right}` }, root);
        svg("text", { x: LEFT - 6, y: Y(k) + 4, "text-anchor": "end" }, root, power(k));
      }
      svg("text", { x: (LEFT + right) / 2, y: HEIGHT - 6, "text-anchor": "middle" }, root, x);
      svg("text", { transform: `translate(13 ${(TOP + bottom) / 2}) rotate(-90)`, "text-anchor": "middle" }, root, y);
      dots = [];
      for (const curve of curves) {
        const muted = curve.muted && !few;
        const { color, dash } = looks[curve.name];
        const group = svg("g", { class: muted ? "line muted" : "line", "data-name": curve.name, style: `--c: ${color}`, "clip-path": "url(#inside)" }, root);
        const places = curve.points.map((point) => [X(Math.log10(point[0])), Y(Math.log10(point[1])), curve.name, point]);
        svg("path", { class: "curve", d: `M${places.map(([px, py]) => `${px.toFixed(1)} ${py.toFixed(1)}`).join("L")}`, "stroke-dasharray": muted ? "none" : dash }, group);
        for (const place of places) {
          const [px, py] = place;
          if (px < LEFT || px > right || py < TOP || py > bottom) continue;
          dots.push(place);
          if (!muted) marker(curve.name, group, `translate(${px.toFixed(1)} ${py.toFixed(1)}) scale(.08)`);
        }
      }
      plot.replaceChildren(root);
      root.addEventListener("pointermove", (event) => {
        const area = plot.getBoundingClientRect();
        const far = ([px, py]) => Math.hypot(px - event.clientX + area.left, py - event.clientY + area.top);
        show(dots.reduce((best, dot, i) => (far(dot) < (best < 0 ? 26 : far(dots[best])) ? i : best), -1));
      });
      root.addEventListener("pointerleave", () => show(-1));
      root.addEventListener("keydown", (event) => {
        const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
        if (step && dots.length) show((cursor + step + dots.length) % dots.length);
      });
    }
    /** Point out one point and its curve; none for −1. */
    function show(index) {
      cursor = index;
      plot.querySelector(".tip")?.remove();
      const [px, py, name, [error, spent, setting] = []] = dots[index] ?? [];
      for (const line of all(".line", plot)) line.classList.toggle("faint", Boolean(name) && line.dataset.name !== name);
      if (!name) return;
      const words = [setting, `error ${error}`, `${panels[scene.value][cost.value].y} ${spent}`];
      const tip = html("div", { class: "tip", role: "status" }, html("b", {}, name), ...words.flatMap((word) => [html("br"), word]));
      plot.append(tip);
      tip.style.left = `${Math.max(0, Math.min(px + 12, plot.clientWidth - tip.offsetWidth))}px`;
      tip.style.top = `${Math.max(0, Math.min(py + 12, HEIGHT - tip.offsetHeight))}px`;
    }
    /** A button for each family, with its methods that are in colour. */
    function drawKeys() {
      const families = [...new Set(curvesHere().map(family))].sort();
      keys.replaceChildren(...families.map((name) => {
        const own = curvesHere().filter((curve) => family(curve) === name && !curve.muted);
        const button = html("button", { type: "button", value: name, "aria-pressed": !hidden.has(name) }, name);
        for (const curve of own) {
          marker(curve.name, svg("svg", { viewBox: "-60 -60 120 120" }, button));
          button.append(curve.name);
        }
        button.addEventListener("click", () => {
          if (!hidden.delete(name)) hidden.add(name);
          redraw();
        });
        return button;
      }));
    }
    function redraw() {
      fill(cost, Object.keys(panels[scene.value]));
      drawKeys();
      draw();
    }
    fill(scene, Object.keys(panels));
    for (const select of [scene, cost]) select.addEventListener("change", redraw);
    new ResizeObserver(draw).observe(plot);
    redraw();
  }
  if (data.live) livePlot(document.getElementById("live"), data.live);
