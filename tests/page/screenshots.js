// SPDX-License-Identifier: GPL-3.0-or-later
// Takes pictures of every part of the page, dark and light, at three widths: PART-WIDTH-THEME.png.
//
// Usage: node screenshots.js BROWSER URL FOLDER CLOUD [LONG_CLOUD]
// LONG_CLOUD is one whose job takes long enough to be looked at while it runs.
"use strict";
const { join } = require("node:path");
const { run, settled, withBrowser } = require("./browser.js");

const WIDTHS = [360, 800, 1600], THEMES = ["light", "dark"];

async function shoot(page, folder, part, whole = true) {
  for (const theme of THEMES) {
    await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: theme }]);
    for (const width of WIDTHS) {
      await page.setViewport({ width, height: width < 500 ? 780 : 900 });
      await settled(page);
      await page.screenshot({ path: join(folder, `${part}-${width}-${theme}.png`), fullPage: whole });
    }
  }
  await page.setViewport({ width: 1600, height: 900 });
}

const looked = (page) => page.waitForFunction(() => document.documentElement.dataset.looking);

async function upload(page, cloud) {
  await (await page.$("#drop-file")).uploadFile(cloud);
  await page.waitForSelector("#choose-start", { visible: true });
  await page.waitForFunction(() => document.getElementById("choose-plan").textContent);
}

async function look(page, folder) {
  await shoot(page, folder, "look");
  for (const [name, changes] of Object.entries({
    swipe: { layout: "swipe" }, points: { layout: "side", after: "cloud" }, wire: { after: "mesh", mesh: "wireframe" } })) {
    for (const [id, value] of Object.entries(changes)) await page.select(`#look-${id}`, value);
    await page.waitForNetworkIdle({ idleTime: 300 });
    await shoot(page, folder, name);
  }
}

async function main([browserPath, url, folder, cloud, long]) {
  await withBrowser(browserPath, async (browser) => {
    const page = await browser.newPage();
    page.setDefaultTimeout(300000);
    await page.setViewport({ width: 1600, height: 900 });
    await page.goto(url, { waitUntil: "networkidle0" });
    await shoot(page, folder, "drop");
    await upload(page, cloud);
    await shoot(page, folder, "choose");
    await page.$$eval("#choose details", (all) => all.forEach((each) => { each.open = true; }));
    await shoot(page, folder, "choose-all");
    await page.click("#choose-start");
    await looked(page);
    await look(page, folder);
    const job = page.url();
    if (long) {
      await page.goto(url, { waitUntil: "networkidle0" });
      await upload(page, long);
      await page.click("#choose-start");
      await page.waitForSelector("#follow-text", { visible: true });
      await shoot(page, folder, "follow");
      await looked(page);
      await shoot(page, folder, "look-long");
    }
    await page.goto(url, { waitUntil: "networkidle0" });
    await page.waitForSelector(".card");
    await shoot(page, folder, "jobs");
    await page.goto(new URL("docs", url).href, { waitUntil: "networkidle0" });
    await shoot(page, folder, "docs", false);
    await page.goto(new URL("docs#createJob", url).href, { waitUntil: "networkidle0" });
    await shoot(page, folder, "operation", false);
    await page.goto(job, { waitUntil: "networkidle0" });
    await looked(page);
    await shoot(page, folder, "job", false);
  });
}

run(main);
