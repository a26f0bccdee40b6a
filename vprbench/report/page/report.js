"use strict";
// One query as words and elements: its verdict, its frames and its best places, by one method or by two.
// A `view` holds `section`, its runs `a` and `b` (null: none), `open` queries and `picture(kind, i)`.
const Queries = (() => {
  const KINDS = { r: "right", w: "wrong", t: "tied", u: "unanswerable" }; // without a ground truth all are "n"
  const VERDICTS = { r: "right", w: "wrong", t: "tied", u: "no right place" };

  // Words

  const number = (value) => String(value).replace("-", "−");
  const counted = (value) => value.toLocaleString("en");
  const queryName = ({ section }, query) => (section.queryNames ? section.queryNames[query] : `query ${query}`);
  const depth = ({ section }, run) => run.places.length / section.nQueries; // best places of a query
  const placeName = ({ section }, place) => (section.placeNames ? section.placeNames[place] : `place ${place}`);

  function marginWords(run, query) {
    const margin = run.margins[query];
    const bound = run.bounds[query];
    if (bound === "?") return "no margin";
    if (margin === "-") return "the right place is no candidate";
    if (margin === "+") return "no wrong place is a candidate";
    return `margin ${{ "=": "", "<": "at most ", ">": "at least " }[bound]}${number(margin)}`;
  }

  function rankWords({ section }, run, query) {
    const rank = run.ranks[query];
    const equals = run.equals[query] ?? 0;
    if (run.verdicts[query] === "u") return "";
    if (!rank) return "the right place is not ranked";
    const ranks = equals ? `shares ranks ${counted(rank)} to ${counted(rank + equals)}` : `ranks ${counted(rank)}`;
    return `the right place ${ranks} of ${counted(section.nPlaces)}`;
  }

  function distance({ section }, query, place) {
    const gaps = section.rightPlaces[query].split(", ").map((range) => {
      const [first, last = first] = range.split("-").map(Number);
      return Math.max(first - place, place - last, 0);
    });
    return Math.min(...gaps);
  }

  function distanceWords(view, run, query) {
    const place = run.places[depth(view, run) * query];
    if (place < 0) return "no place was retrieved";
    if (run.verdicts[query] === "u") return "";
    const apart = distance(view, query, place);
    return apart ? `${counted(apart)} ${apart === 1 ? "place" : "places"} off` : "";
  }

  function unjudgedFacts(view, run, query) {
    const first = depth(view, run) * query;
    if (run.places[first] < 0) return ["no place was retrieved"];
    const margin = run.margins[query];
    const apart = margin === null ? "no second place" : `margin ${number(margin)} to the second`;
    return [`best score ${number(run.scores[first])}`, apart];
  }

  function judgedFacts(view, run, query) {
    return [marginWords(run, query), rankWords(view, run, query), distanceWords(view, run, query)].filter(Boolean);
  }

  // One line a fact of one method, or one line a method of two.
  function facts(view, query) {
    const { judged } = view.section;
    const ofRun = judged ? judgedFacts : unjudgedFacts;
    if (!view.b) return ofRun(view, view.a, query);
    return [["A", view.a], ["B", view.b]].map(([letter, run]) => {
      const verdict = judged ? ` ${VERDICTS[run.verdicts[query]]}` : "";
      return `${letter}${verdict}: ${ofRun(view, run, query).join(", ")}`;
    });
  }

  function rightScore(run, query) {
    const score = run.rightScores[query];
    return score === null ? "" : `${run.bounds[query] === "<" ? "at most " : ""}${number(score)}`;
  }

  function rightScores({ a, b }, query) {
    const byA = rightScore(a, query);
    if (!b) return byA && `score ${byA}`;
    const byB = rightScore(b, query);
    if (!byA && !byB) return "";
    const other = byB && b.right[query] !== a.right[query] ? ` for place ${b.right[query]}` : "";
    return `score by A ${byA || "none"}, by B ${byB || "none"}${other}`;
  }

  // Elements; text is never read as markup

  function make(tag, className, ...children) {
    const made = document.createElement(tag);
    if (className) made.className = className;
    made.append(...children);
    return made;
  }

  function frame(view, role, kind, index, lines) {
    const name = index < 0 ? "" : kind === "queries" ? queryName(view, index) : placeName(view, index);
    const webp = index < 0 ? null : view.picture(kind, index);
    const image = webp && make("img");
    if (image) {
      image.alt = `${role}: ${name}`;
      image.src = `data:image/webp;base64,${webp}`;
    }
    const made = make("figure", "frame", image || make("div", "no-frame", name || lines.shift()));
    const caption = make("figcaption", "", make("span", "role", role));
    if (image) lines.unshift(name);
    lines.filter(Boolean).forEach((line) => caption.append(make("div", "", line)));
    made.append(caption);
    return made;
  }

  function retrieved(view, role, run, query) {
    const first = depth(view, run) * query;
    const place = run.places[first];
    if (place < 0) return frame(view, role, "places", -1, ["nothing retrieved"]);
    return frame(view, role, "places", place, [`place ${place}`, `score ${number(run.scores[first])}`]);
  }

  function truth(view, query) {
    const place = view.a.right[query];
    if (place < 0) return frame(view, "True", "places", -1, ["no right place"]);
    const right = view.section.rightPlaces[query];
    const several = /[-,]/.test(right) ? `right: ${right}` : "";
    return frame(view, "True", "places", place, [`place ${place}`, rightScores(view, query), several]);
  }

  function places(view, run, query) {
    const shown = [];
    const first = depth(view, run) * query;
    for (let i = first; i < first + depth(view, run) && run.places[i] >= 0; i += 1) {
      const place = run.places[i];
      const right = view.section.rightPlaces[query] && distance(view, query, place) === 0;
      const role = `${i - first + 1}.${view.section.judged ? (right ? " right" : " wrong") : ""}`;
      shown.push(frame(view, role, "places", place, [`place ${place}`, `score ${number(run.scores[i])}`]));
    }
    return shown;
  }

  function bestPlaces(view, letter, run, query) {
    const best = make("div", "frames", ...places(view, run, query));
    return [make("h4", "", `Best places of ${letter}, ${run.name}`), best];
  }

  function row(view, query) {
    const { a, b, section } = view;
    const { judged } = section;
    const button = make("button", "", ` Query ${query} `);
    button.type = "button";
    button.id = `query-${query}`;
    if (judged) {
      button.prepend(make("span", `verdict ${KINDS[a.verdicts[query]]}`, VERDICTS[a.verdicts[query]]));
      button.append(make("span", "toggle"));
    }
    const listed = make("ul", "facts", ...facts(view, query).map((fact) => make("li", "", fact)));
    const shown = make("div", `frames${judged && b ? " four" : ""}`, frame(view, "Query", "queries", query, []));
    const made = make("li", `query${judged ? "" : " wide"}`, make("div", "", button, listed), shown);
    made.dataset.query = query;
    if (judged) {
      shown.append(retrieved(view, b ? "Retrieved by A" : "Retrieved", a, query));
      if (b) shown.append(retrieved(view, "Retrieved by B", b, query));
      shown.append(truth(view, query));
      unfold(view, made, query);
    } else {
      shown.append(...places(view, a, query));
      if (b) made.append(make("div", "more", ...bestPlaces(view, "B", b, query)));
    }
    return made;
  }

  function unfold(view, made, query) {
    made.querySelector(".more")?.remove();
    const unfolded = view.open.has(query);
    const button = made.querySelector("button");
    button.setAttribute("aria-expanded", String(unfolded));
    button.querySelector(".toggle").textContent = unfolded ? "hide best places" : "show best places";
    if (!unfolded) return;
    const best = [...bestPlaces(view, "A", view.a, query), ...(view.b ? bestPlaces(view, "B", view.b, query) : [])];
    made.append(make("div", "more", ...best));
  }

  return { KINDS, VERDICTS, counted, depth, make, row, unfold };
})();

