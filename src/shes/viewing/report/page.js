"use strict";
const {x, axes, figures} = JSON.parse(document.getElementById("figures").textContent);
const state = {x, hidden: new Set(), episode: {}};
const drawn = new Set();

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function color(text) {
  if (!text.startsWith("--")) return text;
  const [name, opacity] = text.split("/");
  const hex = css(name);
  return opacity ? hex + Math.round(255 * opacity).toString(16).padStart(2, "0") : hex;
}

// Returns a copy of a part of a figure with the colours of the style sheet.
function themed(part) {
  if (Array.isArray(part)) return typeof part[0] === "object" && part[0] !== null ? part.map(themed) : part;
  if (typeof part !== "object" || part === null) return part;
  return Object.fromEntries(Object.entries(part).map(([key, value]) =>
    [key, typeof value === "string" && key.endsWith("color") ? color(value) : themed(value)]));
}

function layout(own) {
  const axisOf = (axis) => ({
    gridcolor: "--grid", zerolinecolor: "--edge", linecolor: "--edge", automargin: true, ...axis,
    title: axis && axis.title && {standoff: 8, ...axis.title},
  });
  const base = {
    autosize: true, showlegend: false, hovermode: "x unified", uirevision: state.x,
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: {color: "--ink", size: 12, family: "system-ui, sans-serif"},
    hoverlabel: {bgcolor: "--surface", bordercolor: "--edge", font: {color: "--ink"}, namelength: 40},
    legend: {orientation: "h", yref: "container", y: 0, yanchor: "bottom", traceorder: "normal", maxheight: 5000},
    margin: {l: 52, r: 14, t: 30, b: 52},  // the mode bar has the upper one for itself
    modebar: {bgcolor: "rgba(0,0,0,0)", color: "--faint", activecolor: "--accent"},
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",  // else a finger could not scroll the page
  };
  return themed({...base, ...own, title: undefined, xaxis: axisOf(own.xaxis), yaxis: axisOf(own.yaxis)});
}

function isShown(trace, episode) {
  if (trace.meta === undefined) return true;
  if (trace.meta.episode === undefined) return !state.hidden.has(trace.meta);
  return episode === undefined ? !trace.meta.alone : trace.meta.episode === episode;
}

const LEGEND = {symbol: 60, character: 6.6, line: 20};  // pixels

// Returns a name with breaks where it would be longer than the legend of a box of this width.
function broken(name, width) {
  const most = Math.floor((width - LEGEND.symbol) / LEGEND.character);
  const lines = [""];
  for (const word of name.split(" ")) {
    const line = `${lines.at(-1)} ${word}`.trim();
    if (line.length > most && lines.at(-1)) lines.push(word);
    else lines[lines.length - 1] = line;
  }
  return lines.join("<br>");
}

function draw(box) {
  const name = box.dataset.figure;
  const figure = figures[name].data ? figures[name] : figures[name][state.x];
  const hasLegend = figure.layout.showlegend;
  const traces = figure.data.filter((trace) => isShown(trace, state.episode[name])).map((trace) =>
    hasLegend && trace.name ? {...trace, name: broken(trace.name, box.clientWidth)} : trace);
  const {title, height} = figure.layout;
  const breaks = traces.filter((trace) => hasLegend && trace.showlegend !== false && trace.name?.includes("<br>")).length;
  const isNew = !drawn.has(box);
  drawn.add(box);
  if (title) box.previousElementSibling.innerHTML = title.text;  // whose names are escaped for plotly, too
  if (height) box.style.height = `${height + breaks * LEGEND.line}px`;
  const config = {
    displaylogo: false, responsive: true, modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
    toImageButtonOptions: {filename: title && box.previousElementSibling.innerText},
  };
  const ready = Plotly.react(box, themed(traces), layout({...figure.layout, height: undefined}), config);
  if (isNew) box.on("plotly_legendclick", ({curveNumber}) => toggleBest(box, curveNumber));
  return ready;
}

// One entry of the legend shows and hides the running best of every curve. Returns whether plotly has to go on.
function toggleBest(box, number) {
  if (box.data[number].meta?.best !== "legend") return true;
  const isShown = box.data[number].visible === "legendonly";
  const curveOf = (trace) => box.data.find((each) => each.name && each.legendgroup === trace.legendgroup);
  const change = box.data.map((trace, index) => ({trace, index})).filter(({trace}) => trace.meta?.best);
  Plotly.restyle(box, {
    visible: change.map(({trace}) =>
      trace.meta.best === "legend" ? (isShown || "legendonly") : isShown && (curveOf(trace).visible ?? true)),
  }, change.map(({index}) => index));
  return false;
}

const redraw = () => drawn.forEach(draw);

function drawLegend() {
  const legend = document.getElementById("legend");
  if (!legend) return;
  const chips = axes[state.x].map(({label, color, dash}) => {
    const chip = document.createElement("button");
    chip.type = "button";
    const dashes = {dash: "6 4", dot: "2 3", dashdot: "6 3 2 3"}[dash] || "none";
    chip.innerHTML = `<svg width="26" height="6"><path d="M0 3H26" stroke="var(${color})" stroke-width="3" stroke-dasharray="${dashes}"/></svg>`;
    chip.append(label);
    chip.setAttribute("aria-pressed", String(!state.hidden.has(label)));
    chip.addEventListener("click", () => {
      if (!state.hidden.delete(label)) state.hidden.add(label);
      drawLegend();
      redraw();
    });
    return chip;
  });
  legend.replaceChildren(...chips);
}

const choices = document.querySelectorAll("input[name=x]");
for (const input of choices)
  input.addEventListener("change", () => {
    state.x = input.value;
    choices.forEach((each) => { each.checked = each.value === state.x; });
    drawLegend();
    redraw();
  });

for (const choice of document.querySelectorAll("select[data-map]"))
  choice.addEventListener("change", () => {
    state.episode[choice.dataset.map] = choice.value === "" ? undefined : Number(choice.value);
    draw(document.querySelector(`[data-figure="${choice.dataset.map}"]`));
  });

// A figure is drawn when it comes near the window: a page may have a hundred.
const seen = new IntersectionObserver((entries) => {
  for (const {isIntersecting, target} of entries)
    if (isIntersecting && !drawn.has(target)) draw(target);
}, {rootMargin: "600px"});
document.querySelectorAll("[data-figure]").forEach((box) => seen.observe(box));

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
drawLegend();
