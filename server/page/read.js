// SPDX-License-Identifier: GPL-3.0-or-later
// A result's figures, files and the command that makes it again.
import { ask, base, sendJson, token } from "./api.js";
import { commandOf } from "./choose.js";
import { bytes, count, figure, find, make, seconds } from "./words.js";

const DIRECTIONS = [["symmetric", "both ways"], ["input_to_mesh", "points to mesh"], ["mesh_to_input", "mesh to points"],
  ["surface_to_mesh", "surface to mesh"]];

function rowsOf(report) {
  const rows = [["points", `${count(report.points_out)} of ${count(report.points_in)}`]], { mesh, error, cloud } = report;
  if (mesh) {
    rows.push(["triangles", count(mesh.triangles)], ["closed", mesh.watertight ? "yes" : `no, ${mesh.borders} borders`],
      ["components", count(mesh.components)], ["handles", count(mesh.handles)], ["area", figure(mesh.area)]);
    if (mesh.watertight) rows.push(["volume", figure(mesh.volume)]);
  }
  const measured = error ? DIRECTIONS.filter(([name]) => error[name]).map(([name, text]) => [text, error[name]])
    : cloud?.tangent_error ? [["points to tangent planes", cloud.tangent_error]] : [];
  for (const [text, stats] of measured) {
    rows.push([`${text}: mean`, figure(stats.mean)], [`${text}: RMS`, figure(stats.rms)], [`${text}: largest`, figure(stats.max)]);
  }
  return rows;
}

const line = ([name, value]) => make("tr", {}, make("th", { scope: "row" }, name), make("td", {}, value));

// A link that carries no token is made where one is needed, and works for anyone for a day.
async function share(output) {
  const { href } = await sendJson(`${output.href}/link?seconds=86400`, undefined);
  const url = new URL(href, location.href).href;
  await navigator.clipboard?.writeText(url).catch(() => {});
  return url;
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
  const said = make("output", {});
  const sharing = make("button", { type: "button", class: "quiet", "aria-label": `Link to ${output.name}`, onclick: async () => {
    said.textContent = token() ? await share(output).catch((error) => error.message) : new URL(href, location.href).href;
  } }, "Link");
  return make("li", {}, name, make("span", { class: "note" }, bytes(output.bytes)), sharing, said);
}

export function read(job, outputs) {
  const { report, resources, params } = job;
  find("read-table").replaceChildren(...rowsOf(report).map(line));
  if (resources) {
    find("read-table").append(...[["time", seconds(resources.wall_seconds)], ["memory", bytes(resources.peak_rss_bytes)]].map(line));
  }
  find("read-warnings").replaceChildren(...(report.warnings ?? []).map((text) => make("p", { class: "warning" }, text)));
  find("read-times").replaceChildren(...Object.entries(report.timings_ms ?? {}).map(([name, ms]) => line([name, `${ms.toFixed(0)} ms`])));
  find("read-files").replaceChildren(...outputs.map(fileOf));
  const { ratio, points, max_deviation_rel: bound } = params, goal = bound ? { max_deviation_rel: bound } : ratio ? { ratio } : { points };
  find("read-curl").textContent = commandOf({ ...goal, outputs: params.outputs }, job.label);
}
