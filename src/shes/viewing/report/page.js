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
    legend: {orientation: "h", yref: "container", y: 0, yanchor: "bottom", traceorder: "normal"},
    margin: {l: 52, r: 14, t: own.title ? 40 : 14, b: 52},
    modebar: {bgcolor: "rgba(0,0,0,0)", color: "--faint", activecolor: "--accent"},
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",  // else a finger could not scroll the page
  };
  const title = own.title && {x: 0, xref: "paper", font: {size: 14}, ...own.title};
  return themed({...base, ...own, title, xaxis: axisOf(own.xaxis), yaxis: axisOf(own.yaxis)});
}

function isShown(trace, episode) {
  if (trace.meta === undefined) return true;
  if (trace.meta.episode === undefined) return !state.hidden.has(trace.meta);
  return episode === undefined ? !trace.meta.alone : trace.meta.episode === episode;
}

function draw(box) {
  const name = box.dataset.figure;
  const figure = figures[name].data ? figures[name] : figures[name][state.x];
  const traces = figure.data.filter((trace) => isShown(trace, state.episode[name]));
  drawn.add(box);
  if (figure.layout.height) box.style.height = `${figure.layout.height}px`;
  const config = {displaylogo: false, responsive: true, modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]]};
  return Plotly.react(box, themed(traces), layout(figure.layout), config);
}

const redraw = () => drawn.forEach(draw);

function drawLegend() {
  const legend = document.getElementById("legend");
  if (!legend) return;
  const chips = axes[state.x].map(({label, color, dash}) => {
    const chip = document.createElement("button");
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

for (const input of document.querySelectorAll("input[name=x]"))
  input.addEventListener("change", () => {
    state.x = input.value;
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
