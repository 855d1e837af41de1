// SPDX-License-Identifier: GPL-3.0-or-later
// States of the page that the way through it doesn't meet: refusals, failures, a service that is away, keys alone,
// fingers, colours.  Prints what was seen as JSON, one line.  Where something has to happen to the service meanwhile it
// prints {"wants": NAME} and waits for a line.
//
// Usage: node states.js BROWSER SCENARIO URL FOLDER [FILE | TOKEN]
"use strict";
const { join } = require("node:path");
const { createInterface } = require("node:readline");
const axe = require("axe-core").source;
const { run, settled, watchedPage, withBrowser } = require("./browser.js");

const answers = createInterface({ input: process.stdin })[Symbol.asyncIterator]();

async function outside(wants) {
  console.log(JSON.stringify({ wants }));
  await answers.next();
}

// What the scenarios do with a page.
function hands(page, seen) {
  const text = (id) => page.$eval(`#${id}`, (element) => element.innerText);
  const visible = (selector) => page.waitForSelector(selector, { visible: true });
  const said = (id, part) => page.waitForFunction((where, what) => document.getElementById(where).textContent.includes(what), {}, id, part);
  const looked = () => page.waitForFunction(() => document.documentElement.dataset.looking);
  return {
    text, visible, said, looked,
    drawn: () => page.evaluate(() => whittled.drawn()),
    settled: () => settled(page),
    async drop(file) {
      await (await page.$("#drop-file")).uploadFile(file);
    },
    // Holds a state to axe, and keeps what the page says.
    async judge(state) {
      await page.evaluate(`if (!globalThis.axe) { ${axe} }`);
      seen.violations[state] = await page.evaluate(async () => {
        const { violations } = await axe.run();
        return violations.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.html.slice(0, 90)).join(" | ")}`);
      });
      seen.news[state] = await page.$("#news") ? await text("news") : "";
    },
    // Presses Tab until an element has the focus, as somebody without a mouse does.
    async tabTo(selector) {
      for (let i = 0; i < 120; i++) {
        if (await page.evaluate((wanted) => document.activeElement.matches(wanted), selector)) return;
        await page.keyboard.press("Tab");
      }
      throw new Error(`Tab doesn't lead to ${selector}`);
    },
  };
}

