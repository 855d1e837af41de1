// SPDX-License-Identifier: GPL-3.0-or-later
// Goes the whole way through the page in a real browser, from a file to its result and back to the list, and prints what
// it saw as JSON: requests, console, counts, violations that axe found.  Pictures go into a folder.
//
// Usage: node walk.js BROWSER URL CLOUD FOLDER [TOKEN]
"use strict";
const { join } = require("node:path");
const axe = require("axe-core").source;
const { run, settled: settle, watchedPage, withBrowser } = require("./browser.js");

const WIDTHS = [360, 800, 1600];

async function walk(page, [url, cloud, folder, token], seen) {
  const settled = () => settle(page);
  const drawn = () => page.evaluate(() => whittled.drawn());
  const text = (id) => page.$eval(`#${id}`, (element) => element.textContent);
  const ready = (selector) => page.waitForSelector(selector, { visible: true });

  async function look(part) {
    for (const width of WIDTHS) {
      await page.setViewport({ width, height: 900 });
      await settled();
      const fit = await page.evaluate(() => [document.documentElement.scrollWidth, document.documentElement.clientWidth]);
      seen.fits.push([part, width, ...fit]);
      seen.fits.push(...await page.$$eval(".scrolls", (all, ...where) => all.map((each) => [...where, each.scrollWidth, each.clientWidth]), `${part}, a table`, width));
      await page.screenshot({ path: join(folder, `${part}-${width}.png`), fullPage: true });
    }
    await settled();
    await page.evaluate(`if (!globalThis.axe) { ${axe} }`);
    seen.violations[part] = await page.evaluate(async () => {
      const { violations } = await axe.run();
      return violations.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.html.slice(0, 90)).join(" | ")}`);
    });
  }

  const opened = Date.now();
  await page.goto(url, { waitUntil: "networkidle0" });
  if (token) {
    await ready("#token-value");
    await look("token");
    await page.type("#token-value", token);
    await page.keyboard.press("Enter");
    await page.waitForSelector("#token", { hidden: true });
  }
  await ready("#jobs-none");
  seen.first = await page.evaluate(() => ({
    bytes: performance.getEntriesByType("resource").concat(performance.getEntriesByType("navigation"))
      .reduce((sum, entry) => sum + entry.encodedBodySize, 0),
    painted: performance.getEntriesByName("first-contentful-paint")[0]?.startTime,
  }));
  seen.first.ms = Date.now() - opened;
  seen.protocols = await page.evaluate(() => performance.getEntriesByType("resource").map((entry) => entry.nextHopProtocol));
  await look("drop");

  const input = await page.$("#drop-file");
  await input.uploadFile(cloud);
  await ready("#choose-start");
  seen.facts = await page.$eval("#cloud-facts", (element) => element.innerText);
  await look("choose");
  await page.focus("#goal-slider");
  await page.keyboard.press("Home");
  seen.least = await text("goal-text");
  await page.$eval("#goal-slider", (slider) => {
    slider.value = 230;
    slider.dispatchEvent(new Event("input", { bubbles: true }));
  });
  seen.goal = await text("goal-text");
  seen.command = await text("choose-curl");
  await page.waitForFunction(() => document.getElementById("choose-plan").textContent);
  seen.plan = await text("choose-plan");
  await page.click("#choose-start");
  await page.waitForFunction(() => document.documentElement.dataset.looking, { timeout: 0 });
  seen.address = page.url();
  seen.shown = await drawn();
  seen.figures = await page.$eval("#read-table", (element) => element.innerText);
  await look("look");

  const stage = await page.$("#look-canvas");
  await page.select("#look-layout", "side");
  await settled();
  await stage.screenshot({ captureBeyondViewport: false, path: join(folder, "side.png") });
  await page.select("#look-after", "cloud");
  await page.waitForFunction(() => whittled.drawn().layers[1]?.count);
  seen.levels = [];
  for (const value of [0, 500, 1000]) {
    await page.$eval("#look-level", (slider, to) => {
      slider.value = to;
      slider.dispatchEvent(new Event("input", { bubbles: true }));
    }, value);
    const wanted = Math.max(1, Math.round((await drawn()).layers[1].count * 10 ** (3 * (value / 1000 - 1))));
    await page.waitForFunction((n) => whittled.drawn().layers[1].shown === n, {}, wanted);
    seen.levels.push([wanted, (await drawn()).layers[1].shown, await text("level-text")]);
  }
  await stage.screenshot({ captureBeyondViewport: false, path: join(folder, "cloud.png") });
  const before = (await drawn()).frames;
  await stage.focus();
  for (const key of ["ArrowLeft", "ArrowUp", "+"]) await page.keyboard.press(key);
  await page.waitForFunction((frames) => whittled.drawn().frames > frames, {}, before);
  await settled();
  await stage.screenshot({ captureBeyondViewport: false, path: join(folder, "turned.png") });
  await page.keyboard.press("Home");
  await page.select("#look-layout", "after");
  await page.click("#look-measure");
  await stage.scrollIntoView();
  await settled();
  const box = await stage.boundingBox();
  for (let i = 0; i < 120 && !/between/.test(seen.measured); i++) { // along lines, until two places had something
    await page.mouse.click(box.x + (0.3 + 0.4 * (i % 12) / 11) * box.width, box.y + (0.3 + 0.04 * Math.floor(i / 12)) * box.height);
    seen.measured = await text("measure-text");
  }
  await page.click("#look-measure");
  await page.click("#look-box");
  seen.box = await text("measure-text");

  await page.goto(seen.address, { waitUntil: "networkidle0" }); // a job's own address
  await page.waitForFunction(() => document.documentElement.dataset.looking);
  await page.click("#read-again");
  await ready("#choose-start");
  seen.again = await text("goal-text");
  await page.click("#home");
  await page.waitForFunction(() => document.querySelector(".card img")?.naturalWidth > 0);
  seen.cards = await page.$$eval(".card", (cards) => cards.map((card) => card.innerText));
  await look("jobs");
  await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: "dark" }]);
  await look("dark");
  page.on("dialog", (dialog) => dialog.accept());
  await page.click(".card button[aria-label^=Delete]");
  await page.waitForSelector(".card", { hidden: true });
}

async function main([executablePath, ...rest]) {
  const seen = { requests: [], console: [], errors: [], fits: [], violations: {} };
  try {
    await withBrowser(executablePath, async (browser) => walk(await watchedPage(browser, seen), rest, seen));
  } finally {
    console.log(JSON.stringify(seen));
  }
}

run(main);
