// Sorts and filters tables, and opens what is folded where a link leads into it.
"use strict";
(() => {
  const LONG = 12; // rows from which on a table can be filtered
  const PREFIX = { n: 1e-9, µ: 1e-6, m: 1e-3, k: 1e3 };
  const NUMBER = /^[<>≤≥✓!✗◆\s]*([-+−]?[\d,]*\.?\d+(?:e[-+]?\d+)?)(?:\s*±\s*[\d.e+-]+)?\s*(?:(n|µ|m|k)(?=m\b|rad|N|s\b|V))?/;

  // A cell's number in the unit without prefix, so that 1.2 mm comes after 30 µm; else its words.
  const key = (row, k) => {
    const text = row.cells[k]?.textContent.trim() ?? "";
    const found = text.match(NUMBER);
    return found ? +found[1].replaceAll(",", "").replace("−", "-") * (PREFIX[found[2]] ?? 1) : text;
  };
  const rank = (value) => (typeof value === "number" ? 0 : value === "–" || value === "" ? 2 : 1);
  const order = (a, b) => rank(a) - rank(b) || (rank(a) === 0 ? a - b : `${a}`.localeCompare(b));

  const sort = (head) => {
    const down = head.ariaSort === "ascending";
    const body = head.closest("table").tBodies[0];
    for (const other of head.parentElement.cells) if (other.ariaSort) other.ariaSort = "none";
    head.ariaSort = down ? "descending" : "ascending";
    const rows = [...body.rows].map((row) => [key(row, head.cellIndex), row]);
    rows.sort(([a], [b]) => (rank(a) === 2 || rank(b) === 2 ? rank(a) - rank(b) : (down ? -1 : 1) * order(a, b)));
    body.append(...rows.map(([, row]) => row));
  };

  const filter = (field) => {
    const words = field.value.toLowerCase().split(/\s+/);
    for (const row of field.closest(".listing").querySelectorAll("tbody tr"))
      row.classList.toggle("filtered", !words.every((word) => row.textContent.toLowerCase().includes(word)));
  };

  for (const table of document.querySelectorAll("table")) {
    for (const head of table.tHead.querySelectorAll("th")) {
      head.ariaSort = "none";
      if (!head.querySelector("a")) head.tabIndex = 0; // the link of an explained head is its stop
    }
    if (table.tBodies[0].rows.length <= LONG) continue;
    const label = `Filter rows: ${table.ariaLabel}`;
    table.parentElement.before(Object.assign(document.createElement("input"), { type: "search", className: "filter", placeholder: "Filter rows", ariaLabel: label }));
  }
  const openAll = () => {
    for (const folded of document.querySelectorAll("details")) folded.open = true;
  };
  document.addEventListener("input", ({ target }) => target.matches(".filter") && filter(target));
  document.addEventListener("click", ({ target }) => {
    if (target.closest("thead th") && !target.closest(".tip")) sort(target.closest("th"));
    if (target.matches(".open-all")) openAll();
  });
  document.addEventListener("keydown", (event) => {
    if (!event.target.matches("thead th, thead a.defined") || !["Enter", " "].includes(event.key)) return;
    event.preventDefault();
    sort(event.target.closest("th"));
  });

  const reveal = () => {
    if (location.hash === "#everything") openAll(); // for `truing report --pdf --appendix`
    const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (let at = target; at; at = at.parentElement) if (at.matches("details")) at.open = true;
    const own = target.querySelector(":scope > details.appendix");
    if (own) own.open = true;
    target.scrollIntoView();
  };
  window.addEventListener("hashchange", reveal);
  reveal();
})();
