// SPDX-License-Identifier: GPL-3.0-or-later
// The page's parts, one after the other: drop, choose, follow, look, read; and the jobs to come back to.
import { askJson, base, events, sendJson, ask, setToken, token } from "./api.js";
import { choose, chosen } from "./choose.js";
import { listJobs } from "./jobs.js";
import { read } from "./read.js";
import { bytes, find, seconds, show } from "./words.js";

const PARTS = ["drop", "choose", "follow", "look", "read", "jobs"];
let cloud = null, job = null, stop = null, looking = null;

function say(text) {
  find("news").textContent = text ?? "";
}

function parts(...visible) {
  for (const part of PARTS) show(part, visible.includes(part));
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
  stop = new AbortController();
  const began = performance.now(), { upload, reasonOf } = await import("./upload.js");
  show("drop-zone", false);
  show("sending", true);
  find("sending-name").textContent = file.name;
  try {
    const id = await upload(file, (sent, all) => {
      const speed = sent / Math.max((performance.now() - began) / 1000, 0.001);
      find("sending-bar").value = all ? sent / all : 1;
      find("sending-text").textContent = `${bytes(sent)} of ${bytes(all)}, ${bytes(speed)}/s`;
    }, stop.signal);
    await openCloud(id, file.name);
  } catch (error) {
    const { status, text } = reasonOf(error);
    if (status === 401) document.dispatchEvent(new CustomEvent("token-wanted"));
    else if (!stop.signal.aborted) say(`${file.name}: ${text}`);
  } finally {
    show("sending", false);
    show("drop-zone", true);
    find("drop-file").value = "";
  }
}

// A surface with features of several sizes, made here: a knot whose tube has grooves.
function example() {
  const lines = ["ply", "format ascii 1.0", "element vertex 60000", "property float x", "property float y", "property float z",
    "property uchar red", "property uchar green", "property uchar blue", "end_header"];
  for (let i = 0; i < 60000; i++) {
    const u = 2 * Math.PI * ((i * 0.618033988749895) % 1), t = 2 * Math.PI * i / 60000;
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
  find("choose-title").scrollIntoView();
  find("goal-slider").focus({ preventScroll: true });
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

function tell(news) {
  const { ahead, stage, status, estimate } = news, left = estimate?.seconds_left;
  const doing = status === "accepted" ? `Waiting${ahead ? `, ${ahead} ahead` : ""}` : `${stage ?? "starting"}, ${news.progress} %`;
  find("follow-text").textContent = left > 0 ? `${doing}, about ${seconds(left)} left` : doing;
  find("follow-bar").value = news.progress ?? 0;
}

const hasEnded = (status) => ["successful", "failed", "dismissed"].includes(status);

async function follow() {
  stop?.abort();
  const mine = stop = new AbortController();
  parts("follow");
  tell({ ...job, ahead: job.queue.ahead });
  while (!hasEnded(job.status) && !mine.signal.aborted) {
    for await (const news of events(job.id, mine.signal)) if (news.status) tell(news);
    job = await askJson(`/v1/jobs/${job.id}`);
  }
}

/* ---------------------------------------------------------------------------------------------------- look, read */

async function showPicture(outputs) {
  const picture = outputs.find((output) => output.name === "preview.png");
  show("look-canvas", false);
  show("look-tools", false);
  show("look-none", true);
  show("look-picture", Boolean(picture));
  if (picture) find("look-picture").src = URL.createObjectURL(await (await ask(picture.href)).blob());
}

async function openJob(id) {
  if (location.pathname !== `${base}/jobs/${id}`) history.pushState(null, "", `${base}/jobs/${id}`);
  job = await askJson(`/v1/jobs/${id}`);
  document.title = `${job.label || id.slice(0, 8)} · whittled`;
  if (!hasEnded(job.status)) await follow();
  if (!hasEnded(job.status)) return;
  if (job.status !== "successful") {
    parts("drop", "jobs");
    await listJobs(actions);
    say(`${job.label || "The job"} ${job.status}: ${job.problem?.detail ?? job.problem?.title ?? "no reason given"}`);
    return;
  }
  const { outputs } = await askJson(`/v1/jobs/${id}/outputs`);
  find("look-title").textContent = job.label || `Job ${id.slice(-6)}`;
  read(job, outputs);
  parts("look", "read");
  try {
    looking ??= await import("./look.js");
    await looking.look(job, outputs);
    document.documentElement.dataset.looking = id;
  } catch (error) {
    console.warn(error.message);
    await showPicture(outputs);
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
  if (!confirm(`Delete ${which.label || "this job"} and its files?`)) return;
  await ask(`/v1/jobs/${which.id}`, { method: "DELETE" });
  if (location.pathname !== `${base}/`) history.pushState(null, "", `${base}/`);
  await home();
}

const again = (which) => openCloud(which.input.sha256, which.label, which.params);
const actions = { open: (id) => trying(() => openJob(id)), again: (which) => trying(() => again(which)), remove: (which) => trying(() => remove(which)) };

function route() {
  const id = /\/jobs\/([0-9a-f-]{36})$/.exec(location.pathname)?.[1];
  return trying(() => (id ? openJob(id) : home()));
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
    if (kind === "drop" && event.dataTransfer?.files.length && !find("drop").hidden) trying(() => send(event.dataTransfer.files[0]));
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
on("read-again", "click", () => again(job));
on("read-delete", "click", () => remove(job));
on("home", "click", () => {
  history.pushState(null, "", `${base}/`);
  return home();
});
on("token-open", "click", () => {
  show("token", find("token").hidden);
  find("token-value").focus();
});
on("token-form", "submit", () => {
  setToken(find("token-value").value.trim());
  find("token-value").value = "";
  show("token", false);
  return route();
});
on("token-drop", "click", () => {
  setToken("");
  show("token", false);
  return route();
});
document.addEventListener("token-wanted", () => {
  find("token-title").textContent = token() ? "The service doesn't take this token" : "A token is needed";
  show("token", true);
  find("token-value").focus();
});
addEventListener("popstate", route);
globalThis.whittled = { drawn: () => looking?.drawn() }; // for tests
route();
