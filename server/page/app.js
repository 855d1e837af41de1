// SPDX-License-Identifier: GPL-3.0-or-later
// The page's parts, one after the other: drop, choose, follow, look, read; and the jobs to come back to.
import { adviceOn, ask, askJson, base, events, isOfColumns, sendJson, setToken, token, Unreachable } from "./api.js";
import { choose, chosen } from "./choose.js";
import { listJobs } from "./jobs.js";
import { read } from "./read.js";
import { bytes, count, find, isolated, make, nameOf, seconds, sentence, show } from "./words.js";

const PARTS = ["drop", "choose", "follow", "ended", "look", "read", "jobs"];
const PAUSE_MS = 2000, PLACE_MS = 3000; // before a service that doesn't answer is asked again; before a place in the queue is
let cloud = null, job = null, stop = null, looking = null, turns = 0;

function say(text) {
  find("news").textContent = text ?? "";
}

function parts(...visible) {
  for (const part of PARTS) show(part, visible.includes(part));
}

// Brings a part into view, for eyes, keys and screen readers.
function lead(id) {
  find(id).scrollIntoView({ block: "nearest" });
  find(id).focus({ preventScroll: true });
}

// Whatever fails is said at the top of the page.
async function trying(work) {
  try {
    say("");
    await work();
  } catch (error) {
    if (error.name === "AbortError") return;
    if (error.status !== 401) say(error.message);
    if (!("status" in error)) console.warn(error.message);
  }
}

/* ---------------------------------------------------------------------------------------------------- drop */

async function send(file) {
  stop?.abort();
  if (!file.size) {
    find("drop-file").value = "";
    throw new Error(`${isolated(file.name)}: the file is empty.`);
  }
  stop = new AbortController();
  const began = performance.now(), { upload, reasonOf } = await import("./upload.js");
  show("drop-zone", false);
  show("sending", true);
  find("sending-name").textContent = file.name;
  try {
    const id = await upload(file, { progress: (sent, all) => {
      const speed = sent / Math.max((performance.now() - began) / 1000, 0.001);
      find("sending-bar").value = all ? sent / all : 1;
      find("sending-text").textContent = `${bytes(sent)} of ${bytes(all)}, ${bytes(speed)}/s`;
      if (find("sending").dataset.broken) say("");
      delete find("sending").dataset.broken;
    }, broken: () => {
      find("sending").dataset.broken = true;
      say("The connection is lost. The upload goes on by itself, where it was, as soon as the service answers.");
    } }, stop.signal);
    say("");
    await openCloud(id, file.name);
  } catch (error) {
    const { status, text } = reasonOf(error);
    if (status === 401) document.dispatchEvent(new CustomEvent("token-wanted"));
    else if (!stop.signal.aborted) say(`${isolated(file.name)}: ${text}`);
    else say("");
  } finally {
    delete find("sending").dataset.broken;
    show("sending", false);
    show("drop-zone", true);
    find("drop-file").value = "";
  }
}

// What is dropped, wherever on the page: also while something else is looked at.
async function sendDropped([file, ...others]) {
  if (others.length) throw new Error(`Drop one file at a time; these were ${others.length + 1}.`);
  if (find("drop").hidden) {
    history.pushState(null, "", `${base}/`);
    await home();
  }
  await send(file);
}

// A surface with features of several sizes, made here: a knot whose tube has grooves.
function example() {
  const lines = ["ply", "format ascii 1.0", "element vertex 30000", "property float x", "property float y", "property float z",
    "property uchar red", "property uchar green", "property uchar blue", "end_header"];
  for (let i = 0; i < 30000; i++) {
    const u = 2 * Math.PI * ((i * 0.618033988749895) % 1), t = 2 * Math.PI * i / 30000;
    const around = (s) => [Math.sin(s) + 2 * Math.sin(2 * s), Math.cos(s) - 2 * Math.cos(2 * s), -Math.sin(3 * s)];
    const here = around(t), ahead = around(t + 1e-4), along = here.map((c, k) => ahead[k] - c), length = Math.hypot(...along);
    const d = along.map((c) => c / length), side = [d[1], -d[0], 0], wide = Math.hypot(...side), n = side.map((c) => c / wide);
    const m = [d[1] * n[2] - d[2] * n[1], d[2] * n[0] - d[0] * n[2], d[0] * n[1] - d[1] * n[0]];
    const r = 0.45 + 0.035 * Math.sin(6 * u + 24 * t) + (Math.sin(18 * t) > 0.9 ? 0.05 : 0);
    const p = here.map((c, k) => c + r * (Math.cos(u) * n[k] + Math.sin(u) * m[k]));
    const shade = [150 + 60 * Math.sin(t), 140 + 50 * Math.cos(2 * t), 120 + 60 * Math.cos(t)].map(Math.round);
    lines.push([...p.map((c) => c.toFixed(5)), ...shade].join(" "));
  }
  return new File([lines.join("\n"), "\n"], "example.ply");
}

/* ---------------------------------------------------------------------------------------------------- choose */

