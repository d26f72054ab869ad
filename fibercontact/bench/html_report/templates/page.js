"use strict";
// Draws what is chosen. Every text of the data becomes a text node; plotly's were escaped before they came here.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const IN_THE_DARK = { "#000000": "#f2f2f2", "#444444": "#c0c0c0", "#0072b2": "#3aa0e0" };
  const CONFIG = { displaylogo: false, responsive: true, showSendToCloud: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };
  const MOST_LINES = 1000;

  const state = { run: 0, view: 0, portrait: 0, off: new Set(), sort: { column: null, down: false }, paper: false, all: false, near: false };
  const run = () => data.runs[state.run];
  const view = () => run().views[state.view];
  const shown = () => run().solvers.filter((k) => !state.off.has(k));
  const name = (k) => data.solvers[k].name;

  function element(tag, texts = [], attributes = {}) {
    const made = document.createElement(tag);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...[].concat(texts));
    return made;
  }

  function options(select, texts, chosen = 0) {
    select.replaceChildren(...texts.map((text, k) => element("option", text, { value: k })));
    select.value = chosen;
  }

  // As `number` of bench/report.py writes it.
  function number(value) {
    if (value === null || value === undefined) return "–";
    const size = Math.abs(value);
    if (value === 0 || (size >= 1e-3 && size < 1e5)) return size >= 100 ? value.toFixed(0) : String(Number(value.toPrecision(3)));
    return value.toExponential(1);
  }

  // Figures

  const night = () => dark.matches && !state.paper;

  function coloured(value) {
    if (!night()) return value;
    if (typeof value === "string") return IN_THE_DARK[value] || value;
    if (Array.isArray(value)) return value;
    if (value && typeof value === "object") {
      return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, coloured(inner)]));
    }
    return value;
  }

  // Without the solvers that are off: whole traces of one, points of several.
  function switched(trace) {
    const meta = trace.meta || {};
    if (meta.solver !== undefined) return state.off.has(meta.solver) ? null : trace;
    if (!meta.solvers) return trace;
    const keep = meta.solvers.map((k) => !state.off.has(k));
    return { ...trace, x: trace.x.filter((_, i) => keep[i]), y: trace.y.filter((_, i) => keep[i]) };
  }

  const axis = (grid, more) => ({ gridcolor: grid, linecolor: grid, tickcolor: grid, showline: true, showgrid: true, ticks: "outside", ...more });

  function draw(id, figure) {
    const box = byId(id);
    box.hidden = !figure;
    if (!figure) {
      Plotly.purge(box);
      return;
    }
    const ink = night() ? "#e9e9ec" : "#1d1d1f", grid = night() ? "#3a3b41" : "#e3e3e8";
    const layout = {
      ...figure.layout,
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: ink, size: 13, family: "system-ui, Liberation Sans, sans-serif" },
      hoverlabel: { font: { size: 13 } },
    };
    for (const key of ["xaxis", "yaxis"]) if (figure.layout[key]) layout[key] = axis(grid, figure.layout[key]);
    if (box.clientWidth < 600) {
      layout.legend = { ...layout.legend, font: { size: 11 }, ...(layout.scene ? { orientation: "h", y: 0, yanchor: "top" } : {}) };
    }
    const traces = figure.data.map(switched).filter((trace) => trace).map((trace) => ({ ...coloured(trace), customdata: trace.customdata }));
    Plotly.react(box, traces, layout, CONFIG);
  }

  // Tables

  function table(head, lines) {
    return element("table", [element("thead", element("tr", head)), element("tbody", lines)]);
  }

  const heading = (text, more = {}) => element("th", text, { scope: "col", ...more });
  const rowHeading = (text) => element("th", text, { scope: "row" });

  function drawFalse() {
    const solvers = shown();
    const counts = solvers.map((k) => view().problems.filter((line) => line.runs[k] && line.runs[k][5] && line.existence !== "unsolvable").length);
    const cells = counts.map((count) => element("td", String(count), count ? { class: "failed" } : {}));
    byId("false").replaceChildren(table([heading("false successes"), ...solvers.map((k) => heading(name(k)))], [element("tr", [rowHeading("problems"), ...cells])]));
  }

  const STRATA = [["failure_percent", "failures (%)"], ["sweeps_mean", "sweeps, mean"], ["time_geo_ms", "time, geometric mean (ms)"]];
  const figures = () => STRATA.filter(([key]) => view().timed || key !== "time_geo_ms");
  const kinds = () => [...new Set(view().strata.map((line) => line.by))];

  function drawStrata() {
    const by = kinds()[byId("strata-by").value], [figure] = figures()[byId("strata-figure").value], solvers = shown();
    const lines = view().strata.filter((line) => line.by === by).map((line) => {
      const values = solvers.map((k) => line[figure][k]);
      const known = values.filter((value) => value !== null && value !== undefined);
      const best = Math.min(...known), few = 2 * known.filter((value) => value === best).length <= known.length;
      const cells = values.map((value) => element("td", number(value), few && value === best ? { class: "best" } : {}));
      return element("tr", [rowHeading(line.stratum), element("td", String(line.problems)), ...cells]);
    });
    byId("strata").replaceChildren(table([heading(by), heading("problems"), ...solvers.map((k) => heading(name(k)))], lines));
  }

  const FIGURES = [[1, "time (ms)"], [2, "sweeps"], [3, "residual"], [4, "Coulomb residual"]];
  const measures = () => FIGURES.filter(([at]) => view().timed || at !== 1);
  const OUTCOMES = [
    ["all", () => true],
    ["some solver failed", (failed) => failed.some((x) => x)],
    ["the solvers disagree", (failed) => failed.some((x) => x) && failed.some((x) => !x)],
    ["every solver failed", (failed) => failed.every((x) => x)],
    ["a false success", (failed, lines) => lines.some((x) => x[5])],
  ];
  const LAST = Number.MAX_VALUE;

  function filtered() {
    const text = byId("find").value.toLowerCase(), scene = scenes()[byId("scene").value], wanted = OUTCOMES[byId("outcome").value][1];
    return view().problems.filter((line) => {
      const runs = shown().map((k) => line.runs[k]).filter((x) => x);
      const found = line.problem.toLowerCase().includes(text) || line.scene.toLowerCase().includes(text);
      return found && (scene === "all" || line.scene === scene) && wanted(runs.map((x) => x[0] !== ""), runs);
    });
  }

  const scenes = () => ["all", ...new Set(view().problems.map((line) => line.scene))];

  function sortValue(line, column, figure) {
    if (typeof column === "string") return column === "mu" && line.mu === null ? LAST : line[column];
    const found = line.runs[column];
    return !found || found[0] || found[figure] === null ? LAST : found[figure];
  }

  function sorted(lines, figure) {
    const { column, down } = state.sort;
    if (column === null) return lines;
    const sign = down ? -1 : 1;
    return lines.slice().sort((one, other) => {
      const a = sortValue(one, column, figure), b = sortValue(other, column, figure);
      if (a === b) return 0;
      if (a === LAST || b === LAST) return a === LAST ? 1 : -1; // what failed is last in either order
      return a < b ? -sign : sign;
    });
  }

  function sorter(text, column, more = {}) {
    const mine = state.sort.column === column;
    const button = element("button", text, { type: "button" });
    button.addEventListener("click", () => {
      state.sort = { column, down: mine ? !state.sort.down : false };
      drawProblems();
      byId("problems").querySelector("th[aria-sort] button").focus({ preventScroll: true });
    });
    return heading(button, mine ? { ...more, "aria-sort": state.sort.down ? "descending" : "ascending" } : more);
  }

  function problemName(line) {
    if (line.portrait === null) return line.problem;
    const button = element("button", line.problem, { type: "button", title: "drawn below" });
    button.addEventListener("click", () => {
      state.portrait = line.portrait;
      byId("portrait").value = line.portrait;
      drawPortrait();
      byId("portrait-title").scrollIntoView({ behavior: "smooth" });
    });
    return button;
  }

  function outcomeCell(found, figure) {
    if (!found) return element("td", "not run", { class: "failed" });
    if (found[0]) return element("td", found[0], { class: "failed" });
    return element("td", number(found[figure]));
  }

  function drawProblems() {
    const [figure] = measures()[byId("figure").value], solvers = shown(), lines = sorted(filtered(), figure);
    const head = [
      sorter("problem", "problem"), sorter("scene", "scene", { class: "text" }), sorter("contacts", "contacts"), sorter("μ", "mu"),
      ...solvers.map((k) => sorter(name(k), k)),
    ];
    const rows = (state.all ? lines : lines.slice(0, MOST_LINES)).map((line) => element("tr", [
      rowHeading(problemName(line)), element("td", line.scene, { class: "text" }), element("td", String(line.contacts)), element("td", number(line.mu)),
      ...solvers.map((k) => outcomeCell(line.runs[k], figure)),
    ]));
    byId("problems").replaceChildren(table(head, rows));
    const cut = rows.length < lines.length ? `, the first ${rows.length} shown` : "";
    byId("count").textContent = `${lines.length} of ${view().problems.length} problems${cut}`;
  }

  function drawPortrait() {
    const portrait = run().portraits[state.portrait];
    byId("no-portrait").hidden = Boolean(portrait);
    byId("closely").hidden = !portrait;
    if (!portrait) return;
    byId("portrait-words").textContent = portrait.words;
    byId("portrait-notes").replaceChildren(...portrait.notes.map((note) => element("li", note)));
    draw("curves", portrait.curves);
    byId("rods-words").textContent = portrait.rods_words;
    byId("rods").hidden = !portrait.rods;
    if (state.near) draw("rods", portrait.rods);
  }

  // WebGL starts when its figure comes near.
  new IntersectionObserver((changes, watcher) => {
    if (!changes.some((change) => change.isIntersecting)) return;
    watcher.disconnect();
    state.near = true;
    drawPortrait();
  }, { rootMargin: "300px" }).observe(byId("rods-section"));

  // What is chosen

  function drawSolvers() {
    const boxes = run().solvers.map((k) => {
      const box = element("input", [], { type: "checkbox", value: k });
      box.checked = !state.off.has(k);
      box.addEventListener("change", () => {
        if (box.checked) state.off.delete(k);
        else state.off.add(k);
        drawAll();
      });
      const swatch = element("span", [], { class: "swatch", "aria-hidden": "true" });
      swatch.style.borderTopColor = coloured(data.solvers[k].colour);
      return element("label", [box, swatch, name(k)]);
    });
    byId("solvers").replaceChildren(byId("solvers").firstElementChild, ...boxes);
  }

  function drawFixed() {
    for (const part of document.querySelectorAll(".shown")) {
      part.hidden = Number(part.dataset.run) !== state.run || Number(part.dataset.view) !== state.view;
    }
    const off = new Set([...state.off].map(name));
    for (const row of document.querySelectorAll("tr[data-solver]")) row.hidden = off.has(row.dataset.solver);
  }

  function drawCharts() {
    byId("profile-section").hidden = !view().profile;
    draw("profile", view().profile);
    draw("within", view().within);
    byId("accuracies-section").hidden = !run().accuracies;
    draw("accuracies", run().accuracies);
    draw("reasons", view().reasons);
    byId("no-failures").hidden = Boolean(view().reasons);
    drawPortrait();
  }

  function drawAll() {
    drawFixed();
    drawCharts();
    drawFalse();
    drawStrata();
    drawProblems();
  }

  function chooseView() {
    state.view = Number(byId("view").value);
    options(byId("strata-by"), kinds());
    options(byId("strata-figure"), figures().map(([, words]) => words));
    options(byId("scene"), scenes());
    options(byId("figure"), measures().map(([, words]) => words));
    drawAll();
  }

  function chooseRun() {
    state.run = Number(byId("run").value);
    state.portrait = 0;
    options(byId("view"), run().views.map((one) => one.title));
    options(byId("portrait"), run().portraits.map((one) => one.problem));
    drawSolvers();
    chooseView();
  }

  const onChange = (id, does) => byId(id).addEventListener("input", does);
  onChange("run", chooseRun);
  onChange("view", chooseView);
  onChange("strata-by", drawStrata);
  onChange("strata-figure", drawStrata);
  for (const id of ["find", "scene", "outcome", "figure"]) onChange(id, drawProblems);
  onChange("portrait", () => {
    state.portrait = Number(byId("portrait").value);
    drawPortrait();
  });
  const redraw = (paper) => () => {
    state.paper = paper;
    state.all = paper;
    state.near = state.near || paper;
    drawSolvers();
    drawCharts();
    drawProblems();
  };
  dark.addEventListener("change", redraw(false));
  window.addEventListener("beforeprint", redraw(true));
  window.addEventListener("afterprint", redraw(false));

  byId("controls").hidden = false;
  options(byId("run"), data.runs.map((one) => one.name));
  options(byId("outcome"), OUTCOMES.map(([words]) => words));
  chooseRun();
})();
