// SPDX-License-Identifier: GPL-3.0-or-later
// Numbers and elements for people.

export const count = (n) => Number(n).toLocaleString("en").replaceAll(",", "\u202f");

export function bytes(n) {
  const units = ["B", "KiB", "MiB", "GiB", "TiB"];
  let unit = 0;
  for (; n >= 1024 && unit < units.length - 1; unit++) n /= 1024;
  return `${unit && n < 100 ? n.toFixed(1) : Math.round(n)} ${units[unit]}`;
}

export function seconds(s) {
  if (s < 10) return `${s.toFixed(1)} s`;
  return s < 120 ? `${Math.round(s)} s` : `${Math.round(s / 60)} min`;
}

// Three or so significant digits, as a length is read.
export function figure(x) {
  if (!x) return String(x ?? "");
  const places = 3 - Math.floor(Math.log10(Math.abs(x)));
  if (Math.abs(x) >= 1e9 || places > 10) return x.toExponential(2).replace("e-", " × 10^-").replace("e+", " × 10^");
  return places <= 0 ? count(Math.round(x)) : String(Number(x.toPrecision(4)).toFixed(Math.min(places, 10)).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, ""));
}

// A name within a sentence: what it has to turn the direction of writing ends with it.
export const isolated = (name) => `\u2068${name}\u2069`;

// What a job is called: as its file, or, where nobody told that file's name, by when it came.
export const nameOf = ({ label, created }) => label || `Upload of ${new Date(created).toLocaleString()}`;

// A number and what it is of stay on one line.
export const together = (text) => text.replace(/(?<=\d) (?=%|s\b|min\b|[KMGT]?i?B\b)/g, "\u00a0");

export const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

export const sentence = (text) => `${capital(text)}${text.endsWith(".") ? "" : "."}`;

export function percent(share) {
  const text = String(Number((100 * share).toPrecision(3)));
  return `${/e/.test(text) ? figure(100 * share) : text} %`;
}

// make("p", { class: "note" }, "text", element...)
export function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value !== undefined && value !== null) element.setAttribute(key, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

export const find = (id) => document.getElementById(id);

export function show(id, visible) {
  find(id).hidden = !visible;
}
