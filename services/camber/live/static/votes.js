// Votes on a surface over time: for each day the median and the quartiles of the vehicles' offsets, and how many vehicles.

import { element } from "./dom.js";

const WIDTH = 300, HEIGHT = 120, LEFT = 54, RIGHT = 8, TOP = 8, BOTTOM = 18; // units of the drawing
const DAY_S = 86400;
const LEAST_RANGE_M = .02; // so that noise of millimetres does not fill the height

const shape = (name, attributes, text) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
};
const date = time => new Date(time * 1000).toISOString().slice(0, 10);
export const centimetres = value => `${value < 0 ? "−" : "+"}${(100 * Math.abs(value)).toFixed(1)} cm`;

export function votesChart(days, inMap, left_out) {
  const values = days.flatMap(({ low_m, high_m }) => [low_m, high_m]).filter(Number.isFinite).concat(inMap);
  let low = Math.min(...values), high = Math.max(...values);
  const spare = Math.max(LEAST_RANGE_M - (high - low), .1 * (high - low)) / 2;
  low -= spare; high += spare;
  const first = Math.min(...days.map(each => each.t)), last = Math.max(...days.map(each => each.t), first + DAY_S);
  const x = time => LEFT + (time - first) / (last - first) * (WIDTH - LEFT - RIGHT), y = value => TOP + (high - value) / (high - low) * (HEIGHT - TOP - BOTTOM);
  const most = Math.max(...days.map(each => each.vehicles));
  const drawing = shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": description(days), class: "votes" });
  drawing.append(
    shape("line", { class: "map", x1: LEFT, x2: WIDTH - RIGHT, y1: y(inMap), y2: y(inMap) }),
    shape("text", { x: LEFT - 4, y: y(high) + 8, class: "end" }, centimetres(high)), shape("text", { x: LEFT - 4, y: y(low), class: "end" }, centimetres(low)),
    shape("text", { x: LEFT, y: HEIGHT - 3 }, date(first)), shape("text", { x: WIDTH - RIGHT, y: HEIGHT - 3, class: "end" }, days.length > 1 ? date(last) : ""),
  );
  for (const { t, offset_m, low_m, high_m, vehicles } of days) {
    if (!Number.isFinite(offset_m)) continue;
    const point = shape("circle", { cx: x(t), cy: y(offset_m), r: 2.5 + 3 * Math.sqrt(vehicles / most) });
    point.append(shape("title", {}, `${date(t)}: ${centimetres(offset_m)}, ${vehicles} vehicle${vehicles === 1 ? "" : "s"}`));
    drawing.append(shape("line", { class: "spread", x1: x(t), x2: x(t), y1: y(low_m), y2: y(high_m) }), point);
  }
  return element("figure", {}, drawing, element("figcaption", {}, `Votes by day: median and quartiles; larger points are more vehicles${left_out ? `; ${left_out} with one or two vehicles are left out` : ""}. Biases of vehicles are not removed. The line is the map's correction.`));
}

const description = days => `Votes by day: ${days.map(({ t, offset_m, vehicles }) => `${date(t)} ${centimetres(offset_m ?? NaN)} of ${vehicles}`).join("; ")}`;
