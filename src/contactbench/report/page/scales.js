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

  /** The range of an axis: its limits, or what is drawn and a little more, ended where `within` says if any is left then. */
  function range(axis, values) {
    const [bottom, top] = [axis.within?.[0] ?? -Infinity, axis.within?.[1] ?? Infinity];
    const known = axis.log ? values.filter((v) => v > 0) : values;
    const inside = known.filter((v) => v >= bottom && v <= top);
    const size = axis.log ? Math.log10 : (v) => v;
    const use = (inside.length ? inside : known).map(size);
    let low = use.reduce((a, b) => Math.min(a, b), Infinity);
    let high = use.reduce((a, b) => Math.max(a, b), -Infinity);
    if (!(low <= high)) [low, high] = [0, 1];
    const pad = Math.max(axis.log ? 0.1 : 1e-12 * Math.abs(high), 0.04 * (high - low)) || 0.5;
    [low, high] = [low - pad, high + pad];
    if (inside.length && known.some((v) => v > top)) high = size(top);
    if (inside.length && known.some((v) => v < bottom)) low = size(bottom);
    const limit = (axis.limits || [null, null]).map((v) => (v === null ? v : size(v)));
    const [a, b] = [limit[0] ?? low, limit[1] ?? high];
    return a <= b ? [a, b] : [b, a];
  }
  const reaches = (axis, v) => v !== null && v >= (axis.within?.[0] ?? -Infinity) && v <= (axis.within?.[1] ?? Infinity);

  // -- axes: the quantity of each may be chosen where the tables have others ----------------------------------
  const quantities = (axis) => [axis, ...(axis.others || [])];
  const chosenAxis = (axis) => quantities(axis).find((other) => other.key === state.axes[axis.key]) || axis;
  /** Values of a curve on an axis as it is now; null where there are none. */
  const values = (curve, name, axis) => {
    const now = chosenAxis(axis);
    return now === axis ? curve[name] : (curve.also || {})[now.key] || curve[name].map(() => null);
  };

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

