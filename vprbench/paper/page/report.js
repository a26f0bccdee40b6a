// The browser of single queries: reads the answers of the stored runs from this page and shows ten at a time.
(() => {
  const PAGE = 10;
  const PAUSE = 250; // milliseconds after a choice before the address tells it: browsers refuse many changes at once
  const { KINDS, VERDICTS, counted, make, row, unfold } = Queries;
  const HEIGHTS = { r: 45, w: 100, t: 75, u: 15 }; // of the bars, so that they differ in grey too
  const FILTERS = [
    { id: "all", name: "all queries", keeps: () => true },
    { id: "wrong", name: "A wrong, ties included", keeps: (a) => "wt".includes(a) },
    { id: "right", name: "A right", keeps: (a) => a === "r" },
    { id: "tied", name: "A tied", keeps: (a) => a === "t" },
    { id: "unanswerable", name: "without a right place", keeps: (a) => a === "u" },
    { id: "a-not-b", pair: true, name: "A right, B wrong", keeps: (a, b) => a === "r" && "wt".includes(b) },
    { id: "b-not-a", pair: true, name: "A wrong, B right", keeps: (a, b) => "wt".includes(a) && b === "r" },
    { id: "neither", pair: true, name: "A and B wrong", keeps: (a, b) => "wt".includes(a) && "wt".includes(b) },
  ];

  const FIRST = FILTERS[1];

  const sections = JSON.parse(document.getElementById("answers").textContent);
  if (!sections.length) return;
  const element = (id) => document.getElementById(id);
  const choices = Object.fromEntries(
    ["method-a", "method-b", "kind", "order"].map((id) => [id, element(id)]),
  );
  const tabs = [...document.querySelectorAll("#datasets [role=tab]")];
  const list = element("queries");
  const along = element("along");
  const frames = sections.map(() => null); // parsed when a dataset is first looked at

  let section = sections[0];
  let a = section.runs[0];
  let b = null;
  let shown = []; // queries that pass the filter, in the order of the list
  let at = 0; // which of them is the current one
  let telling = null; // what will write the address
  const open = new Set(); // queries whose best places are unfolded

  function picture(kind, index) {
    const number = sections.indexOf(section);
    frames[number] ??= JSON.parse(element(`frames-${number}`).textContent);
    return frames[number][kind][index];
  }

  const view = () => ({ section, a, b, open, picture });

  // What is shown

  function chosenFilter() {
    return FILTERS.find(({ id }) => id === choices.kind.value) ?? FIRST;
  }

  function passing(filter) {
    const kept = [];
    if (filter.pair && !b) return kept;
    for (let query = 0; query < section.nQueries; query += 1) {
      if (filter.keeps(a.verdicts[query], b?.verdicts[query])) kept.push(query);
    }
    return kept;
  }

  function sortable(query) {
    const margin = a.margins[query];
    if (a.bounds[query] === "?") return NaN;
    return margin === "-" ? -Infinity : margin === "+" ? Infinity : margin;
  }

  function sorted(queries) {
    if (choices.order.value === "route") return queries;
    const sign = choices.order.value === "lowest" ? 1 : -1;
    const known = queries.filter((query) => !Number.isNaN(sortable(query)));
    const keys = new Map(known.map((query) => [query, sign * sortable(query)]));
    known.sort((p, q) => (keys.get(p) < keys.get(q) ? -1 : keys.get(p) > keys.get(q) ? 1 : p - q));
    return [...known, ...queries.filter((query) => !keys.has(query))];
  }

  function fill(select, options, chosen) {
    select.replaceChildren(
      ...options.map(({ value, text, disabled }) => {
        const option = make("option", "", text);
        option.value = value;
        option.disabled = Boolean(disabled);
        return option;
      }),
    );
    select.value = chosen;
  }

  // What is shown as the fragment of the address, in names, so that a link outlives the page it was copied from

  function told() {
    const chosen = { dataset: section.title, a: a.name, show: chosenFilter().id, sort: choices.order.value };
    if (b) chosen.b = b.name;
    if (shown.length) chosen.query = shown[at];
    return new URLSearchParams(chosen);
  }

  function tell() {
    clearTimeout(telling);
    telling = setTimeout(() => history.replaceState(null, "", `#${told()}`), PAUSE);
  }

  function follow() {
    if (!location.hash.includes("=")) return;
    show(new URLSearchParams(location.hash.slice(1)));
    clearTimeout(telling);
    if (shown.length) go(at, false);
  }

  function show(wanted) {
    const number = Math.max(0, sections.findIndex(({ title }) => title === wanted.get("dataset")));
    section = sections[number];
    tabs.forEach((tab, i) => {
      tab.setAttribute("aria-selected", String(i === number));
      tab.tabIndex = i === number ? 0 : -1;
    });
    document.querySelectorAll("#findings .found").forEach((found, i) => (found.hidden = i !== number));
    if (tabs.length) element("dataset").setAttribute("aria-labelledby", tabs[number].id);
    const remarks = { "frames-missing": section.framesMissing, "first-references": section.firstReferences };
    for (const [id, text] of Object.entries(remarks)) {
      element(id).hidden = !text;
      element(id).textContent = text;
    }
    const runs = section.runs.map(({ name }) => ({ value: name, text: name }));
    const named = (name, otherwise) => (section.runs.some((run) => run.name === name) ? name : otherwise);
    fill(choices["method-a"], runs, named(wanted.get("a"), runs[0].value));
    fill(choices["method-b"], [{ value: "", text: "nothing" }, ...runs], named(wanted.get("b"), ""));
    const orders = [...choices.order.options].map(({ value }) => value);
    choices.order.value = orders.includes(wanted.get("sort")) ? wanted.get("sort") : orders[0];
    chooseRuns(wanted.get("show"), Number(wanted.get("query") ?? -1));
  }

  function chooseRuns(kind, query) {
    const named = (name) => section.runs.find((run) => run.name === name) ?? null;
    a = named(choices["method-a"].value);
    b = named(choices["method-b"].value);
    const before = FILTERS.find(({ id }) => id === kind) ?? FIRST;
    const kept = before.pair && !b ? FIRST : before;
    const options = FILTERS.map((filter) => ({
      value: filter.id,
      text: filter.pair && !b ? `${filter.name} (choose B)` : `${filter.name} (${counted(passing(filter).length)})`,
      disabled: filter.pair && !b,
    }));
    fill(choices.kind, options, kept.id);
    refresh(query);
  }

  function refresh(query = -1) {
    open.clear();
    shown = sorted(passing(chosenFilter()));
    at = Math.max(0, shown.indexOf(query));
    drawLanes();
    drawPage();
  }

  function drawPage() {
    const first = at - (at % PAGE);
    const rows = shown.slice(first, first + PAGE).map((query) => row(view(), query));
    list.replaceChildren(...rows);
    list.start = first + 1;
    const last = Math.min(first + PAGE, shown.length);
    const kind = chosenFilter().name;
    element("status").textContent = shown.length
      ? `${counted(first + 1)} to ${counted(last)} of ${counted(shown.length)}: ${kind}`
      : `No query is left: ${kind}. Choose something else to show.`;
    element("page-number").textContent = shown.length
      ? `Page ${counted(first / PAGE + 1)} of ${counted(Math.ceil(shown.length / PAGE))}`
      : "";
    // A button that is disabled in earnest would lose the focus of the keyboard.
    element("previous-page").setAttribute("aria-disabled", String(first === 0));
    element("next-page").setAttribute("aria-disabled", String(last >= shown.length));
    mark();
  }

  function mark() {
    tell();
    for (const made of list.children) {
      const current = Number(made.dataset.query) === shown[at];
      made.classList.toggle("current", current);
      made.querySelector("button").tabIndex = current ? 0 : -1;
      if (current) made.setAttribute("aria-current", "true");
      else made.removeAttribute("aria-current");
    }
    const x = shown.length ? shown[at] + 0.5 : -1;
    document.querySelectorAll("#lanes .here").forEach((line) => line.setAttribute("d", `M${x} 0V100`));
    along.disabled = !shown.length;
    if (shown.length) {
      along.value = shown[at];
      along.setAttribute("aria-valuetext", `query ${shown[at]}: ${VERDICTS[a.verdicts[shown[at]]]}`);
    }
  }

  function go(position, focused = true) {
    if (!shown.length) return;
    const before = Math.floor(at / PAGE);
    at = Math.min(Math.max(position, 0), shown.length - 1);
    if (Math.floor(at / PAGE) === before) mark();
    else drawPage();
    const made = element(`query-${shown[at]}`);
    if (focused) made.focus({ preventScroll: true });
    made.closest("li").scrollIntoView({ block: "nearest" });
  }

  function turn(queries) {
    const first = at - (at % PAGE) + queries;
    if (first >= 0 && first < shown.length) go(first, false);
  }

  // The strip

  function drawn(tag, attributes) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    return made;
  }

  function bars(className, wanted, height) {
    let path = "";
    for (let query = 0; query < section.nQueries; query += 1) {
      if (!wanted(query)) continue;
      const first = query;
      while (query + 1 < section.nQueries && wanted(query + 1)) query += 1;
      path += `M${first} 100h${query - first + 1}v-${height}H${first}z`;
    }
    return drawn("path", { class: `bars ${className}`, d: path });
  }

  function lane(className, name, paths) {
    const svg = drawn("svg", {
      viewBox: `0 0 ${section.nQueries} 100`,
      preserveAspectRatio: "none",
      "aria-hidden": "true",
    });
    svg.append(...paths, drawn("path", { class: "here", d: "" }));
    svg.addEventListener("click", (event) => {
      const box = svg.getBoundingClientRect();
      const wanted = Math.floor(((event.clientX - box.left) / box.width) * section.nQueries);
      go(nearest(wanted));
    });
    return make("div", `lane ${className}`, make("div", "lane-name", name), svg);
  }

  function drawLanes() {
    const lanes = [["A", a], ...(b ? [["B", b]] : [])].map(([letter, run]) => {
      const counts = Object.keys(KINDS).map((kind) => [run.verdicts.split(kind).length - 1, VERDICTS[kind]]);
      const told = counts.filter(([count]) => count).map(([count, verdict]) => `${counted(count)} ${verdict}`);
      const paths = Object.keys(KINDS).map((kind) =>
        bars(KINDS[kind], (query) => run.verdicts[query] === kind, HEIGHTS[kind]),
      );
      return lane("", `${letter}, ${run.name}: ${told.join(", ")}`, paths);
    });
    const kept = new Set(shown);
    lanes.push(lane("shown", "Shown below", [bars("shown", (query) => kept.has(query), 100)]));
    element("lanes").replaceChildren(...lanes);
    along.max = section.nQueries - 1;
  }

  function nearest(query, among = shown) {
    const apart = (other) => Math.abs(other - query);
    return shown.indexOf(among.reduce((best, other) => (apart(other) < apart(best) ? other : best), among[0]));
  }

  function slide() {
    const wanted = Number(along.value);
    const ahead = shown.filter((query) => (query - shown[at]) * (wanted - shown[at]) > 0);
    go(ahead.length ? nearest(wanted, ahead) : at, false);
  }

  // What a reader does

  const steps = {
    ArrowDown: () => at + 1,
    ArrowRight: () => at + 1,
    ArrowUp: () => at - 1,
    ArrowLeft: () => at - 1,
    Home: () => 0,
    End: () => shown.length - 1,
  };
  list.addEventListener("keydown", (event) => {
    if (event.altKey || event.ctrlKey || event.metaKey || !(event.key in steps)) return;
    event.preventDefault();
    go(steps[event.key]());
  });
  list.addEventListener("click", (event) => {
    const made = event.target.closest("li.query");
    if (!made) return;
    const query = Number(made.dataset.query);
    if (event.target.closest("button")) {
      if (!open.delete(query)) open.add(query);
      unfold(view(), made, query);
    }
    at = shown.indexOf(query);
    mark();
  });
  element("previous-page").addEventListener("click", () => turn(-PAGE));
  element("next-page").addEventListener("click", () => turn(PAGE));
  element("controls").addEventListener("submit", (event) => event.preventDefault());
  along.addEventListener("input", slide);
  choices["method-a"].addEventListener("change", () => chooseRuns(choices.kind.value));
  choices["method-b"].addEventListener("change", () => chooseRuns(choices.kind.value));
  choices.kind.addEventListener("change", () => refresh());
  choices.order.addEventListener("change", () => refresh());
  window.addEventListener("hashchange", follow);

  function turnTo(number) {
    const wanted = told();
    wanted.set("dataset", sections[number].title);
    wanted.delete("query");
    show(wanted);
    tabs[number].focus();
  }

  const tabSteps = {
    ArrowRight: (i) => (i + 1) % tabs.length,
    ArrowLeft: (i) => (i + tabs.length - 1) % tabs.length,
    Home: () => 0,
    End: () => tabs.length - 1,
  };
  tabs.forEach((tab, i) => {
    tab.addEventListener("click", () => turnTo(i));
    tab.addEventListener("keydown", (event) => {
      if (event.altKey || event.ctrlKey || event.metaKey || !(event.key in tabSteps)) return;
      event.preventDefault();
      turnTo(tabSteps[event.key](i));
    });
  });

  if (tabs.length) {
    element("datasets").hidden = false;
    element("dataset").setAttribute("role", "tabpanel");
  }
  element("browsing").hidden = false;
  show(new URLSearchParams());
  clearTimeout(telling);
  follow();
})();
