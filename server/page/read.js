// SPDX-License-Identifier: GPL-3.0-or-later
// A result's figures, files and the command that makes it again.
import { ask, base, sendJson, token } from "./api.js";
import { commandOf } from "./choose.js";
import { bytes, count, figure, find, make, percent, seconds, sentence, together } from "./words.js";

const DIRECTIONS = [["symmetric", "both ways"], ["input_to_mesh", "points to mesh"], ["mesh_to_input", "mesh to points"],
  ["surface_to_mesh", "surface to mesh"], ["dropped", "dropped points to mesh"]];

const PLACES = { input: "of the input", outputs: "in the outputs", mesh: "in the mesh", report: "in the report", measure: "in what is measured" };

function rowsOf(report) {
  const rows = [["points", `${count(report.points_out)} of ${count(report.points_in)}`]], { mesh } = report;
  if (mesh) {
    rows.push(["triangles", count(mesh.triangles)], ["closed", mesh.watertight ? "yes" : `no, ${count(mesh.borders)} ${mesh.borders === 1 ? "border" : "borders"}`],
      ["components", count(mesh.components)], ["handles", count(mesh.handles)]);
    rows.push(...[["area", mesh.area], ["volume", mesh.watertight && mesh.volume]].filter(([, size]) => size).map(([name, size]) => [name, figure(size)])); // or too large for a number
  }
  return rows;
}

// Distances by direction, which a narrow screen has above their numbers, so the roles are said: a row each, with the share of the box's diagonal that the largest one is.
function errorTable({ error, cloud }) {
  const measured = error ? DIRECTIONS.filter(([name]) => error[name]).map(([name, text]) => [text, error[name]])
    : cloud?.tangent_error ? [["points to tangent planes", cloud.tangent_error]] : [];
  if (!measured.length) return [];
  return [make("caption", {}, "Deviation, in the file's units"),
    make("tr", { role: "row" }, make("td", { role: "cell" }), ...["mean", "RMS", "largest", "of diagonal"]
      .map((text) => make("th", { scope: "col", role: "columnheader" }, text))),
    ...measured.map(([text, { mean, rms, max, max_rel: share }]) => make("tr", { role: "row" }, make("th", { scope: "row", role: "rowheader" }, text),
      ...[figure(mean), figure(rms), figure(max), together(percent(share))].map((value) => make("td", { role: "cell" }, value))))];
}

// What most people want to know, each as a name, a figure, and what that is of.
function headlines({ report, resources }) {
  const { points_in: before, points_out: after, mesh } = report, error = report.error?.symmetric ?? report.cloud?.tangent_error;
  return [["Points kept", count(after), `${percent(after / before)} of ${count(before)}`],
    ...(mesh ? [["Triangles", count(mesh.triangles), mesh.watertight ? "a closed mesh" : "an open mesh"]] : []),
    ...(error ? [["Mean deviation", figure(error.mean), `${percent(error.mean_rel)} of diagonal`],
      ["Largest deviation", figure(error.max), `${percent(error.max_rel)} of diagonal`]] : []),
    ...(resources ? [["Time", seconds(resources.wall_seconds), `${bytes(resources.peak_rss_bytes)} of memory`]] : [])];
}

const line = ([name, value]) => make("tr", {}, make("th", { scope: "row" }, name), make("td", {}, value));

// Copies a link and says which; where a token is needed, one that carries none is made, and works for anyone for a day.
async function share(output, plain) {
  const url = token() ? new URL((await sendJson(`${output.href}/link?seconds=86400`, undefined)).href, location.href).href : plain;
  const copied = await navigator.clipboard?.writeText(url).then(() => true, () => false);
  return `${copied ? "copied" : "the link"}${token() ? ", good for a day" : ""}: ${url}`;
}

async function download(output) {
  const blob = await (await ask(output.href)).blob(), url = URL.createObjectURL(blob);
  make("a", { href: url, download: output.name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}

function fileOf(output) {
  const href = output.href.startsWith(base) ? output.href : base + output.href;
  const name = token() ? make("button", { type: "button", class: "quiet", onclick: () => download(output) }, output.name)
    : make("a", { href, download: output.name }, output.name);
  const said = make("output", { class: "note" });
  const sharing = make("button", { type: "button", class: "quiet", "aria-label": `Copy a link to ${output.name}`, onclick: async () => {
    said.textContent = await share(output, new URL(href, location.href).href).catch((error) => error.message);
  } }, "Copy link");
  return make("li", {}, name, make("span", { class: "note" }, bytes(output.bytes)), sharing, said);
}

export function read(job, outputs) {
  const { report, resources, params } = job;
  find("look-facts").replaceChildren(...headlines(job).map(([name, value, of]) => make("li", {}, make("span", {}, name),
    ...[["strong", value], ["span", of]].map(([kind, text]) => make(kind, {}, together(text))))));
  find("read-error").replaceChildren(...errorTable(report));
  find("read-table").replaceChildren(...rowsOf(report).map(line));
  if (resources) {
    find("read-table").append(...[["time", seconds(resources.wall_seconds)], ["memory", bytes(resources.peak_rss_bytes)]].map(line));
  }
  find("read-warnings").replaceChildren(...(report.warnings ?? []).map((text) => make("p", { class: "warning" }, sentence(text))),
    ...(report.left_out ?? []).map(({ file, what }) => make("p", { class: "note" }, sentence(/^(note|warning): /.test(what)
      ? what : `Lost or changed ${PLACES[file] ?? `in ${file}`}: ${what}`))));
  find("read-times").replaceChildren(...Object.entries(report.timings_ms ?? {}).map(([name, ms]) => line([name, `${ms.toFixed(0)} ms`])));
  find("read-files").replaceChildren(...outputs.map(fileOf));
  const name = ["levels", "max_deviation", "max_deviation_rel", "ratio", "points"].find((each) => params[each]), goal = { [name]: params[name] };
  find("read-curl").textContent = commandOf({ ...goal, outputs: params.outputs }, job.label);
}
