  const data = JSON.parse(document.getElementById("data").textContent);
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];
  const SVG = "http://www.w3.org/2000/svg";

  function svg(name, attributes = {}, parent = null, text = null) {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (Array.isArray(text)) {
      let level = 0; // superscripts and subscripts, from mathtext
      for (const [word, now] of text) {
        const part = document.createElementNS(SVG, "tspan");
        part.setAttribute("dy", `${(level - now) * 0.4}em`);
        if (now) part.setAttribute("font-size", "75%");
        part.textContent = word;
        node.append(part);
        level = now;
      }
    } else if (text !== null) node.textContent = text;
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
  const state = { hidden: new Set(), chosen: {}, axes: {}, filters: {}, sorted: {}, colours: "best", single: null };
  function remember() {
    const parts = Object.entries(state.chosen).map(([name, value]) => `${name}=${encodeURIComponent(value)}`);
    const entries = { axis: state.axes, filter: state.filters, sort: state.sorted };
    for (const [kind, some] of Object.entries(entries)) {
      for (const [name, value] of Object.entries(some)) parts.push(`${kind}.${name}=${encodeURIComponent(value)}`);
    }
    if (state.colours === "all") parts.push("colours=all");
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
      else if (name === "colours") state.colours = value;
      else if (/^(axis|filter|sort)\./.test(name)) {
        const [kind, own] = [name.split(".")[0], name.slice(name.indexOf(".") + 1)];
        ({ axis: state.axes, filter: state.filters, sort: state.sorted })[kind][own] = decodeURIComponent(value);
      } else state.chosen[name] = decodeURIComponent(value);
    }
    if (parts.length && section) document.getElementById(section)?.scrollIntoView();
  }

  const restorers = []; // what puts a table into the state of the address
  const openAround = (table) => table.closest("details")?.setAttribute("open", "");

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
    restorers.push(() => {
      const [column, way] = (state.sorted[table.closest("[data-view]")?.dataset.view] || "").split(",");
      if (!way || !heads[column]) return;
      heads[column].setAttribute("aria-sort", way === "up" ? "ascending" : "descending");
      sortBy(table, Number(column), way === "up");
      openAround(table);
    });
    heads.forEach((head, column) => {
      head.querySelector("button").addEventListener("click", () => {
        const ascending = head.getAttribute("aria-sort") !== "ascending";
        for (const other of heads) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", ascending ? "ascending" : "descending");
        sortBy(table, column, ascending);
        const view = table.closest("[data-view]")?.dataset.view;
        if (view) state.sorted[view] = `${column},${ascending ? "up" : "down"}`;
        remember();
      });
    });
  }
  for (const field of all("input.filter")) {
    const table = field.closest("label").nextElementSibling.querySelector("table");
    const view = table.closest("[data-view]").dataset.view;
    const filter = () => {
      const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
      for (const row of table.tBodies[0].rows) {
        const text = row.textContent.toLowerCase();
        row.hidden = !words.every((word) => text.includes(word));
      }
    };
    field.addEventListener("input", () => {
      filter();
      if (field.value) state.filters[view] = field.value;
      else delete state.filters[view];
      remember();
    });
    restorers.push(() => {
      if (!state.filters[view]) return;
      field.value = state.filters[view];
      filter();
      openAround(table);
    });
  }

  // -- alternatives: one choice of a name for the whole page ----------------------------------------------
  function choose(name, value) {
    state.chosen[name] = value;
    for (const group of all(`[data-choice="${name}"]`)) {
      const options = [...group.children].filter((child) => child.dataset.option !== undefined);
      // one that does not have it stays as it is
      const wanted = options.some((option) => option.dataset.option === value) ? value : group.querySelector("select").value;
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

