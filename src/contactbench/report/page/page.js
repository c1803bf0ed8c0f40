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
        const link = links.get(entry.target.id);
        link?.setAttribute("aria-current", "true");
        if (link) link.closest("ul").scrollLeft = link.offsetLeft - link.closest("ul").clientWidth / 3;
      }
    },
    { rootMargin: "-20% 0px -75% 0px" },
  );
  for (const section of all("main > section")) watch.observe(section);

  let width = document.body.clientWidth;
  new ResizeObserver(() => {
    if (document.body.clientWidth === width) return;
    width = document.body.clientWidth;
    drawAll();
  }).observe(document.body);
  window.addEventListener("hashchange", () => {
    if (!location.hash.includes(";")) remember(); // a link to a section: what is shown stays in the address
  });
  recall();
  for (const restore of restorers) restore();
  figures.forEach(legend);
  const names = new Set(all("[data-choice]").map((group) => group.dataset.choice));
  for (const name of names) choose(name, state.chosen[name] ?? document.querySelector(`[data-choice="${name}"] select`).value);
  state.ready = true;
  drawAll();
