// SPDX-License-Identifier: GPL-3.0-or-later
// Opens a job in a real browser and prints, as JSON, what a person waits for: bytes and time to the first view, the longest
// task of the page while it loads and while it turns, the time of a frame, the memory of the page.
//
// Usage: node measure.js BROWSER URL_OF_A_JOB [PICTURE]
"use strict";
const { run, settled, withBrowser } = require("./browser.js");

const FRAMES = 20, MARK = "the page that is measured";

// In the page, before anything of it runs.
function watch(mark) {
  performance.mark(mark);
  globalThis.tasks = [];
  new PerformanceObserver((list) => globalThis.tasks.push(...list.getEntries().map((e) => [Math.round(e.startTime), Math.round(e.duration)])))
    .observe({ type: "longtask", buffered: true });
  const look = () => {
    if (!globalThis.whittled?.drawn()?.layers.some((layer) => layer && (layer.shown || layer.triangles))) {
      setTimeout(look, 1);
      return;
    }
    const entries = [...performance.getEntriesByType("resource"), ...performance.getEntriesByType("navigation")];
    globalThis.first = { ms: Math.round(performance.now()), bytes: entries.reduce((sum, entry) => sum + entry.transferSize, 0) };
  };
  look();
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
  const page = await browser.newPage(), bytes = { all: 0 };
  page.setDefaultTimeout(300000);
  await page.evaluateOnNewDocument(watch, MARK);
  await page.setViewport({ width: 1600, height: 900 });
  const session = await page.createCDPSession();
  await session.send("Network.enable");
  session.on("Network.loadingFinished", ({ encodedDataLength }) => { bytes.all += encodedDataLength; });
  await page.tracing.start({ categories: ["toplevel", "devtools.timeline", "blink.user_timing"] });
  const began = Date.now();
  await page.goto(url, { waitUntil: "domcontentloaded" });
  await page.waitForFunction(() => globalThis.first);
  const first = await page.evaluate(() => globalThis.first);
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
  const heap = await page.metrics();
  if (picture) await page.screenshot({ path: picture });
  const { layers } = await page.evaluate(() => whittled.drawn());
  return { first_view_ms: first.ms, first_view_bytes: first.bytes, loaded_ms: loaded, bytes: bytes.all,
    longest_task_processor_ms: busy[0] ?? 0, tasks_by_processor_ms: busy.slice(0, 8), longest_task_ms: Math.max(0, ...whileLoading.map(([, ms]) => ms)), tasks_over_100_ms: whileLoading.filter(([, ms]) => ms > 100),
    frame_ms: { median: Math.round(turning[FRAMES >> 1]), most: Math.round(turning.at(-1)) },
    frame_processor_ms: Object.fromEntries(Object.keys(spent).map((type) => [type, Math.round(1000 * (spent[type] - before[type]) / FRAMES)])), all_drawn_ms: whole,
    longest_task_while_turning_ms: Math.max(0, ...whileTurning.map(([, ms]) => ms)),
    heap_bytes: heap.JSHeapUsedSize, layers };
}

async function main([executablePath, url, picture]) {
  await withBrowser(executablePath, async (browser) => console.log(JSON.stringify(await measure(browser, url, picture), null, 1)));
}

run(main);
