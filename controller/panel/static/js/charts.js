// Curves over time, and switches of each actuator. uPlot is a separate script that the page loads first.

import { el } from "./dom.js";

const WIDE = 320;

function colours() {
  const style = getComputedStyle(document.documentElement);
  return (name) => style.getPropertyValue(`--${name}`).trim();
}

// A chart that fits its card, redrawn when the colour scheme changes.
function chart(card, title, options, empty) {
  const box = el("div", { class: "chart", role: "img", "aria-label": title });
  card.append(box);
  let plot = null;
  let data = null;
  const build = () => {
    plot?.destroy();
    const colour = colours();
    const axis = { stroke: colour("faint"), grid: { stroke: colour("grid") }, ticks: { stroke: colour("grid") } };
    plot = new uPlot({
      width: box.clientWidth || WIDE,
      height: 150,
      title,
      cursor: { drag: { x: false, y: false } },
      legend: { show: false },
      ...options(colour, axis),
    }, data, box);
  };
  const set = (values) => {
    data = values;
    box.classList.toggle("empty", values[0].length === 0);
    box.dataset.empty = empty;
    if (plot === null) build();
    else plot.setData(data);
  };
  new ResizeObserver(() => plot?.setSize({ width: box.clientWidth || WIDE, height: 150 })).observe(box);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => data && build());
  return set;
}

export function showCurves(connection) {
  const card = document.getElementById("curves");
  const curve = (title, name, digits, points) =>
    chart(card, title, (colour, axis) => ({
      series: [{}, { stroke: colour(name), width: points ? 1 : 2, points: { show: points, size: 5 } }],
      axes: [{ ...axis, values: (_, ticks) => ticks.map((t) => new Date(t * 1000).toLocaleTimeString([], { hour12: false })), space: 70 },
        { ...axis, size: 58, values: (_, ticks) => ticks.map((value) => value.toFixed(digits)) }],
      scales: { y: { range: (_, least, most) => [0, most > 0 ? most * 1.1 : 1] } },
    }), "nothing yet");
  const errors = curve("error of settled points", "measured", 4, true);
  const lateness = curve("worst lateness of the loop [ms]", "commanded", 1, false);
  connection.on("curves", (curves) => {
    errors([curves.errors.map(([t]) => t), curves.errors.map(([, value]) => value)]);
    lateness([curves.lateness.map(([t]) => t), curves.lateness.map(([, value]) => value * 1000)]);
  });
}

export function showWear(connection) {
  const card = document.getElementById("wear");
  const words = el("p", { class: "hint" });
  card.append(words);
  const labels = () => connection.latest.arm?.actuators ?? [];
  const bars = chart(card, "switches of each actuator", (colour, axis) => ({
    scales: { x: { time: false, range: (_, least, most) => [least - 0.6, most + 0.6] }, y: { range: (_, least, most) => [0, Math.max(most * 1.08, 1)] } },
    series: [{}, { stroke: colour("measured"), fill: colour("measured"), paths: uPlot.paths.bars({ size: [0.7, 40] }), points: { show: false } }],
    axes: [{ ...axis, values: (_, ticks) => ticks.map((k) => (Number.isInteger(k) ? labels()[k]?.split(".")[0] ?? "" : "")) }, { ...axis, size: 58 }],
  }), "nothing yet");
  let before = "";
  const describe = () => {
    const counts = connection.latest.diagnostics?.counts;
    if (!Array.isArray(counts) || counts.length === 0) return;
    const now = JSON.stringify([counts, labels()]);
    if (now === before) return;
    before = now;
    bars([counts.map((_, k) => k), counts]);
    const most = counts.indexOf(Math.max(...counts));
    const total = counts.reduce((sum, count) => sum + count, 0);
    const busiest = labels()[most] === undefined || total === 0 ? "" : `; most: ${labels()[most]} with ${counts[most]}`;
    words.textContent = `${total} switches in all${busiest}.`;
  };
  connection.on("diagnostics", describe);
  connection.on("arm", describe); // the labels may come after the counts
}
