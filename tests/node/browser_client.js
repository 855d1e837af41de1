// SPDX-License-Identifier: GPL-3.0-or-later
// Calls a service by api/javascript/whittle.js in a real browser, from a page of another origin, and prints what came of
// it as JSON.
//
// Usage: node browser_client.js BROWSER PAGE SERVICE TOKEN FILE     (PAGE/whittle.js is the client; FILE is a cloud)
"use strict";
const puppeteer = require("puppeteer-core");

// Runs in the page.
async function call(service, token) {
  const { Client, Problem } = await import("./whittle.js");
  const file = document.querySelector("input").files[0];
  const client = new Client(service, { token, pieceBytes: 3000 });
  const told = [], seen = [];
  const cloud = await client.upload(file, { onProgress: (...at) => told.push(at) });
  const job = await client.wait(await client.simplify(cloud, { ratio: 0.5, outputs: ["cloud", "mesh"] }),
    { onProgress: (document) => seen.push(document.status) });
  const points = await client.points(job), mesh = await client.mesh(job);
  const batch = await client.waitBatch(await client.batch([cloud, file], { ratio: 0.4 }));
  const problem = async (calling) => {
    try {
      return await calling();
    } catch (error) {
      return { isProblem: error instanceof Problem, status: error.status, type: error.document?.type };
    }
  };
  return {
    size: file.size, cloud, told, seen, job: job.status, points: points.count, kind: points.positions.constructor.name,
    vertices: mesh.count, corners: mesh.triangles.length, batch: batch.status,
    refused: await problem(() => client.simplify(cloud, { ratio: 7 })),
    stranger: await problem(() => new Client(service, { token: "wrong" }).clouds()),
    deleted: (await client.cancel(job)).id === job.id && await problem(() => client.job(job)),
  };
}

async function main([executablePath, page, service, token, file]) {
  const browser = await puppeteer.launch({
    executablePath,
    args: ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--disable-background-networking"],
  });
  try {
    const tab = await browser.newPage();
    const errors = [];
    tab.on("pageerror", (error) => errors.push(String(error)));
    await tab.goto(page);
    await (await tab.$("input")).uploadFile(file);
    console.log(JSON.stringify({ ...await tab.evaluate(call, service, token), errors }));
  } finally {
    await browser.close();
  }
}

main(process.argv.slice(2)).catch((error) => {
  console.error(error);
  process.exit(1);
});
