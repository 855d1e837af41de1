// SPDX-License-Identifier: GPL-3.0-or-later
// The jobs that there are, each with its picture.
import { ask, askJson, base } from "./api.js";
import { count, find, isolated, make, percent } from "./words.js";

const PAGE = 24;
let shown = [], next = null, actions = {};

async function pictureOf(job, image) {
  const blob = await (await ask(`/v1/jobs/${job.id}/outputs/preview.png`)).blob();
  image.src = URL.createObjectURL(blob);
  image.addEventListener("load", () => URL.revokeObjectURL(image.src), { once: true });
}

function cardOf(job) {
  const named = job.label || `${job.input.format ?? "cloud"} ${job.id.slice(-6)}`, { report } = job;
  const pictured = job.status === "successful" && job.params.outputs.includes("preview.png");
  const image = pictured ? make("img", { alt: `Before, after and deviation of ${isolated(named)}`, loading: "lazy" }) : make("div", { class: "blank" });
  if (pictured) pictureOf(job, image).catch(() => image.replaceWith(make("div", { class: "blank" })));
  const facts = report ? `${count(report.points_out)} of ${count(report.points_in)} points, ${percent(report.points_out / report.points_in)}`
    : job.problem?.title ?? job.stage ?? "";
  return make("li", { class: "card", "data-job": job.id }, image,
    make("div", { class: "text" }, make("a", { class: "name", href: `${base}/jobs/${job.id}`, onclick: (event) => {
      event.preventDefault();
      actions.open(job.id);
    } }, named),
    make("p", { class: "note" }, `${job.status}. ${facts}`),
    make("p", { class: "note" }, make("time", { datetime: job.created }, new Date(job.created).toLocaleString()))),
    make("div", { class: "row" },
      make("button", { type: "button", class: "quiet", "aria-label": `Run ${isolated(named)} again`, onclick: () => actions.again(job) }, "Again"),
      make("button", { type: "button", class: "quiet", "aria-label": `Delete ${isolated(named)}`, onclick: () => actions.remove(job) }, "Delete")));
}

function draw() {
  const wanted = find("jobs-filter").value.toLowerCase();
  const matching = shown.filter((job) => (job.label ?? "").toLowerCase().includes(wanted));
  find("jobs-list").replaceChildren(...matching.map(cardOf));
  find("jobs-none").hidden = matching.length > 0;
  find("jobs-none").textContent = shown.length || find("jobs-status").value ? "No job is called so." : "What you have made will be listed here.";
  find("jobs-tools").hidden = !shown.length && !find("jobs-status").value;
  find("jobs-more").hidden = !next;
}

async function fetchPage(after) {
  const status = find("jobs-status").value, query = new URLSearchParams({ limit: PAGE, ...(status && { status }), ...(after && { after }) });
  const { jobs } = await askJson(`/v1/jobs?${query}`);
  next = jobs.length === PAGE ? jobs.at(-1).id : null;
  return jobs;
}

export async function listJobs(given = actions) {
  actions = given;
  shown = await fetchPage(null);
  draw();
}

find("jobs-filter").addEventListener("input", draw);
find("jobs-status").addEventListener("change", () => listJobs().catch(() => {}));
find("jobs-more").addEventListener("click", async () => {
  shown = [...shown, ...await fetchPage(next)];
  draw();
});