const scenarios = {
  async wrong_token({ page, judge, visible, said, text, seen }, token) {
    await visible("#token-value");
    await page.type("#token-value", token);
    await page.keyboard.press("Enter");
    await said("token-title", "take this token");
    await judge("wrong token");
    seen.title = await text("token-title");
  },

  async no_scan({ drop, said, judge }, file) {
    await drop(file);
    await said("news", ":");
    await judge("refused");
  },

  async failed({ page, drop, visible, judge, text, seen }, file) {
    await drop(file);
    await visible("#choose-start");
    await page.click("#choose-start");
    await visible("#ended-more");
    await judge("failed");
    seen.ended = [await text("ended-title"), await text("ended-text"), await text("ended-advice")];
    await page.click("#ended-more summary");
    await judge("failed, with its log");
    await page.reload();
    await visible("#ended-title");
    await page.click("#ended-again");
    await visible("#choose-start");
  },

  async cancelled({ page, drop, visible, judge, text, seen }, file) {
    await drop(file);
    await visible("#choose-start");
    await page.click("#choose-start");
    await page.waitForFunction(() => document.querySelector("#follow-stages li[aria-current]"));
    await judge("running");
    seen.stage = await text("follow-stages");
    await page.click("#follow-cancel");
    await visible("#ended-title");
    await judge("cancelled");
    seen.ended = [await text("ended-title"), await text("ended-text")];
  },

  // A job that waits for others, and then what is told while it runs.
  async queued({ page, visible, said, looked, judge, seen }) {
    await visible("#follow-text");
    await said("follow-text", "Waiting: 2 ahead");
    await judge("waiting");
    await outside("less");
    await said("follow-text", "Waiting: 1 ahead");
    await page.evaluateOnNewDocument(() => {
      globalThis.told = [];
      addEventListener("DOMContentLoaded", () => new MutationObserver(() => told.push(document.getElementById("follow-text").textContent,
        document.getElementById("follow-bar").getAttribute("aria-valuetext"))).observe(document.getElementById("follow"), { childList: true, subtree: true, attributes: true }));
    });
    const news = { status: "running", progress: 40, stage: "refine", estimate: { seconds_left: 300 } };
    let streams = 0;
    await page.setRequestInterception(true);
    const answer = (request) => (request.url().endsWith("/events") && !streams++ ? request.respond({ contentType: "text/event-stream",
      body: `event: progress\ndata: ${JSON.stringify(news)}\n\n` }) : request.continue());
    page.on("request", answer);
    await page.reload();
    await page.waitForFunction(() => globalThis.told?.some((text) => /^40/.test(text)));
    await said("follow-text", "Waiting: 1 ahead");
    seen.told = await page.evaluate(() => globalThis.told);
    page.off("request", answer);
    await page.setRequestInterception(false); // what a worker imports may never come when requests are held
    await outside("open");
    await looked();
  },

  // A deviation in the file's units: of a file whose box nobody knows yet a number, which has to be written.
  async units({ page, drop, visible, judge, looked, said, text, seen }, file) {
    await drop(file);
    await visible("#choose-start");
    await page.click('input[value="max_deviation_rel"]');
    await visible("#goal-unit");
    seen.percent = [await text("goal-label"), await page.$eval("#choose-curl", (element) => element.textContent)];
    await page.select("#goal-unit", "max_deviation");
    await judge("no number yet");
    await page.click("#choose-start");
    seen.empty = [await text("goal-text"), page.url(), await page.$$(":invalid").then((all) => all.length > 0)];
    await page.type("#goal-number", "0.02");
    await said("goal-text", "0.02");
    await judge("a number");
    await page.click("#choose-start");
    await looked();
    seen.job = page.url();
    await page.click("#read-again");
    await visible("#choose-start");
    seen.again = [await text("goal-label"), await text("goal-text")];
  },

  // A text whose columns aren't known: the way to name them.
  async columns({ page, drop, visible, judge, looked, text, seen }, file) {
    await drop(file);
    await visible("#choose-start");
    await visible("#choose-first #param-columns");
    await page.click("#choose-start");
    await visible("#ended-again");
    seen.ended = [await text("ended-text"), await text("ended-advice")];
    await page.click("#ended-again");
    await visible("#param-columns");
    await page.waitForFunction(() => document.activeElement.id === "param-columns");
    await page.keyboard.type("-,x,y,z,-");
    await page.$eval("#choose details", (more) => { more.open = true; });
    for (const [name, value] of [["where", "z<0.06, x>-0.9"], ["viewpoint", "0,0,9"], ["weights", "z:0.1"]]) await page.type(`#param-${name}`, value);
    await judge("columns are named");
    await page.click("#choose-start");
    await looked();
    seen.job = page.url();
  },

  // A text with columns that nothing is made of.
  async table({ page, drop, visible, judge, looked, text, seen }, file) {
    await drop(file);
    await visible("#choose-start");
    await page.click("#choose-start");
    await looked();
    await judge("a table");
    seen.warnings = await text("read-warnings");
  },

  // What is told of a file before anything runs.
  async facts({ drop, visible, judge, page, text, seen }, file) {
    await drop(file);
    await visible("#choose-start");
    await judge("chosen");
    seen.facts = await text("cloud-facts");
    await page.setViewport({ width: 360, height: 780 });
    seen.tops = await page.evaluate(() => ["", "Needs up to 1 MiB of memory.", "It needs more than there is. ".repeat(9)].map((plan) => {
      document.getElementById("choose-plan").textContent = plan;
      return document.getElementById("choose-start").getBoundingClientRect().top;
    }));
    await page.click('input[value="max_deviation_rel"]');
    seen.label = await text("goal-label");
  },

  // The service is killed in the middle of an upload, and comes back.
  async killed({ page, drop, visible, judge, said, seen }, file) {
    await upload_slowly({ page, drop, seen }, file);
    await outside("kill");
    await said("news", "goes on by itself");
    await judge("service gone");
    await outside("start");
    await visible("#choose-start");
    await judge("after it");
  },

  // The network is lost in the middle of an upload, and comes back.
  async offline({ page, drop, visible, judge, said, seen }, file) {
    const session = await upload_slowly({ page, drop, seen }, file);
    await session.send("Network.emulateNetworkConditions", { offline: true, latency: 0, downloadThroughput: -1, uploadThroughput: -1 });
    await said("news", "goes on by itself");
    await judge("offline");
    await session.send("Network.emulateNetworkConditions", { offline: false, latency: 0, downloadThroughput: -1, uploadThroughput: -1 });
    await visible("#choose-start");
    await judge("after it");
  },

  // The service goes away while a job runs, and comes back.
  async away({ page, drop, visible, looked, judge, said }, file) {
    await drop(file);
    await visible("#choose-start");
    await page.click("#choose-start");
    await page.waitForFunction(() => document.querySelector("#follow-stages li[aria-current]"));
    await outside("kill");
    await said("news", "not lost");
    await judge("service gone");
    await page.evaluate(() => document.getElementById("home").click());
    await said("news", "doesn't answer");
    await judge("list without a service");
    await outside("start");
    await page.goBack();
    await looked();
    await judge("after it");
  },

  async keys({ page, visible, tabTo, looked, text, drawn, settled: rest, judge, seen }) {
    const { keyboard } = page;
    await tabTo("#drop-example");
    await keyboard.press("Enter");
    await visible("#choose-start");
    await tabTo("#goal-slider");
    await keyboard.press("ArrowLeft");
    await tabTo("#choose-start");
    await keyboard.press("Enter");
    await looked();
    await rest();
    await tabTo("#look-canvas");
    seen.views = [(await drawn()).view];
    for (const key of ["ArrowLeft", "ArrowUp", "+"]) await keyboard.press(key);
    await keyboard.down("Shift");
    await keyboard.press("ArrowLeft");
    await keyboard.up("Shift");
    seen.views.push((await drawn()).view);
    await keyboard.press("Home");
    await tabTo("#look-after");
    await keyboard.press("ArrowDown");
    await page.waitForFunction(() => whittled.drawn().layers[1]?.count);
    await tabTo("#look-level");
    await keyboard.press("End");
    for (let i = 0; i < 3; i++) await keyboard.press("PageDown");
    seen.level = await text("level-text");
    await keyboard.press("End");
    await tabTo("#look-measure");
    await keyboard.press("Enter");
    await page.focus("#look-canvas");
    await rest();
    await judge("picking");
    seen.measured = [];
    for (let i = 0; i < 24 && !/between/.test(seen.measured.at(-1)); i++) {
      await keyboard.press("Enter");
      seen.measured.push(await text("measure-text"));
      await keyboard.press("ArrowLeft");
      await keyboard.press("ArrowUp");
    }
    page.on("dialog", (dialog) => dialog.accept());
    await tabTo("#read-delete");
    await keyboard.press("Enter");
    await visible("#jobs-none");
  },

  // Somebody who turns a result again while it rests before all of it is drawn doesn't wait for that rest: here it has no end.
  async restless({ page, looked, drawn, settled: rest, seen }) {
    await looked();
    await rest();
    await page.focus("#look-canvas");
    await page.evaluate(() => {
      const usual = globalThis.setTimeout;
      globalThis.setTimeout = (work, ms = 0, ...more) => (ms >= 100 ? 0 : usual(work, ms, ...more));
    });
    seen.views = [];
    for (let i = 0; i < 3; i++) {
      const { frames } = await drawn();
      await page.keyboard.press("ArrowLeft");
      await page.waitForFunction((before) => whittled.drawn().frames > before, {}, frames);
      seen.views.push((await drawn()).view.azimuth);
    }
  },

  async fingers({ page, looked, drawn, settled: rest, seen }) {
    await page.setViewport({ width: 360, height: 780, hasTouch: true, isMobile: true, deviceScaleFactor: 2 });
    await looked();
    await rest();
    const session = await page.createCDPSession(), stage = await page.$("#look-canvas");
    await stage.scrollIntoView();
    const { x, y, width, height } = await stage.boundingBox(), middle = [x + width / 2, y + height / 2];
    const touch = (type, ...places) => session.send("Input.dispatchTouchEvent", { type, touchPoints: places.map(([dx, dy], id) => ({ x: middle[0] + dx, y: middle[1] + dy, id })) });
    async function gesture(steps) {
      await touch("touchStart", ...steps[0]);
      for (const places of steps.slice(1)) await touch("touchMove", ...places);
      await touch("touchEnd");
      return (await drawn()).view;
    }
    seen.before = (await drawn()).view;
    seen.turned = await gesture([[[0, 0]], [[20, 0]], [[40, 10]]]);
    seen.zoomed = await gesture([[[-20, 0], [20, 0]], [[-40, 0], [40, 0]], [[-60, 0], [60, 0]]]);
    seen.shifted = await gesture([[[-20, 0], [20, 0]], [[0, 10], [40, 10]], [[20, 20], [60, 20]]]);
  },

  // The camera by mouse and keys, what is picked, marked, boxed and saved; of a ball, as points, from its usual place.
  async camera({ page, folder, looked, text, drawn, settled: rest, judge, seen }) {
    await looked();
    await page.select("#look-layout", "after");
    await rest();
    const stage = await page.$("#look-canvas"), { mouse, keyboard } = page;
    const view = async (name) => { seen[name] = (await drawn()).view; };
    const shoot = async (name) => {
      await rest();
      await stage.screenshot({ captureBeyondViewport: false, path: join(folder, `${name}.png`) });
    };
    const middle = async (dx = 0) => {
      const { x, y, width, height } = await stage.boundingBox();
      return [x + width / 2 + dx, y + height / 2];
    };
    const drag = async (dx, dy, button = "left") => {
      const [x, y] = await middle();
      await mouse.move(x, y);
      await mouse.down({ button });
      await mouse.move(x + dx, y + dy);
      await mouse.up({ button });
    };
    await shoot("ball");
    await view("usual");
    await drag(40, 20);
    await view("dragged");
    await drag(40, 20, "right");
    await view("pushed");
    await mouse.wheel({ deltaY: 50 });
    await page.waitForFunction((before) => whittled.drawn().view.distance !== before, {}, seen.pushed.distance);
    await view("wheeled");
    await stage.focus();
    await keyboard.down("Shift");
    await keyboard.press("ArrowRight");
    await keyboard.up("Shift");
    await view("shifted");
    for (let i = 0; i < 30; i++) await keyboard.press("ArrowUp");
    await view("above");
    await keyboard.press("Home");
    await view("home");
    await rest();
    await page.click("#look-box");
    await shoot("boxed");
    await page.click("#look-measure");
    seen.places = [];
    for (const dx of [0, 60, 0]) {
      await mouse.click(...await middle(dx));
      seen.places.push(await text("measure-text"));
      seen.marks = (await drawn()).marks;
    }
    await page.select("#look-up", "y");
    await page.keyboard.press("Home");
    await rest();
    await mouse.click(...await middle());
    await mouse.click(...await middle());
    seen.places.push(await text("measure-text"));
    await page.click("#look-measure");
    await page.click("#look-box");
    seen.none = (await drawn()).marks;
    await page.select("#look-up", "z");
    await page.click("#look-reset");
    await rest();
    await page.evaluate(() => {
      const usual = URL.createObjectURL;
      URL.createObjectURL = (blob) => {
        globalThis.saved = blob;
        return usual.call(URL, blob);
      };
    });
    await page.click("#look-shot");
    await page.waitForFunction(() => globalThis.saved);
    seen.saved = await page.evaluate(async () => {
      const bitmap = await createImageBitmap(globalThis.saved), canvas = new OffscreenCanvas(bitmap.width, bitmap.height), context = canvas.getContext("2d");
      context.drawImage(bitmap, 0, 0);
      const { data } = context.getImageData(0, 0, bitmap.width, bitmap.height);
      let n = 0;
      for (let i = 0; i < data.length; i += 4) n += Math.abs(data[i] - data[0]) + Math.abs(data[i + 1] - data[1]) + Math.abs(data[i + 2] - data[2]) > 12;
      return n / (data.length / 4);
    });
    for (const [layout, width] of [["swipe", 800], ["after", 360], ["side", 360]]) {
      await page.setViewport({ width, height: 900 });
      await page.select("#look-layout", layout);
      await shoot(`${layout}-${width}`);
    }
    await stage.focus();
    await keyboard.press("+");
    await view("nearer");
    await page.setViewport({ width: 700, height: 700 });
    await rest();
    await view("still");
    await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: "dark" }]);
    await shoot("dark");
    await judge("ball");
  },

  // What is asked for, as the command says it.
  async form({ page, drop, visible, said, text, judge, seen }, file) {
    const command = async (name) => { seen[name] = (await text("choose-curl")).split("v1/jobs?")[1]; };
    const put = (id, value) => page.$eval(`#${id}`, (input, to) => {
      input.value = to;
      input.dispatchEvent(new Event("input", { bubbles: true }));
    }, value);
    await drop(file);
    await visible("#choose-start");
    await page.$$eval("#choose details", (all) => all.forEach((each) => { each.open = true; }));
    seen.command = await text("choose-curl");
    await command("usual");
    await page.click('input[name="goal"][value="points"]');
    await put("goal-number", "1234");
    await command("points");
    seen.text = await text("goal-text");
    await put("goal-slider", 300);
    seen.most = await text("goal-text");
    await page.click('input[name="goal"][value="levels"]');
    await put("goal-levels", "40, 10");
    await page.select("#param-surface", "closed");
    await put("param-seed", "7");
    await command("levels");
    await judge("form");
  },

  // Figures, links and files of a result that a token is needed for.
  async figures({ page, folder, visible, looked, text, seen }, token) {
    await visible("#token-value");
    await page.type("#token-value", token);
    await page.keyboard.press("Enter");
    await looked();
    seen.title = await page.title();
    seen.rows = await page.$$eval("#read-error tr, #read-table tr", (all) => all.map((row) => [...row.children].map((cell) => cell.textContent)));
    await page.$$eval("#read details", (all) => all.forEach((each) => { each.open = true; }));
    seen.command = await text("read-curl");
    await page.click("#read-files [aria-label$='link to cloud.ply']");
    await page.waitForFunction(() => document.querySelector("#read-files output").textContent);
    seen.link = await page.$eval("#read-files output", (said) => said.textContent);
    const session = await page.createCDPSession();
    await session.send("Browser.setDownloadBehavior", { behavior: "allowAndName", downloadPath: folder, eventsEnabled: true });
    const saved = new Promise((resolve) => session.on("Browser.downloadProgress", (event) => event.state === "completed" && resolve(event.guid)));
    await page.click("#read-files li:first-child > button");
    seen.saved = await saved;
    // somebody who doesn't mean it
    page.on("dialog", (dialog) => dialog.dismiss());
    await page.click("#read-delete");
    await page.click("#home");
    await visible(".card");
    await page.click(".card button[aria-label^=Delete]");
    seen.cards = (await page.$$(".card")).length;
    seen.kept = await page.evaluate(() => Object.keys(sessionStorage));
  },

  // An upload that is left, and the same file again.
  async resumed({ page, drop, visible, seen }, file) {
    await upload_slowly({ page, drop, seen }, file);
    await page.reload();
    await page.waitForFunction(() => globalThis.whittled);
    seen.before = seen.offsets.length;
    await drop(file);
    await visible("#choose-start");
  },

  // Each colour of the result's side, meshes of the levels, the swipe bar, the picture that is saved.
  // What is seen of a job on either side, and why where nothing is.
  async sides({ page, folder, looked, text, drawn, settled: rest, judge, seen }) {
    await looked();
    await rest();
    await judge("looked at");
    seen.layers = (await drawn()).layers;
    seen.why = await page.$eval("#look-why", (why) => (why.hidden ? "" : why.innerText));
    seen.title = await text("look-title");
    await page.screenshot({ path: join(folder, "sides.png") });
  },

  async colours({ page, folder, looked, text, drawn, settled: rest, judge, seen }) {
    await looked();
    const stage = await page.$("#look-canvas");
    const shoot = async (name) => {
      await rest();
      await stage.screenshot({ captureBeyondViewport: false, path: join(folder, `${name}.png`) });
    };
    const options = (id) => page.$$eval(`#${id} option`, (all) => all.map((each) => [each.value, each.textContent]));
    seen.after = await options("look-after");
    seen.meshes = [];
    for (const place of ["Home", "End"]) {
      await page.focus("#look-level");
      const before = (await drawn()).layers[1].triangles;
      await page.keyboard.press(place);
      if (place === "Home") await page.waitForFunction((n) => whittled.drawn().layers[1]?.triangles !== n, {}, before);
      else await page.waitForFunction((n) => whittled.drawn().layers[1]?.triangles > n, {}, before);
      seen.meshes.push([(await drawn()).layers[1].triangles, await text("level-text")]);
    }
    await page.select("#look-mesh", "smooth");
    await shoot("mesh-smooth");
    await page.select("#look-colour-1", "normals");
    await shoot("mesh-normals");
    await page.select("#look-after", "cloud");
    await page.waitForFunction(() => whittled.drawn().layers[1]?.shown && whittled.drawn().layers[1].shown === whittled.drawn().layers[1].count);
    await page.select("#look-layout", "after");
    await page.select("#look-colour-1", "height");
    for (const value of ["mesh_0.4.ply", "cloud"]) {
      const { triangles } = (await drawn()).layers[1];
      await page.select("#look-after", value);
      await page.waitForFunction((before) => whittled.drawn().layers[1] && whittled.drawn().layers[1].triangles !== before, {}, triangles);
    }
    await page.waitForFunction(() => whittled.drawn().layers[1].shown && whittled.drawn().layers[1].shown === whittled.drawn().layers[1].count);
    seen.stays = await page.$eval("#look-colour-1", (select) => select.value);
    seen.colours = await options("look-colour-1");
    seen.legends = {};
    for (const [name] of seen.colours) {
      await page.select("#look-colour-1", name);
      await shoot(`cloud-${name}`);
      seen.legends[name] = await page.$eval("#legend-1", (legend) => (legend.hidden ? null
        : `${legend.innerText} ${[...legend.querySelectorAll("canvas[aria-label]")].map((each) => each.ariaLabel)}`));
    }
    await page.select("#look-layout", "swipe");
    await page.select("#look-colour-1", "plain");
    for (const bar of [20, 80]) {
      await page.$eval("#look-bar", (slider, to) => {
        slider.value = to;
        slider.dispatchEvent(new Event("input", { bubbles: true }));
      }, bar);
      await shoot(`swipe-${bar}`);
    }
    seen.histogram = await page.$eval("#legend-0", (legend) => `${legend.innerText} ${legend.querySelector("canvas").ariaLabel}`);
    await judge("legends");
    const session = await page.createCDPSession();
    await session.send("Browser.setDownloadBehavior", { behavior: "allowAndName", downloadPath: folder, eventsEnabled: true });
    const saved = new Promise((resolve) => session.on("Browser.downloadProgress", (event) => event.state === "completed" && resolve(event.guid)));
    await page.click("#look-shot");
    seen.saved = await saved;
  },

  // A cloud as tiles: from far away, from the usual place, with few points allowed, from near; and what is left of it.
  async tiles({ page, folder, looked, text, drawn, settled: rest, visible, judge, seen }) {
    await looked();
    seen.after = await page.$$eval("#look-after option", (all) => all.map((each) => each.value));
    await page.select("#look-after", "cloud");
    await page.waitForFunction(() => whittled.drawn().layers[1]?.shown && !whittled.drawn().layers[1].tiles);
    await page.select("#look-layout", "after");
    await rest();
    const stage = await page.$("#look-canvas");
    await stage.screenshot({ captureBeyondViewport: false, path: join(folder, "lit.png") });
    seen.before = (await drawn()).geometries;
    await stage.focus();
    for (let i = 0; i < 15; i++) await page.keyboard.press("-");
    await page.select("#look-after", "tiles");
    await page.waitForFunction(() => whittled.drawn().layers[1]?.tiles);
    const stand = async (name) => {
      await rest();
      await page.waitForFunction(() => !whittled.drawn().busy && !whittled.drawn().layers[1].tiles.waiting);
      await rest();
      seen[name] = { ...(await drawn()).layers[1], text: await text("level-text") };
    };
    const level = (value) => page.$eval("#look-level", (slider, to) => {
      slider.value = to;
      slider.dispatchEvent(new Event("input", { bubbles: true }));
    }, value);
    await stand("away");
    await page.keyboard.press("Home");
    await stand("usual");
    await stage.screenshot({ captureBeyondViewport: false, path: join(folder, "tiles.png") });
    await level(300);
    await stand("few");
    await judge("tiles");
    await level(1000);
    for (let i = 0; i < 6; i++) await page.keyboard.press("+");
    await page.keyboard.down("Shift");
    for (let i = 0; i < 40; i++) await page.keyboard.press("ArrowRight");
    await page.keyboard.up("Shift");
    await stand("near");
    seen.geometries = (await drawn()).geometries;
    await page.click("#home");
    await visible("#jobs");
    seen.left = (await drawn()).geometries;
  },

  // Operations are tried out on the reference: a job is made of a file, and asked for.
  async docs({ page, visible, judge, seen }, file) {
    await page.waitForFunction(() => document.documentElement.dataset.ready);
    seen.tries = (await page.$$("details.try")).length;
    const attempt = async (id, doing) => {
      await page.evaluate((of) => document.querySelector(`#${of} ~ details.try summary`).click(), id);
      await visible(`#try-${id}-path`);
      await doing?.(await page.$(`#try-${id}-file`));
      await page.evaluate((of) => document.getElementById(`try-${of}-path`).form.requestSubmit(), id);
      await page.waitForFunction((of) => document.getElementById(`try-${of}-path`).form.lastChild.querySelector("strong"), {}, id);
      await page.waitForNetworkIdle({ idleTime: 200 });
      return page.evaluate((of) => document.getElementById(`try-${of}-path`).form.lastChild.innerText, id);
    };
    seen.made = await attempt("createJob", (input) => input.uploadFile(file));
    seen.got = await attempt("getJob");
    seen.wrong = await attempt("createCloudJob");
    await page.evaluate(() => { document.getElementById("try-getJob-token").value = "secret"; });
    const sent = new Promise((resolve) => page.on("request", (request) => request.url().includes("/v1/jobs/") && resolve(request.headers().authorization)));
    await attempt("getJob");
    seen.token = await sent;
    const output = () => page.$eval("#try-getOutput-path", (input) => input.value);
    await page.evaluate(() => document.querySelector("#getOutput ~ details.try summary").click());
    await visible("#try-getOutput-path");
    await page.evaluate((to) => { document.getElementById("try-getOutput-path").value = to; }, (await output()).replace(/outputs\/[^?]*/, "outputs/cloud.ply"));
    await page.evaluate(() => document.getElementById("try-getOutput-path").form.requestSubmit());
    await page.waitForFunction(() => document.getElementById("try-getOutput-path").form.lastChild.querySelector("a"));
    seen.save = await page.$eval("#try-getOutput-path", ({ form }) => [form.lastChild.querySelector("a").download, form.lastChild.querySelector("a").textContent]);
    await judge("reference");
    seen.tables = await page.$$eval(".scrolls", (all) => all.map((each) => [each.scrollWidth, each.clientWidth]));
  },

  // Files that are dropped: two at once; one on the result of another.
  async dropped({ page, visible, looked, judge, text, said, seen }, first, second) {
    const drop = (...files) => page.evaluate((all) => {
      const carried = new DataTransfer();
      for (const [name, content] of all) carried.items.add(new File([content], name));
      document.dispatchEvent(new DragEvent("drop", { dataTransfer: carried, bubbles: true, cancelable: true }));
    }, files);
    await drop(["first.ply", first], ["second.ply", second]);
    await said("news", "one file at a time");
    await judge("two files");
    await drop(["first.ply", first]);
    await visible("#choose-start");
    await page.click("#choose-start");
    await looked();
    await drop(["second.ply", second]);
    await visible("#choose-start");
    seen.facts = await text("cloud-facts");
    await judge("dropped on a result");
    await page.goBack();
    await visible("#jobs-list .card");
    await page.goBack();
    await visible("#look-canvas");
    seen.back = await text("look-title");
  },

  // Files whose names are markup, turn the direction of writing, or are very long.
  async hostile({ page, visible, looked, judge, settled: rest, seen }, content) {
    seen.names = ['<img src=x onerror="globalThis.hit=1"><script>globalThis.hit=2</script>.ply', "a\u202Eylp.exe\u202D\u2066.ply",
      `${"very long name ".repeat(270)}.ply`, "x".repeat(4000)];
    seen.shown = [];
    const fits = async (where) => seen.fits.push([where, 360, ...await page.evaluate(() => [document.documentElement.scrollWidth, document.documentElement.clientWidth])]);
    seen.fits = [];
    await page.setViewport({ width: 360, height: 780 });
    for (const [i, name] of seen.names.entries()) {
      await page.evaluate((called, text) => {
        const carried = new DataTransfer();
        carried.items.add(new File([text], called));
        document.dispatchEvent(new DragEvent("drop", { dataTransfer: carried, bubbles: true, cancelable: true }));
      }, name, content);
      await visible("#choose-start");
      await fits(`choose ${i}`);
      await page.click("#choose-start");
      await looked();
      await rest();
      await fits(`look ${i}`);
      seen.shown.push(await page.$eval("#look-title", (title) => title.textContent));
      await page.$eval("#home", (link) => link.click());
      await visible("#jobs");
      await page.waitForFunction((n) => document.querySelectorAll(".card").length === n, {}, i + 1);
    }
    await fits("jobs");
    await judge("hostile names");
    await page.evaluate((n) => document.querySelectorAll(".card .name")[n].click(), 0);
    await looked();
    seen.hit = await page.evaluate(() => globalThis.hit ?? null);
    // deleted in another tab meanwhile
    const other = await page.browser().newPage();
    await other.goto(page.url());
    await other.evaluate(() => fetch(location.pathname.replace("/jobs/", "/v1/jobs/"), { method: "DELETE" }).then((reply) => reply.status));
    await other.close();
    await page.bringToFront();
    await page.reload();
    await page.waitForFunction(() => document.getElementById("news").textContent);
    await judge("deleted elsewhere");
  },

  // The token is taken from somebody who looks at a result, and then while parameters are chosen.
  async expired({ page, visible, looked, said, judge, text, seen }, ...tokens) {
    const give = async (token) => {
      await page.type("#token-value", token);
      await page.keyboard.press("Enter");
      await page.waitForSelector("#token", { hidden: true });
    };
    await visible("#token-value");
    await give(tokens[0]);
    await looked();
    await outside("revoke");
    await page.select("#look-before", "own");
    await said("token-title", "take this token");
    await visible("#token-value");
    await judge("token expired, looking");
    await give(tokens[1]);
    await page.waitForFunction(() => document.getElementById("look-before").value === "error" && whittled.drawn().layers[0]?.shown);
    await page.click("#read-again");
    await visible("#choose-start");
    await page.$eval("#goal-slider", (slider) => {
      slider.value = 280;
      slider.dispatchEvent(new Event("input", { bubbles: true }));
    });
    seen.goals = [await text("goal-text")];
    await outside("revoke");
    await page.click("#choose-start");
    await visible("#token-value");
    await judge("token expired, choosing");
    await give(tokens[2]);
    seen.goals.push(await text("goal-text"));
    const { pathname } = new URL(page.url());
    await page.click("#choose-start");
    await page.waitForFunction((before) => location.pathname !== before, {}, pathname);
    await visible("#read-again");
  },

  // The service is away for a while from somebody who looks at a result, and from the list.
  async away_looking({ page, visible, looked, said, judge, seen }) {
    await looked();
    await outside("kill");
    await page.select("#look-before", "own");
    await said("news", "as soon as it answers");
    await judge("away, looking");
    await outside("start");
    await page.waitForFunction(() => document.getElementById("news").textContent === "" && whittled.drawn().layers[0]?.shown > 0);
    seen.colour = await page.$eval("#look-colour-0", (select) => select.value);
    await outside("kill");
    await page.click("#home");
    await said("news", "tries again by itself");
    await judge("away, list");
    await outside("start");
    await visible(".card");
    await judge("back");
  },

  // A job that another tab deletes while it is looked at.
  async deleted({ page, looked, said, judge }) {
    await looked();
    const other = await page.browser().newPage();
    await other.goto(page.url());
    await other.evaluate(() => fetch(location.pathname.replace("/jobs/", "/v1/jobs/"), { method: "DELETE" }));
    await other.close();
    await page.bringToFront();
    await page.select("#look-after", "cloud");
    await said("news", ".");
    await judge("deleted while looked at");
    page.on("dialog", (dialog) => dialog.accept());
    await page.click("#read-delete");
    await said("news", "deleted");
    await judge("deleted twice");
  },

  // A browser that keeps nothing: no room, or not allowed.
  async no_storage({ page, drop, visible, looked, seen }, token, file) {
    await page.evaluateOnNewDocument(() => {
      Storage.prototype.setItem = () => { throw new DOMException("no room", "QuotaExceededError"); };
    });
    await page.reload();
    await visible("#token-value");
    await page.type("#token-value", token);
    await page.keyboard.press("Enter");
    await visible("#jobs-none");
    await drop(file);
    await visible("#choose-start");
    await page.click("#choose-start");
    await looked();
    await page.evaluateOnNewDocument(() => {
      for (const name of ["localStorage", "sessionStorage"]) Object.defineProperty(globalThis, name, { get: () => { throw new DOMException("not allowed", "SecurityError"); } });
    });
    await page.reload();
    await visible("#token-value");
    await page.type("#token-value", token);
    await page.keyboard.press("Enter");
    await looked();
    seen.title = await page.$eval("#look-title", (title) => title.textContent);
  },

  // More jobs than a page of the list has.
  async many({ page, visible, judge, seen }, last, count) {
    await visible(".card");
    const called = () => page.$$eval(".card .name", (all) => all.map((each) => each.textContent));
    seen.first = await called();
    await page.type("#jobs-filter", last);
    await page.waitForFunction((name) => [...document.querySelectorAll(".card .name")].some((each) => each.textContent === name), {}, last);
    seen.found = await called();
    await judge("filtered");
    await page.$eval("#jobs-filter", (filter) => {
      filter.value = "";
      filter.dispatchEvent(new Event("input"));
    });
    await page.waitForFunction((n) => document.querySelectorAll(".card").length === Number(n), {}, count);
    await page.waitForFunction((n) => performance.getEntriesByType("resource").filter(({ name }) => name.endsWith("preview.png")).length >= Number(n), {}, count);
    await page.type("#jobs-filter", "NUMBER-31-");
    await page.waitForFunction(() => document.querySelectorAll(".card").length === 1);
    seen.capitals = await called();
    seen.asked = seen.requests.length;
    await page.$eval("#jobs-filter", (filter) => { filter.value = ""; });
    await page.select("#jobs-status", "failed");
    await visible("#jobs-none");
    await page.select("#jobs-status", "successful");
    await visible(".card");
    await page.type("#jobs-filter", "nothing is called so");
    await visible("#jobs-none");
    await judge("nothing found");
  },

  // Results that have hardly any points, or numbers that are very large; addresses as JSON.
  async odd({ page, folder, looked, text, drawn, settled: rest, judge, seen }, addresses) {
    seen.seen = {};
    for (const [name, address] of Object.entries(JSON.parse(addresses))) {
      await page.goto(address, { waitUntil: "domcontentloaded" });
      await looked();
      await rest();
      const stage = await page.$("#look-canvas");
      await stage.screenshot({ captureBeyondViewport: false, path: join(folder, `${name}.png`) });
      await page.click("#look-box");
      seen.seen[name] = { box: await text("measure-text"), level: await text("level-text"), layers: (await drawn()).layers, view: (await drawn()).view,
        up: await page.$eval("#look-up", (select) => select.value), stacked: await page.$eval("#look-canvas", ({ dataset }) => dataset.stacked) };
      await judge(name);
    }
  },

  // The device forgets all that it was given, as some do when they wake up, and is there again.
  async lost_device({ page, folder, looked, drawn, settled: rest, seen }) {
    await looked();
    await rest();
    const stage = await page.$("#look-canvas"), shoot = async (name) => {
      await rest();
      await stage.screenshot({ captureBeyondViewport: false, path: join(folder, `${name}.png`) });
    };
    await stage.focus();
    await shoot("before");
    await page.evaluate(() => { globalThis.device = document.getElementById("look-canvas").getContext("webgl2").getExtension("WEBGL_lose_context"); });
    const happens = (what, doing) => page.evaluate((kind, call) => new Promise((resolve) => {
      document.getElementById("look-canvas").addEventListener(kind, () => setTimeout(resolve, 0), { once: true });
      globalThis.device[call]();
    }), what, doing);
    await happens("webglcontextlost", "loseContext");
    await page.keyboard.press("ArrowLeft");
    await rest();
    const { frames } = await drawn();
    await happens("webglcontextrestored", "restoreContext");
    await page.waitForFunction((before) => whittled.drawn().frames > before, {}, frames);
    await shoot("turned");
    await page.keyboard.press("ArrowRight");
    await shoot("after");
  },

  // A part of the page that doesn't come, as through a proxy that fails now and then: the picture is shown.
  async no_worker({ page, visible, text, seen }) {
    await page.evaluateOnNewDocument(() => {
      globalThis.Worker = class extends Worker {
        constructor(url, options) {
          super(`${url}-that-is-not-there`, options);
        }
      };
    });
    await page.reload();
    await visible("#look-picture");
    await page.waitForFunction(() => document.getElementById("look-picture").naturalWidth > 0);
    seen.why = await text("look-none");
    seen.errors = seen.errors.filter((error) => !/that-is-not-there/.test(error));
  },

  // Without WebGL the picture is shown.
  async no_webgl({ page, text, judge, visible, seen }) {
    await visible("#look-picture");
    await page.waitForFunction(() => document.getElementById("look-picture").naturalWidth > 0);
    await judge("no WebGL");
    seen.why = await text("look-none");
    seen.tools = await page.$eval("#look-tools", (tools) => tools.hidden);
  },
};

// Begins an upload at a rate at which something can happen meanwhile.
async function upload_slowly({ page, drop, seen }, file) {
  const session = await page.createCDPSession();
  await session.send("Network.enable");
  await session.send("Network.emulateNetworkConditions", { offline: false, latency: 0, downloadThroughput: -1, uploadThroughput: 3e6 });
  seen.offsets = [];
  page.on("request", (request) => request.method() === "PATCH" && seen.offsets.push(Number(request.headers()["upload-offset"])));
  await drop(file);
  await page.waitForFunction(() => document.getElementById("sending-bar").value > 0.4);
  return session;
}

async function main([executablePath, scenario, url, folder, ...rest]) {
  const seen = { requests: [], console: [], errors: [], violations: {}, news: {} };
  try {
    await withBrowser(executablePath, async (browser) => {
      const page = await watchedPage(browser, seen);
      await page.goto(url, { waitUntil: "domcontentloaded" });
      if (scenario !== "docs") await page.waitForFunction(() => globalThis.whittled);
      await scenarios[scenario]({ page, folder, seen, ...hands(page, seen) }, ...rest);
    });
  } finally {
    console.log(JSON.stringify(seen));
    process.stdin.destroy();
  }
}

run(main);
