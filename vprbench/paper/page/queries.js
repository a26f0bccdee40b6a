"use strict";
// How one query is told and drawn: its verdict, its frames and its best places, by one method or by two.
// A `view` holds what is looked at: `section`, its runs `a` and `b` (null: none), `open` queries, `picture(kind, i)`.
const Queries = (() => {
  const KINDS = { r: "right", w: "wrong", t: "tied", u: "unanswerable" };
  const VERDICTS = { r: "right", w: "wrong", t: "tied", u: "no right place" };

  // Words

  const number = (value) => String(value).replace("-", "−");
  const counted = (value) => value.toLocaleString("en");
  const queryName = ({ section }, query) => (section.queryNames ? section.queryNames[query] : `query ${query}`);
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
    const place = run.places[3 * query];
    if (place < 0) return "no place was retrieved";
    if (run.verdicts[query] === "u") return "";
    const apart = distance(view, query, place);
    return apart ? `${counted(apart)} ${apart === 1 ? "place" : "places"} off` : "";
  }

  function facts(view, query) {
    const told = [["A", view.a], ["B", view.b]]
      .filter(([, run]) => run)
      .map(([letter, run]) => {
        const parts = [marginWords(run, query), rankWords(view, run, query), distanceWords(view, run, query)];
        return [`${letter} ${VERDICTS[run.verdicts[query]]}: `, parts.filter(Boolean)];
      });
    return view.b ? told.map(([verdict, parts]) => verdict + parts.join(", ")) : told[0][1];
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
    const place = run.places[3 * query];
    if (place < 0) return frame(view, role, "places", -1, ["nothing retrieved"]);
    return frame(view, role, "places", place, [`place ${place}`, `score ${number(run.scores[3 * query])}`]);
  }

  function truth(view, query) {
    const place = view.a.right[query];
    if (place < 0) return frame(view, "True", "places", -1, ["no right place"]);
    const right = view.section.rightPlaces[query];
    const several = /[-,]/.test(right) ? `right: ${right}` : "";
    return frame(view, "True", "places", place, [`place ${place}`, rightScores(view, query), several]);
  }

  function bestPlaces(view, letter, run, query) {
    const best = make("div", "frames");
    for (let i = 3 * query; i < 3 * query + 3 && run.places[i] >= 0; i += 1) {
      const place = run.places[i];
      const right = view.section.rightPlaces[query] && distance(view, query, place) === 0;
      const role = `${i - 3 * query + 1}. ${right ? "right" : "wrong"}`;
      best.append(frame(view, role, "places", place, [`place ${place}`, `score ${number(run.scores[i])}`]));
    }
    return [make("h4", "", `Best places of ${letter}, ${run.name}`), best];
  }

  function row(view, query) {
    const { a, b } = view;
    const verdict = make("span", `verdict ${KINDS[a.verdicts[query]]}`, VERDICTS[a.verdicts[query]]);
    const button = make("button", "", verdict, ` Query ${query} `, make("span", "toggle"));
    button.type = "button";
    button.id = `query-${query}`;
    const listed = make("ul", "facts", ...facts(view, query).map((fact) => make("li", "", fact)));
    const shownFrames = [
      frame(view, "Query", "queries", query, []),
      retrieved(view, b ? "Retrieved by A" : "Retrieved", a, query),
      ...(b ? [retrieved(view, "Retrieved by B", b, query)] : []),
      truth(view, query),
    ];
    const side = make("div", `frames${b ? " four" : ""}`, ...shownFrames);
    const made = make("li", "query", make("div", "", button, listed), side);
    made.dataset.query = query;
    unfold(view, made, query);
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

  return { KINDS, VERDICTS, counted, make, row, unfold };
})();