// The strip along the route: a lane for each method, with a bar for each query.
const Strip = (() => {
  const { make } = Queries;

  function drawn(tag, attributes) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    return made;
  }

  function bars(nQueries, className, wanted, height) {
    let path = "";
    for (let query = 0; query < nQueries; query += 1) {
      if (!wanted(query)) continue;
      const first = query;
      while (query + 1 < nQueries && wanted(query + 1)) query += 1;
      path += `M${first} 100h${query - first + 1}v-${height}H${first}z`;
    }
    return drawn("path", { class: `bars ${className}`, d: path });
  }

  function lane(nQueries, className, name, paths, go) {
    const svg = drawn("svg", { viewBox: `0 0 ${nQueries} 100`, preserveAspectRatio: "none", "aria-hidden": "true" });
    svg.append(...paths, drawn("path", { class: "here", d: "" }));
    svg.addEventListener("click", (event) => {
      const box = svg.getBoundingClientRect();
      go(Math.floor(((event.clientX - box.left) / box.width) * nQueries));
    });
    return make("div", `lane ${className}`, make("div", "lane-name", name), svg);
  }

  return { bars, lane };
})();

// Tabs that share a panel: `turn(i)` is called for the one that is chosen, by click or by key. One tab is not shown.
function Tabs(list, panel, turn) {
  const tabs = [...list.children];
  const steps = {
    ArrowRight: (i) => (i + 1) % tabs.length,
    ArrowLeft: (i) => (i + tabs.length - 1) % tabs.length,
    Home: () => 0,
    End: () => tabs.length - 1,
  };
  list.hidden = tabs.length < 2;
  if (!list.hidden) panel.setAttribute("role", "tabpanel");
  tabs.forEach((tab, i) => {
    tab.addEventListener("click", () => turn(i));
    tab.addEventListener("keydown", (event) => {
      if (event.altKey || event.ctrlKey || event.metaKey || !(event.key in steps)) return;
      event.preventDefault();
      turn(steps[event.key](i));
      tabs[steps[event.key](i)].focus();
    });
  });

  function mark(chosen) {
    tabs.forEach((tab, i) => {
      tab.setAttribute("aria-selected", String(i === chosen));
      tab.tabIndex = i === chosen ? 0 : -1;
    });
    if (!list.hidden) panel.setAttribute("aria-labelledby", tabs[chosen].id);
  }

  return { mark };
}

