// SPDX-License-Identifier: GPL-3.0-or-later
// Opens a page in a real browser, as wide as said, and prints what happened as JSON: requests, console messages, errors,
// and how the page lies in the window.
//
// Usage: node docs_page.js BROWSER URL WIDTH SCREENSHOT
"use strict";
const puppeteer = require("puppeteer-core");

// Runs in the page.
function measure() {
  const root = document.documentElement;
  const texts = (selector) => [...document.querySelectorAll(selector)].map((element) => element.textContent);
  const wide = [...document.querySelectorAll("body *")].filter((element) => {
    const box = element.getBoundingClientRect();
    for (let up = element; up; up = up.parentElement) {
      if (["auto", "scroll"].includes(getComputedStyle(up).overflowX)) return false; // it scrolls by itself
    }
    return box.width > 0 && box.right > root.clientWidth + 1;
  });
  return {
    title: document.title,
    headings: texts("h1, h2, h3"),
    dead: [...document.querySelectorAll('a[href^="#"]')].map((a) => a.hash).filter((hash) =>
      !document.getElementById(hash.slice(1))),
    invisible: [...document.querySelectorAll("h1, h2, h3, p, td, pre")].filter((element) =>
      element.textContent.trim() && !element.closest("details:not([open])") && element.getClientRects().length === 0).length,
    fontPx: Math.min(...[...document.querySelectorAll("p, td, li, code")].map((element) =>
      parseFloat(getComputedStyle(element).fontSize))),
    clientWidth: root.clientWidth,
    scrollWidth: root.scrollWidth,
    cut: [...document.querySelectorAll("pre")].filter((each) => each.scrollWidth > each.clientWidth).map((each) => each.textContent),
    wide: wide.slice(0, 5).map((element) => element.outerHTML.slice(0, 120)),
  };
}

async function main([executablePath, url, width, screenshot]) {
  const browser = await puppeteer.launch({
    executablePath,
    args: ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--disable-background-networking"],
  });
  const seen = { requests: [], console: [], errors: [] };
  try {
    const page = await browser.newPage();
    await page.setViewport({ width: Number(width), height: 900 });
    page.on("request", (request) => seen.requests.push(request.url()));
    page.on("console", (message) => seen.console.push(message.text()));
    page.on("pageerror", (error) => seen.errors.push(String(error)));
    page.on("requestfailed", (request) => seen.errors.push(`${request.url()}: ${request.failure().errorText}`));
    const response = await page.goto(url, { waitUntil: "networkidle0" });
    seen.status = response.status();
    seen.page = await page.evaluate(measure);
    await page.screenshot({ path: screenshot });
    const link = await page.$('nav a[href^="#"]');
    if (link) {
      await link.click();
      seen.hash = await page.evaluate(() => location.hash);
      seen.top = await page.evaluate(() => document.getElementById(location.hash.slice(1)).getBoundingClientRect().top);
    }
  } finally {
    await browser.close();
  }
  console.log(JSON.stringify(seen));
}

main(process.argv.slice(2)).catch((error) => {
  console.error(String(error));
  process.exitCode = 1;
});