async function openCloud(id, label, params) {
  cloud = { ...await askJson(`/v1/clouds/${id}`), label };
  await choose(cloud, params);
  history.pushState(null, "", `${base}/`);
  parts("choose");
  lead("choose-title");
}

async function start() {
  find("choose-start").disabled = true;
  try {
    const made = await sendJson("/v1/jobs", { input: `/v1/clouds/${cloud.id}`, params: chosen(), label: cloud.label?.slice(0, 128) });
    await openJob(made.id);
  } finally {
    find("choose-start").disabled = false;
  }
}

/* ---------------------------------------------------------------------------------------------------- follow */

// What the stages do, as core/pipeline/pipeline.c has them.
const STAGES = { read: "reading the file", order: "putting the points in order", denoise: "taking noise away", neighbours: "finding each point's neighbours",
  normals: "fitting a plane to each point's neighbours", sides: "finding out which side is outside", dso: "measuring how the surface bends", quadrics: "weighing each point",
  contract: "ranking the points", space: "keeping points apart", search: "searching for the fewest points", keep: "keeping the first points",
  local_delaunay: "triangulating around each point", tangent: "measuring the cloud's deviation", delaunay: "triangulating",
  reconstruct: "finding the surface", refine: "fitting the mesh to the points", holes: "closing holes", examine: "examining the mesh",
  measure: "measuring the mesh's deviation", verify: "checking the bound", distances: "measuring every point", write: "writing the files" };
let stages = [], waits = false;

function tell(news) {
  const { ahead, stage, status, estimate } = news;
  waits = status === "accepted";
  const left = estimate?.seconds_left, progress = news.progress ?? 0;
  if (stage && stages.at(-1) !== stage) stages = [...stages.filter((each) => each !== stage), stage];
  const doing = status === "accepted" ? (ahead ? `Waiting: ${count(ahead)} ahead` : "Waiting for its turn") : `${progress} %`;
  find("follow-text").textContent = left > 0 ? `${doing}, about ${seconds(left)} left` : doing;
  find("follow-bar").value = progress;
  find("follow-bar").setAttribute("aria-valuetext", `${progress} %${stage ? `, ${STAGES[stage] ?? stage}` : ""}`);
  find("follow-stages").replaceChildren(...stages.map((each, i) => make("li", { "aria-current": i === stages.length - 1 && "step" }, STAGES[each] ?? each)));
}

// A place in the queue changes by what other jobs do, of which a job's own events tell nothing.
async function tellPlace(id, signal) {
  if (!waits) return;
  const now = await askJson(`/v1/jobs/${id}`, { signal, cache: "no-store" }); // its tag is that of the job, not of the queue
  if (waits && now.status === "accepted") tell({ ...now, ahead: now.queue.ahead });
}

const hasEnded = (status) => ["successful", "failed", "dismissed"].includes(status);

async function follow() {
  stop?.abort();
  const mine = stop = new AbortController();
  stages = [];
  parts("follow");
  find("follow-title").textContent = job.label ? `Simplifying ${isolated(job.label)}` : "Simplifying";
  lead("follow-title");
  tell({ ...job, ahead: job.queue.ahead });
  const places = setInterval(() => tellPlace(job.id, mine.signal).catch(() => {}), PLACE_MS); // one that fails is asked for again
  try {
    await followEvents(mine);
  } finally {
    clearInterval(places);
  }
}

// Tells a job's events until it has ended, from a service that may be away for a while.
async function followEvents(mine) {
  for (let lost = false; !hasEnded(job.status) && !mine.signal.aborted;) {
    try {
      for await (const news of events(job.id, mine.signal)) if (news.status) tell(news);
      job = await askJson(`/v1/jobs/${job.id}`);
      if (lost) say("");
      lost = false;
    } catch (error) {
      if (mine.signal.aborted || "status" in error) throw error; // streams that break off have errors of several kinds
      lost = true;
      say(`${new Unreachable().message} The job is not lost by that; this page goes on by itself.`);
      await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
    }
  }
}

/* ---------------------------------------------------------------------------------------------------- look, read */

async function showPicture(outputs, why) {
  const picture = outputs.find((output) => output.name === "preview.png");
  show("look-canvas", false);
  show("look-tools", false);
  show("look-none", true);
  find("look-none").textContent = `${/WebGL/.test(why) ? "This browser has no WebGL." : sentence(why)}${picture ? " The picture shows the result." : ""}`;
  show("look-picture", Boolean(picture));
  if (picture) find("look-picture").src = URL.createObjectURL(await (await ask(picture.href)).blob());
}

