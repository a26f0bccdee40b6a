// The table: sorted by a column, filtered by a word, with its footnotes where the pointer or the focus is.
(() => {
  const { make } = Queries;
  const table = document.querySelector("#table table");
  if (!table) return;
  const NEXT = { name: ["ascending", "descending", "none"], number: ["descending", "ascending", "none"] };
  const heads = [...table.querySelectorAll("thead th[scope=col]")];
  const rows = [...table.tBodies].flatMap((body) => [...body.rows].map((row) => ({ row, body })));

  // A cell begins with its number; a row without one stays last.
  const number = (row, i) => parseFloat(row.cells[i]?.firstChild?.textContent.replace(/[~,]/g, ""));
  const name = (row) => row.cells[0].textContent;

  function compared(p, q, i, sign) {
    if (i === 0) return sign * name(p.row).localeCompare(name(q.row), "en", { numeric: true });
    const [x, y] = [number(p.row, i), number(q.row, i)];
    return Number.isNaN(x) - Number.isNaN(y) || sign * (x - y) || 0;
  }

  function sort(i) {
    const steps = i === 0 ? NEXT.name : NEXT.number;
    const next = steps[(steps.indexOf(heads[i].getAttribute("aria-sort")) + 1) % steps.length];
    heads.forEach((head, j) => head.setAttribute("aria-sort", i === j ? next : "none"));
    const sign = next === "ascending" ? 1 : -1;
    const sorted = next === "none" ? rows : [...rows].sort((p, q) => compared(p, q, i, sign));
    for (const { row, body } of sorted) (next === "none" ? body : table.tBodies[0]).append(row);
  }

  heads.forEach((head, i) => {
    const button = make("button", "sort", ...head.childNodes);
    button.type = "button";
    button.addEventListener("click", () => sort(i));
    head.append(button);
    head.setAttribute("aria-sort", "none");
  });

  const word = document.getElementById("word");
  word.addEventListener("input", () => {
    const wanted = word.value.trim().toLowerCase();
    for (const { row, body } of rows) row.hidden = !`${row.textContent} ${body.className}`.toLowerCase().includes(wanted);
    const left = rows.filter(({ row }) => !row.hidden).length;
    document.getElementById("rows").textContent = wanted ? `${left} of ${rows.length} rows` : "";
  });
  document.getElementById("table-controls").hidden = false;

  // Footnotes

  const EDGE = 8; // pixels to the border of the window
  const note = document.getElementById("footnote");

  let told = null; // the link whose footnote is shown

  function place() {
    if (!told) return;
    const mark = told.getBoundingClientRect();
    const below = mark.bottom + note.offsetHeight + EDGE < innerHeight;
    note.style.left = `${Math.max(EDGE, Math.min(mark.left, innerWidth - note.offsetWidth - EDGE))}px`;
    note.style.top = `${below ? mark.bottom : mark.top - note.offsetHeight}px`;
  }

  function tell(link) {
    told = link;
    note.textContent = document.getElementById(link.hash.slice(1)).textContent;
    note.showPopover();
    place();
  }

  function hide() {
    told = null;
    note.hidePopover();
  }

  for (const link of table.querySelectorAll("sup a")) {
    link.setAttribute("aria-describedby", link.hash.slice(1));
    link.addEventListener("mouseenter", () => tell(link));
    link.addEventListener("focus", () => tell(link));
    link.addEventListener("mouseleave", (event) => event.relatedTarget === note || hide());
    link.addEventListener("blur", hide);
    link.addEventListener("click", (event) => {
      if (event.pointerType !== "touch") return; // a mouse has read it already, and follows the link
      event.preventDefault();
      tell(link);
    });
  }
  note.addEventListener("mouseleave", hide);
  document.addEventListener("keydown", (event) => event.key === "Escape" && hide());
  document.addEventListener("scroll", place, { capture: true, passive: true });
})();
