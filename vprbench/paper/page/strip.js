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
