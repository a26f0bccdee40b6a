"use strict";
// The browser of single queries: reads the answers of the stored runs from this page and draws twenty at a time.
(() => {
  const PAGE = 20;
  const KINDS = { r: "right", w: "wrong", t: "tied", u: "unanswerable" };
  const VERDICTS = { r: "right", w: "wrong", t: "tied", u: "no right place" };
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
    ["dataset", "method-a", "method-b", "kind", "order"].map((id) => [id, element(id)]),
  );
  const list = element("queries");
  const along = element("along");
  const frames = sections.map(() => null); // parsed when a dataset is first looked at

  let section = sections[0];
  let a = section.runs[0];
  let b = null;
  let shown = []; // queries that pass the filter, in the order of the list
  let at = 0; // which of them is the current one
  const open = new Set(); // queries whose best places are unfolded

  // Words

  const number = (value) => String(value).replace("-", "−");
  const counted = (value) => value.toLocaleString("en");
  const queryName = (query) => (section.queryNames ? section.queryNames[query] : `query ${query}`);
  const placeName = (place) => (section.placeNames ? section.placeNames[place] : `place ${place}`);

  function marginWords(run, query) {
    const margin = run.margins[query];
    const bound = run.bounds[query];
    if (bound === "?") return "no margin";
    if (margin === "-") return "the right place is no candidate";
    if (margin === "+") return "no wrong place is a candidate";
    return `margin ${{ "=": "", "<": "at most ", ">": "at least " }[bound]}${number(margin)}`;
  }

  function rankWords(run, query) {
    const rank = run.ranks[query];
    const equals = run.equals[query] ?? 0;
    if (run.verdicts[query] === "u") return "this query has no right place";
    if (!rank) return "the right place is not ranked";
    const ranks = equals ? `shares ranks ${counted(rank)} to ${counted(rank + equals)}` : `ranks ${counted(rank)}`;
    return `the right place ${ranks} of ${counted(section.nPlaces)}`;
  }

  function distance(query, place) {
    const gaps = section.rightPlaces[query].split(", ").map((range) => {
      const [first, last = first] = range.split("-").map(Number);
      return Math.max(first - place, place - last, 0);
    });
    return Math.min(...gaps);
  }

  function distanceWords(run, query) {
    const place = run.places[3 * query];
    if (place < 0) return "no place was retrieved";
    if (run.verdicts[query] === "u") return "";
    const apart = distance(query, place);
    return apart ? `${counted(apart)} ${apart === 1 ? "place" : "places"} off` : "";
  }

  // Elements; text is never read as markup

  function make(tag, className, ...children) {
    const made = document.createElement(tag);
    if (className) made.className = className;
    made.append(...children);
    return made;
  }

  function drawn(tag, attributes) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    return made;
  }

  function picture(kind, index, alternative) {
    const number = sections.indexOf(section);
    frames[number] ??= JSON.parse(element(`frames-${number}`).textContent);
    const webp = frames[number][kind][index];
    if (!webp) return null;
    const image = make("img");
    image.alt = alternative;
    image.src = `data:image/webp;base64,${webp}`;
    return image;
  }

  function frame(role, kind, index, lines) {
    const name = index < 0 ? "" : kind === "queries" ? queryName(index) : placeName(index);
    const image = index < 0 ? null : picture(kind, index, `${role}: ${name}`);
    const made = make("figure", "frame", image ?? make("div", "no-frame", name || lines.shift()));
    const caption = make("figcaption", "", make("span", "role", role));
    if (image) lines.unshift(name);
    lines.filter(Boolean).forEach((line) => caption.append(make("div", "", line)));
    made.append(caption);
    return made;
  }

  function retrieved(role, run, query) {
    const place = run.places[3 * query];
    if (place < 0) return frame(role, "places", -1, ["nothing retrieved"]);
    return frame(role, "places", place, [`place ${place}`, `score ${number(run.scores[3 * query])}`]);
  }

  function truth(run, query) {
    const place = run.right[query];
    if (place < 0) return frame("True", "places", -1, ["no right place"]);
    const score = run.rightScores[query];
    const most = run.bounds[query] === "<" ? "at most " : "";
    const several = /[-,]/.test(section.rightPlaces[query]) ? `right: ${section.rightPlaces[query]}` : "";
    const scored = score === null ? "" : `score ${most}${number(score)}`;
    return frame("True", "places", place, [`place ${place}`, scored, several]);
  }

  function bestPlaces(letter, run, query) {
    const best = make("div", "frames");
    for (let i = 3 * query; i < 3 * query + 3 && run.places[i] >= 0; i += 1) {
      const right = section.rightPlaces[query] && distance(query, run.places[i]) === 0;
      const role = `${i - 3 * query + 1}. ${right ? "right" : "wrong"}`;
      best.append(frame(role, "places", run.places[i], [`place ${run.places[i]}`, `score ${number(run.scores[i])}`]));
    }
    return [make("h4", "", `Best places of ${letter}, ${run.name}`), best];
  }

  function row(query) {
    const kind = KINDS[a.verdicts[query]];
    const verdict = make("span", `verdict ${kind}`, VERDICTS[a.verdicts[query]]);
    const button = make("button", "", verdict, ` Query ${query} `, make("span", "toggle"));
    button.type = "button";
    button.id = `query-${query}`;
    const facts = [marginWords(a, query), rankWords(a, query), distanceWords(a, query)];
    if (b) facts.push(`B ${VERDICTS[b.verdicts[query]]}: ${marginWords(b, query)}`);
    const listed = make("ul", "facts", ...facts.filter(Boolean).map((fact) => make("li", "", fact)));
    const shownFrames = [
      frame("Query", "queries", query, []),
      retrieved(b ? "Retrieved by A" : "Retrieved", a, query),
      ...(b ? [retrieved("Retrieved by B", b, query)] : []),
      truth(a, query),
    ];
    const side = make("div", `frames${b ? " four" : ""}`, ...shownFrames);
    const made = make("li", "query", make("div", "", button, listed), side);
    made.dataset.query = query;
    unfold(made, query);
    return made;
  }

  function unfold(made, query) {
    made.querySelector(".more")?.remove();
    const button = made.querySelector("button");
    button.setAttribute("aria-expanded", String(open.has(query)));
    button.querySelector(".toggle").textContent = open.has(query) ? "hide best places" : "show best places";
    if (!open.has(query)) return;
    made.append(make("div", "more", ...bestPlaces("A", a, query), ...(b ? bestPlaces("B", b, query) : [])));
  }

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

  function chooseSection() {
    section = sections[Number(choices.dataset.value)];
    const runs = section.runs.map((run, i) => ({ value: String(i), text: run.name }));
    fill(choices["method-a"], runs, "0");
    fill(choices["method-b"], [{ value: "", text: "nothing" }, ...runs], "");
    element("frames-missing").hidden = !section.framesMissing;
    element("frames-missing").textContent = section.framesMissing;
    chooseRuns();
  }

  function chooseRuns() {
    a = section.runs[Number(choices["method-a"].value)];
    b = choices["method-b"].value === "" ? null : section.runs[Number(choices["method-b"].value)];
    const before = chosenFilter();
    const kept = before.pair && !b ? FIRST : before;
    const options = FILTERS.map((filter) => ({
      value: filter.id,
      text: filter.pair && !b ? `${filter.name} (choose B)` : `${filter.name} (${counted(passing(filter).length)})`,
      disabled: filter.pair && !b,
    }));
    fill(choices.kind, options, kept.id);
    refresh();
  }

  function refresh() {
    open.clear();
    shown = sorted(passing(chosenFilter()));
    at = 0;
    drawLanes();
    drawPage();
  }

  function drawPage() {
    const first = at - (at % PAGE);
    const rows = shown.slice(first, first + PAGE).map(row);
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
    element("previous-page").disabled = first === 0;
    element("next-page").disabled = last >= shown.length;
    mark();
  }

  function mark() {
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

  // The strip

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

  function nearest(query) {
    let best = 0;
    shown.forEach((other, i) => {
      if (Math.abs(other - query) < Math.abs(shown[best] - query)) best = i;
    });
    return best;
  }

  function slide() {
    const wanted = Number(along.value);
    const current = shown[at];
    const beyond = shown.filter((query) => (wanted > current ? query >= wanted : query <= wanted));
    const next = wanted > current ? Math.min(...beyond) : Math.max(...beyond);
    go(beyond.length ? shown.indexOf(next) : at, false);
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
      unfold(made, query);
    }
    at = shown.indexOf(query);
    mark();
  });
  element("previous-page").addEventListener("click", () => go(at - (at % PAGE) - PAGE, false));
  element("next-page").addEventListener("click", () => go(at - (at % PAGE) + PAGE, false));
  element("controls").addEventListener("submit", (event) => event.preventDefault());
  along.addEventListener("input", slide);
  choices.dataset.addEventListener("change", chooseSection);
  choices["method-a"].addEventListener("change", chooseRuns);
  choices["method-b"].addEventListener("change", chooseRuns);
  choices.kind.addEventListener("change", refresh);
  choices.order.addEventListener("change", refresh);

  fill(choices.dataset, sections.map(({ title }, i) => ({ value: String(i), text: title })), "0");
  choices.dataset.closest("label").hidden = sections.length === 1;
  element("browsing").hidden = false;
  chooseSection();
})();
