// SPDX-License-Identifier: GPL-3.0-or-later
// Debian's chromium without a graphics processor, with a profile of its own, and without a way to other hosts.
"use strict";
const { mkdtempSync, rmSync } = require("node:fs");
const { tmpdir } = require("node:os");
const { join } = require("node:path");
const puppeteer = require("puppeteer-core");

const FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
  "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
  "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"];

// Calls work(browser) and ends the browser after it, whatever happens; BROWSER_FLAGS are flags beside the usual ones.
async function withBrowser(executablePath, work) {
  const more = (process.env.BROWSER_FLAGS ?? "").split(" ").filter(Boolean);
  const profile = mkdtempSync(join(tmpdir(), "page-"));
  const browser = await puppeteer.launch({ executablePath, userDataDir: profile, args: [...FLAGS, ...more], protocolTimeout: 600000 });
  try {
    return await work(browser);
  } finally {
    await browser.close();
    rmSync(profile, { recursive: true, force: true });
  }
}

// A page whose requests, console, errors go into `seen`.
async function watchedPage(browser, seen) {
  const page = await browser.newPage();
  page.setDefaultTimeout(Number(process.env.PATIENCE_MS ?? 180000));
  await page.setViewport({ width: 1600, height: 900 });
  page.on("request", (request) => seen.requests.push(request.url()));
  page.on("console", (message) => seen.console.push(`${message.type()}: ${message.text()}`));
  page.on("pageerror", (error) => seen.errors.push(String(error)));
  page.on("requestfailed", (request) => seen.errors.push(`${request.url()}: ${request.failure().errorText}`));
  return page;
}

// Until two pictures were shown, and nothing more is to be drawn.
async function settled(page) {
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  await page.waitForFunction(() => !document.documentElement.dataset.looking || !whittled.drawn().busy);
}

// Runs main(arguments) and says what went wrong.
function run(main) {
  main(process.argv.slice(2)).catch((error) => {
    console.error(error.stack);
    process.exitCode = 1;
  });
}

module.exports = { withBrowser, watchedPage, settled, run };
