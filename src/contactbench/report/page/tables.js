  const data = JSON.parse(document.getElementById("data").textContent);
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];
  function html(name, attributes = {}, ...children) {
    const node = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  }
  /** An element of text that is HTML already, escaped when the page was made. */
  function marked(name, attributes, text) {
    const node = html(name, attributes);
    node.innerHTML = text;
    return node;
  }

  // -- tables: drawn when they are opened ------------------------------------------------------------------
  function headRows(heads) {
    const rows = [html("tr", { class: "heads" })];
    if (heads.some(([, , group]) => group)) {
      const groups = html("tr");
      for (let i = 0; i < heads.length; ) {
        let n = 1;
        while (i + n < heads.length && heads[i + n][2] === heads[i][2]) n++;
        groups.append(html("th", { colspan: n }, heads[i][2]));
        i += n;
      }
      rows.unshift(groups);
    }
    for (const [label, words] of heads) rows.at(-1).append(marked("th", { scope: "col", tabindex: 0, class: words ? "words" : "" }, label));
    return rows;
  }
  function entry(cell, words) {
    const [text, , mark = "", link = ""] = Array.isArray(cell) ? cell : [cell];
    const node = marked("td", { class: [words ? "words" : "", mark].join(" ").trim() }, link ? "" : text);
    if (link) node.append(marked("a", { href: link }, text));
    return node;
  }
  /** What a cell is sorted by: a number, or words; null for blanks, which are last either way. */
  function key(cell) {
    const [text, value = null] = Array.isArray(cell) ? cell : [cell];
    if (value !== null) return value;
    return text === "" || text === "—" ? null : Number.isNaN(Number(text)) ? text : Number(text);
  }
  function compare(a, b, sign) {
    if (a === null || b === null) return (a === null) - (b === null);
    if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
    return sign * (typeof a === "number" ? a - b : a.localeCompare(b, "en", { numeric: true }));
  }
  function drawTable(details) {
    const view = data[details.dataset.view];
    if (!view || details.querySelector("table")) return;
    const words = view.heads.map((head) => head[1]);
    const rows = view.rows.map((cells) => ({ cells, node: html("tr", {}, ...cells.map((cell, i) => entry(cell, words[i]))) }));
    const head = html("thead", {}, ...headRows(view.heads));
    const body = html("tbody", {}, ...rows.map((row) => row.node));
    const labels = all(".heads th", head);
    labels.forEach((label, column) => {
      const sort = () => {
        const way = label.getAttribute("aria-sort") === "ascending" ? "descending" : "ascending";
        for (const other of labels) other.removeAttribute("aria-sort");
        label.setAttribute("aria-sort", way);
        const keyed = rows.map((row) => [key(row.cells[column]), row.node]);
        keyed.sort((a, b) => compare(a[0], b[0], way === "ascending" ? 1 : -1));
        body.append(...keyed.map(([, node]) => node));
      };
      label.addEventListener("click", sort);
      label.addEventListener("keydown", (event) => event.key === "Enter" && sort());
    });
    if (view.legend) details.append(marked("p", { class: "hint" }, view.legend));
    if (rows.length > 14) {
      const field = html("input", { type: "search", placeholder: "words a row must have", "aria-label": `filter ${view.title}` });
      field.addEventListener("input", () => {
        const wanted = field.value.toLowerCase().split(/\s+/).filter(Boolean);
        for (const { node } of rows) node.hidden = !wanted.every((word) => node.textContent.toLowerCase().includes(word));
      });
      details.append(field);
    }
    details.append(html("div", { class: "box", tabindex: 0 }, html("table", {}, head, body)));
    if (view.source) details.append(html("p", { class: "hint" }, "from ", html("a", { href: view.source }, view.source)));
  }
  for (const details of all("details.view")) {
    details.addEventListener("toggle", () => drawTable(details));
    if (details.open) drawTable(details);
  }

