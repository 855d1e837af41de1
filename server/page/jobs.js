// SPDX-License-Identifier: GPL-3.0-or-later
// The jobs that there are, each with its picture.
import { ask, askJson, base } from "./api.js";
import { count, find, isolated, make, nameOf, percent, together } from "./words.js";

const PAGE = 24;
const STATES = { accepted: "Waiting", running: "Running", successful: "Done", failed: "Failed", dismissed: "Cancelled" };
let shown = [], next = null, actions = {};
const cards = new Map(); // of jobs that are shown, as they were when these were made

async function pictureOf(job, image) {
  const blob = await (await ask(`/v1/jobs/${job.id}/outputs/preview.png`)).blob();
  image.src = URL.createObjectURL(blob);
  image.addEventListener("load", () => URL.revokeObjectURL(image.src), { once: true });
}

function cardOf(job) {
  const named = nameOf(job), { report } = job;
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
    make("p", { class: "note" }, together(`${STATES[job.status] ?? job.status}${facts && ": "}${facts}`)),
    make("p", { class: "note" }, make("time", { datetime: job.created }, new Date(job.created).toLocaleString()))),
    make("div", { class: "row" },
      make("button", { type: "button", class: "quiet", "aria-label": `Run ${isolated(named)} again`, onclick: () => actions.again(job) }, "Run again"),
      make("button", { type: "button", class: "quiet", "aria-label": `Delete ${isolated(named)}`, onclick: () => actions.remove(job) }, "Delete")));
}

const wanted = () => find("jobs-filter").value.toLowerCase();
const matching = () => shown.filter((job) => nameOf(job).toLowerCase().includes(wanted()));

// The card that there is, where nothing has changed: its picture has come.
function keptCardOf(job) {
  const key = `${job.id} ${job.updated} ${job.status}`;
  if (!cards.has(key)) cards.set(key, cardOf(job));
  return cards.get(key);
}

function draw() {
  const found = matching();
  find("jobs-list").replaceChildren(...found.map(keptCardOf));
  find("jobs-none").hidden = found.length > 0;
  find("jobs-none").textContent = shown.length || find("jobs-status").value ? "No job matches." : "What you have made will be listed here.";
  find("jobs-tools").hidden = !shown.length && !find("jobs-status").value;
  find("jobs-more").hidden = !next;
}

async function fetchPage(after) {
  const status = find("jobs-status").value, query = new URLSearchParams({ limit: PAGE, ...(status && { status }), ...(after && { after }) });
  const { jobs } = await askJson(`/v1/jobs?${query}`);
  next = jobs.length === PAGE ? jobs.at(-1).id : null;
  return jobs;
}

async function more() {
  const after = next, page = await fetchPage(after);
  shown = [...shown, ...page.filter(({ id }) => shown.every((job) => job.id !== id))];
  draw();
}

// Fills a page with jobs that are called so, from as many pages of all as it takes.
async function search() {
  const asked = wanted();
  draw();
  while (asked && next && asked === wanted() && matching().length < PAGE) await more();
}

function trying(work) {
  return () => work().catch((error) => { find("news").textContent = error.message; });
}

export async function listJobs(given = actions) {
  actions = given;
  shown = await fetchPage(null);
  for (const key of cards.keys()) if (!shown.some(({ id }) => key.startsWith(id))) cards.delete(key);
  await search();
}

find("jobs-filter").addEventListener("input", trying(search));
find("jobs-status").addEventListener("change", trying(() => listJobs()));
find("jobs-more").addEventListener("click", trying(more));