// A job that has no result: why, and what can be done.
async function showEnd() {
  const { status, problem } = job, name = isolated(nameOf(job));
  parts("ended");
  find("ended-title").textContent = status === "dismissed" ? `${name} was cancelled` : `${name} has failed`;
  find("ended-text").textContent = status === "dismissed" ? "It has no result. The file is still here for other jobs."
    : `${problem?.title ?? "No reason was given"}${problem?.detail ? `: ${problem.detail}` : ""}${problem?.line ? ` (line ${problem.line})` : ""}.`;
  find("ended-advice").textContent = [problem?.hint, adviceOn(problem)].filter(Boolean).join(". ");
  show("ended-more", false);
  lead("ended-title");
  if (status === "dismissed") return;
  find("ended-log").textContent = await (await ask(`/v1/jobs/${job.id}/log`)).text();
  show("ended-more", Boolean(find("ended-log").textContent));
}

async function openJob(id) {
  if (location.pathname !== `${base}/jobs/${id}`) history.pushState(null, "", `${base}/jobs/${id}`);
  job = await askJson(`/v1/jobs/${id}`);
  document.title = `${nameOf(job)} · whittled`;
  if (!hasEnded(job.status)) await follow();
  if (!hasEnded(job.status)) return;
  if (job.status !== "successful") return showEnd();
  const { outputs } = await askJson(`/v1/jobs/${id}/outputs`);
  find("look-title").textContent = nameOf(job);
  read(job, outputs);
  parts("look", "read");
  for (const part of ["look-canvas", "look-tools"]) show(part, true);
  for (const part of ["look-none", "look-picture"]) show(part, false);
  lead("look-title");
  try {
    looking ??= await import("./look.js");
    await looking.look(job, outputs);
    document.documentElement.dataset.looking = id;
  } catch (error) {
    if ("status" in error || error instanceof Unreachable) throw error;
    console.warn(error.message);
    await showPicture(outputs, error.message);
  }
}

async function home() {
  stop?.abort();
  looking?.leave();
  delete document.documentElement.dataset.looking;
  document.title = "whittled";
  parts("drop", "jobs");
  await listJobs(actions);
}

async function remove(which) {
  if (!confirm(`Delete ${which.label ? isolated(which.label) : "this job"} and its files?`)) return;
  await ask(`/v1/jobs/${which.id}`, { method: "DELETE" });
  if (location.pathname !== `${base}/`) history.pushState(null, "", `${base}/`);
  await home();
}

async function again(which) {
  await openCloud(which.input.sha256, which.label, which.params);
  if (isOfColumns(which.problem)) find("param-columns").focus();
}
const actions = { open: (id) => trying(() => openJob(id)), again: (which) => trying(() => again(which)), remove: (which) => trying(() => remove(which)) };

// Opens what the address says; from a service that is away, when it is back.
function route() {
  const { pathname } = location, id = /\/jobs\/([0-9a-f-]{36})$/.exec(pathname)?.[1], turn = ++turns;
  return trying(async () => {
    try {
      await (id ? openJob(id) : home());
    } catch (error) {
      if (!(error instanceof Unreachable)) throw error;
      setTimeout(() => turn === turns && pathname === location.pathname && route(), PAUSE_MS);
      throw new Error(`${error.message} This page tries again by itself.`);
    }
  });
}

/* ---------------------------------------------------------------------------------------------------- events */

function on(id, kind, work) {
  find(id).addEventListener(kind, (event) => {
    event.preventDefault();
    trying(() => work(event));
  });
}

const zone = find("drop-zone");
for (const kind of ["dragover", "dragleave", "drop"]) {
  document.addEventListener(kind, (event) => {
    event.preventDefault();
    zone.classList.toggle("over", kind === "dragover");
    if (kind === "drop" && event.dataTransfer?.files.length) trying(() => sendDropped([...event.dataTransfer.files]));
  });
}
find("drop-file").addEventListener("change", ({ target }) => target.files.length && trying(() => send(target.files[0])));
on("drop-example", "click", () => send(example()));
on("sending-stop", "click", () => stop.abort());
on("choose-form", "submit", start);
on("choose-back", "click", home);
on("follow-cancel", "click", async () => {
  await ask(`/v1/jobs/${job.id}`, { method: "DELETE" });
});
for (const part of ["read", "ended"]) {
  on(`${part}-again`, "click", () => again(job));
  on(`${part}-delete`, "click", () => remove(job));
}
for (const id of ["home", "ended-home"]) {
  on(id, "click", () => {
    history.pushState(null, "", `${base}/`);
    return route();
  });
}
on("token-open", "click", () => {
  show("token", find("token").hidden);
  find("token-value").focus();
});
on("token-form", "submit", () => {
  setToken(find("token-value").value.trim());
  find("token-value").value = "";
  show("token", false);
  show("token-open", Boolean(token()));
  if (find("choose").hidden) return route();
  find("choose-form").dispatchEvent(new Event("input")); // what is chosen stays, and is planned again
  return null;
});
on("token-drop", "click", () => {
  setToken("");
  show("token", false);
  return route();
});
document.addEventListener("token-wanted", () => {
  find("token-title").textContent = token() ? "The service doesn't take this token" : "A token is needed";
  show("token", true);
  show("token-open", true);
  find("token-value").focus();
});
addEventListener("popstate", route);
show("token-open", Boolean(token()));
globalThis.whittled = { drawn: () => looking?.drawn() }; // for tests
route();