// The browser of single queries: reads the answers of the stored runs from this page and shows ten at a time.
(() => {
  const PAGE = 10;
  const PAUSE = 250; // milliseconds after a choice before the address changes: browsers refuse many changes at once
  const { KINDS, VERDICTS, counted, depth, make, row, unfold } = Queries;
  const { bars, lane } = Strip;
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

  const filters = () => (section.judged ? FILTERS : FILTERS.slice(0, 1)); // without a ground truth all are alike
  const filterNamed = (id) => filters().find((filter) => filter.id === id) ?? filters().at(section.judged ? 1 : 0);

  const sections = JSON.parse(document.getElementById("answers").textContent);
  if (!sections.length) return;
  const element = (id) => document.getElementById(id);
  const choices = Object.fromEntries(
    ["method-a", "method-b", "kind", "order"].map((id) => [id, element(id)]),
  );
  const tabs = Tabs(element("datasets"), element("dataset"), (number) => {
    const wanted = choicesShown();
    wanted.set("dataset", sections[number].title);
    wanted.delete("query");
    show(wanted);
  });
  const list = element("queries");
  const along = element("along");
  const frames = sections.map(() => null); // parsed when a dataset is first looked at

  let section = sections[0];
  let a = section.runs[0];
  let b = null;
  let shown = []; // queries that pass the filter, in the order of the list
  let at = 0; // which of them is the current one
  let writing = null; // the timer that writes the address
  const open = new Set(); // queries whose best places are unfolded

  function picture(kind, index) {
    const number = sections.indexOf(section);
    frames[number] ??= JSON.parse(element(`frames-${number}`).textContent);
    return frames[number][kind][index];
  }

  const view = () => ({ section, a, b, open, picture });

  // What is shown

  function chosenFilter() {
    return filterNamed(choices.kind.value);
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
    if (choices.order.value.endsWith("score")) return a.scores[depth(view(), a) * query] ?? NaN;
    const margin = a.margins[query];
    if (a.bounds[query] === "?") return NaN;
    return margin === "-" ? -Infinity : margin === "+" ? Infinity : margin;
  }

  function sorted(queries) {
    if (choices.order.value === "route") return queries;
    const sign = choices.order.value.startsWith("lowest") ? 1 : -1;
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

  // The choices as the fragment of the address, in names, so that a link outlives the page it was copied from

  function choicesShown() {
    const chosen = { dataset: section.title, a: a.name, show: chosenFilter().id, sort: choices.order.value };
    if (b) chosen.b = b.name;
    if (shown.length) chosen.query = shown[at];
    return new URLSearchParams(chosen);
  }

  function writeAddress() {
    clearTimeout(writing);
    writing = setTimeout(() => history.replaceState(null, "", `#${choicesShown()}`), PAUSE);
  }

  function follow() {
    if (!location.hash.includes("=")) return;
    show(new URLSearchParams(location.hash.slice(1)));
    clearTimeout(writing);
    if (shown.length) go(at, false);
  }

  function show(wanted) {
    const number = Math.max(0, sections.findIndex(({ title }) => title === wanted.get("dataset")));
    section = sections[number];
    tabs.mark(number);
    document.querySelectorAll("#findings .found").forEach((found, i) => (found.hidden = i !== number));
    element("frames-missing").textContent = section.framesMissing;
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
    const before = filterNamed(kind);
    const kept = before.pair && !b ? filterNamed() : before;
    const options = filters().map((filter) => ({
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
    writeAddress();
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
      const verdict = section.judged ? `: ${VERDICTS[a.verdicts[shown[at]]]}` : "";
      along.setAttribute("aria-valuetext", `query ${shown[at]}${verdict}`);
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

  const drawLane = (...parts) => lane(section.nQueries, ...parts, (query) => go(nearest(query)));

  function drawLanes() {
    const judged = section.judged ? [["A", a], ...(b ? [["B", b]] : [])] : [];
    const lanes = judged.map(([letter, run]) => {
      const counts = Object.keys(KINDS).map((kind) => [run.verdicts.split(kind).length - 1, VERDICTS[kind]]);
      const words = counts.filter(([count]) => count).map(([count, verdict]) => `${counted(count)} ${verdict}`);
      const paths = Object.keys(KINDS).map((kind) =>
        bars(section.nQueries, KINDS[kind], (query) => run.verdicts[query] === kind, HEIGHTS[kind]),
      );
      return drawLane("", `${letter}, ${run.name}: ${words.join(", ")}`, paths);
    });
    const kept = new Set(shown);
    lanes.push(drawLane("shown", "Shown below", [bars(section.nQueries, "shown", (query) => kept.has(query), 100)]));
    element("lanes").replaceChildren(...lanes);
    element("legend").hidden = !section.judged;
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
    if (section.judged && event.target.closest("button")) {
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

  element("browsing").hidden = false;
  show(new URLSearchParams());
  clearTimeout(writing);
  follow();
})();

// The table: sorted by a column, filtered by a word, with its footnotes where the pointer is.
(() => {
  const { make } = Queries;
  const table = document.querySelector("#table table");
  if (!table) return;
  const NEXT = { name: ["ascending", "descending", "none"], number: ["descending", "ascending", "none"] };
  const heads = [...table.querySelectorAll("thead tr:last-child th")];
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

  for (const link of table.querySelectorAll("sup a")) {
    link.title = document.getElementById(link.hash.slice(1)).textContent;
  }
})();
