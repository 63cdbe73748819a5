// What every map says of itself: the colours of roads, the key, the scale, and where north is.

import { colour, element, metres } from "./dom.js";

export const RAMPS = {
  sigma: { title: "σ of road height", stops: [[.01, "#4f8f83"], [.03, "#8fb573"], [.06, "#e0cf6a"], [.12, "#e29a4b"], [.3, "#b65a6a"]], ends: ["1 cm", "30 cm"] },
  day: { title: "road last seen", stops: [[0, "#4f8f83"], [30, "#8fb573"], [180, "#e0cf6a"], [365, "#e29a4b"], [1460, "#b65a6a"]], ends: ["today", "4 years ago"] },
  level: { title: "level", stops: [[-1, "#5566aa"], [0, "#9aa5b4"], [1, "#9b6fd0"], [2, "#d16fb0"]], ends: ["−1", "2"] },
};

// Entries are kind of mark (dot, ring or line), name of its colour, and what it stands for.
export const keyLines = entries => entries.map(([kind, name, text]) => element("div", {}, element("i", { class: kind, style: { background: colour(name), borderColor: colour(name) } }), text));

export function rampLines({ title, stops, ends }) {
  const gradient = `linear-gradient(90deg, ${stops.map(stop => stop[1]).join(", ")})`;
  return [element("div", {}, title), element("div", {}, ends[0], element("i", { class: "ramp", style: { background: gradient } }), ends[1])];
}

export function drawLegend(c, { width, height }, factor, entries) {
  const line = 17 * factor, left = width - 190 * factor;
  c.font = `${12 * factor}px system-ui, sans-serif`;
  c.fillStyle = colour("card") + "e0";
  c.fillRect(left - 10 * factor, height - (entries.length + 1) * line, 200 * factor, (entries.length + 1) * line);
  entries.forEach(([kind, name, text], k) => {
    const y = height - (entries.length - k) * line;
    c.beginPath();
    c.arc(left + 5 * factor, y - 4 * factor, 4.5 * factor, 0, 2 * Math.PI);
    c.fillStyle = c.strokeStyle = colour(name);
    c.lineWidth = 2 * factor;
    if (kind === "dot") c.fill(); else c.stroke();
    c.fillStyle = colour("ink");
    c.fillText(text, left + 18 * factor, y);
  });
}

// `factor` is pixels of the canvas by those of the page, `metresPerPixel` of the page, `bearing` in degrees.
export function drawScaleAndNorth(c, { width, height }, { factor, metresPerPixel, bearing = 0 }) {
  const most = 140 * metresPerPixel, decade = 10 ** Math.floor(Math.log10(most));
  const length = [5, 2, 1].map(step => step * decade).find(step => step <= most), pixels = length / metresPerPixel * factor;
  c.fillStyle = colour("card") + "b0";
  c.fillRect(10 * factor, height - 38 * factor, pixels + 12 * factor, 28 * factor);
  c.strokeStyle = c.fillStyle = colour("ink");
  c.lineWidth = 2 * factor;
  c.textAlign = "left";
  c.font = `${13 * factor}px system-ui, sans-serif`;
  c.beginPath();
  c.moveTo(16 * factor, height - 24 * factor); c.lineTo(16 * factor, height - 16 * factor); c.lineTo(16 * factor + pixels, height - 16 * factor); c.lineTo(16 * factor + pixels, height - 24 * factor);
  c.stroke();
  c.fillText(metres(length, length < 1 ? 2 : 0), 20 * factor, height - 22 * factor);
  c.save();
  c.translate(width - 30 * factor, 40 * factor);
  c.rotate(-bearing * Math.PI / 180);
  c.beginPath();
  c.moveTo(0, -20 * factor); c.lineTo(8 * factor, 8 * factor); c.lineTo(0, 2 * factor); c.lineTo(-8 * factor, 8 * factor);
  c.fill();
  c.fillText("N", -5 * factor, 24 * factor);
  c.restore();
}
