// SPDX-License-Identifier: GPL-3.0-or-later
// Opens the page and then a job in a real browser and prints, as JSON, what a person waits for: bytes and time of the page
// alone, to the first view, and to the result's first 50 000 points; the longest task of the page while it loads and while
// it turns; the time of a frame; the memory of the page, and of the processes that show it.
//
// Usage: node measure.js BROWSER URL_OF_A_JOB [PICTURE]
"use strict";
const { readFileSync } = require("node:fs");
const { run, settled, withBrowser } = require("./browser.js");

const FRAMES = 20, PREFIX = 50000, MARK = "the page that is measured";

// In the page, before anything of it runs.
function watch(mark, prefix) {
  performance.mark(mark);
  globalThis.tasks = [];
  new PerformanceObserver((list) => globalThis.tasks.push(...list.getEntries().map((e) => [Math.round(e.startTime), Math.round(e.duration)])))
    .observe({ type: "longtask", buffered: true });
  const sofar = () => {
    const entries = [...performance.getEntriesByType("navigation"), ...performance.getEntriesByType("resource")];
    const sum = (some) => some.reduce((bytes, { transferSize }) => bytes + transferSize, 0);
    return { ms: Math.round(performance.now()), bytes: sum(entries), of_result: sum(entries.filter(({ name }) => /outputs\/cloud\.ply/.test(name))) };
  };
  const look = () => {
    const layers = globalThis.whittled?.drawn()?.layers ?? [], after = layers[1];
    if (layers.some((layer) => layer && (layer.shown || layer.triangles))) globalThis.first ??= sofar();
    if (after && (after.triangles || after.shown >= Math.min(prefix, after.count))) globalThis.prefix = sofar();
    else setTimeout(look, 1);
  };
  look();
}

// The page before any cloud is asked for: milliseconds until something is seen, and bytes.
async function pageAlone(browser, url) {
  const page = await browser.newPage();
  await page.setCacheEnabled(false);
  await page.goto(url, { waitUntil: "networkidle0" });
  const seen = await page.evaluate(() => ({ ms: Math.round(performance.getEntriesByName("first-contentful-paint")[0].startTime),
    bytes: [...performance.getEntriesByType("navigation"), ...performance.getEntriesByType("resource")].reduce((sum, { transferSize }) => sum + transferSize, 0) }));
  await page.close();
  return seen;
}

// Bytes of memory: what the page's scripts hold, and what the processes that show it occupy (what they share with others
// is shared out; null where the system doesn't tell).
async function memory(session, system) {
  const { usedSize, backingStorageSize = 0 } = await session.send("Runtime.getHeapUsage"), { processInfo } = await system.send("SystemInfo.getProcessInfo");
  const occupied = (kind) => Math.max(...processInfo.filter(({ type }) => type === kind).map(({ id }) => {
    try {
      return 1024 * Number(/^Pss:\s+(\d+)/m.exec(readFileSync(`/proc/${id}/smaps_rollup`, "ascii"))[1]);
    } catch {
      return 0;
    }
  })) || null;
  return { scripts: usedSize, arrays: backingStorageSize, renderer: occupied("renderer"), GPU: occupied("GPU") };
}

// Milliseconds of processor that the page's own thread took for each of its tasks, the longest first: what the machine
// does beside it doesn't count, nor what the browser's own window does, which is pages as well.
function processorTimes(events) {
  const main = new Set(events.filter((e) => e.name === MARK).map((e) => `${e.pid}/${e.tid}`));
  if (main.size !== 1) throw new Error(`the page's thread isn't known: ${[...main]}`);
  return events.filter((e) => e.ph === "X" && /RunTask$/.test(e.name) && main.has(`${e.pid}/${e.tid}`))
    .map((e) => Math.round((e.tdur ?? e.dur) / 1000)).sort((a, b) => b - a);
}

// Seconds of processor of the browser's processes so far: those that draw (without a graphics processor), and pages.
async function processors(session) {
  const { processInfo } = await session.send("SystemInfo.getProcessInfo"), spent = { GPU: 0, renderer: 0 };
  for (const { type, cpuTime } of processInfo) if (type in spent) spent[type] += cpuTime;
  return spent;
}

async function measure(browser, url, picture) {
  const alone = await pageAlone(browser, new URL("../", url).href);
  const page = await browser.newPage(), bytes = { all: 0 };
  page.setDefaultTimeout(300000);
  await page.setCacheEnabled(false);
  await page.evaluateOnNewDocument(watch, MARK, PREFIX);
  await page.setViewport({ width: 1600, height: 900 });
  const session = await page.createCDPSession();
  await session.send("Network.enable");
  session.on("Network.loadingFinished", ({ encodedDataLength }) => { bytes.all += encodedDataLength; });
  await page.tracing.start({ categories: ["toplevel", "devtools.timeline", "blink.user_timing"] });
  const began = Date.now();
  await page.goto(url, { waitUntil: "domcontentloaded" });
  await page.waitForFunction(() => globalThis.prefix);
  const [first, prefix] = await page.evaluate(() => [globalThis.first, globalThis.prefix]);
  await page.waitForFunction(() => document.documentElement.dataset.looking);
  const loaded = Date.now() - began;
  await settled(page);
  const whileLoading = await page.evaluate(() => globalThis.tasks.splice(0));
  const busy = processorTimes(JSON.parse(Buffer.from(await page.tracing.stop()).toString()).traceEvents);
  await page.focus("#look-canvas");
  const system = await browser.target().createCDPSession(), before = await processors(system);
  const turning = await page.evaluate(async (frames) => {
    const times = [], canvas = document.getElementById("look-canvas");
    for (let i = 0; i < frames; i++) {
      const at = performance.now(), before = whittled.drawn().frames;
      canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft", bubbles: true }));
      while (whittled.drawn().frames === before) await new Promise(requestAnimationFrame);
      times.push(performance.now() - at);
    }
    return times.sort((a, b) => a - b);
  }, FRAMES);
  const stopped = Date.now(), spent = await processors(system);
  await page.waitForFunction(() => !whittled.drawn().busy);
  const whole = Date.now() - stopped, whileTurning = await page.evaluate(() => globalThis.tasks.splice(0));
  const held = await memory(session, system);
  if (picture) await page.screenshot({ path: picture });
  const { layers } = await page.evaluate(() => whittled.drawn());
  return { page_ms: alone.ms, page_bytes: alone.bytes, first_view_ms: first.ms, first_view_bytes: first.bytes, prefix_ms: prefix.ms, prefix_bytes: prefix.bytes,
    prefix_bytes_of_result: prefix.of_result, loaded_ms: loaded, bytes: bytes.all,
    longest_task_processor_ms: busy[0] ?? 0, tasks_by_processor_ms: busy.slice(0, 8), longest_task_ms: Math.max(0, ...whileLoading.map(([, ms]) => ms)), tasks_over_100_ms: whileLoading.filter(([, ms]) => ms > 100),
    frame_ms: { median: Math.round(turning[FRAMES >> 1]), most: Math.round(turning.at(-1)) },
    frame_processor_ms: Object.fromEntries(Object.keys(spent).map((type) => [type, Math.round(1000 * (spent[type] - before[type]) / FRAMES)])), all_drawn_ms: whole,
    longest_task_while_turning_ms: Math.max(0, ...whileTurning.map(([, ms]) => ms)),
    memory_bytes: held, layers };
}

async function main([executablePath, url, picture]) {
  await withBrowser(executablePath, async (browser) => console.log(JSON.stringify(await measure(browser, url, picture), null, 1)));
}

run(main);
