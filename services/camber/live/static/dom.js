// Elements and texts. What a vehicle sends becomes text and nothing else.

export function element(name, properties = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(properties)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (key === "class") made.className = value;
    else if (key === "style") Object.assign(made.style, value);
    else if (key in made) made[key] = value;
    else made.setAttribute(key, value);
  }
  made.append(...children.filter(child => child !== null && child !== undefined));
  return made;
}

export function setText(node, text) { if (node.textContent !== text) node.textContent = text; }

export function rows(list, pairs) {
  const kept = pairs.filter(([, value]) => value !== null && value !== undefined && value !== "");
  list.replaceChildren(...kept.flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)]));
}

// Asked for many times a frame, so kept until the theme changes.
const colours = new Map();
let themeOfColours = null;
export function colour(name) {
  const { theme } = document.documentElement.dataset;
  if (theme !== themeOfColours) { colours.clear(); themeOfColours = theme; }
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim());
  return colours.get(name);
}

// Size of the page's letters, by which everything that is drawn grows on a large screen.
export const remPx = () => innerWidth >= 2400 ? 20 : 14;
export const plain = word => word.replaceAll("_", " ");

export function metres(value, digits = 2) {
  if (!Number.isFinite(value)) return "–";
  return (Math.abs(value) >= 1000 ? (value / 1000).toFixed(1) + " km" : value.toFixed(digits) + " m").replace("-", "−");
}

export function clock(time, digits = 1) {
  if (!Number.isFinite(time)) return "–";
  return new Date(Math.round(time * 1000)).toISOString().slice(11, 20 + digits);
}

export function day(time) { return Number.isFinite(time) ? new Date(time * 1000).toISOString().slice(0, 10) : ""; }

export function duration(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  if (seconds < 1) return Math.round(seconds * 1000) + " ms";
  if (seconds < 120) return (seconds < 10 ? seconds.toFixed(1) : Math.round(seconds)) + " s";
  return seconds < 7200 ? Math.round(seconds / 60) + " min" : Math.round(seconds / 3600) + " h";
}

export const VERDICT_COLOURS = { confirmed: "confirmed", confirmed_after_verification: "verified", erroneous: "erroneous", unknown: "unknown" };
export const SOURCE_COLOURS = { rtk: "rtk", doppler: "doppler", sensors: "sensors", scan_match: "scan-match", none: "none" };
