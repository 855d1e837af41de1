// What the types of api/javascript allow, and what they don't: checked, never run.
//
// SPDX-License-Identifier: GPL-3.0-or-later
import { Client, Problem, readPly, type Job, type Parameters } from "../../api/javascript/whittle.js";

export async function calls(file: File, signal: AbortSignal): Promise<number> {
  const client = new Client("http://127.0.0.1:8080", { token: "t" });
  const cloud: string = await client.upload(file, { onProgress: (sent: number, total: number) => sent / total, signal });
  const params: Parameters = { ratio: 0.1, outputs: ["cloud", "mesh.glb"], surface: "open" };
  const job: Job = await client.wait(await client.simplify([cloud, new Uint8Array(3)], params, { label: "a" }));
  const { positions, triangles, attributes } = await client.mesh(job, { name: "mesh.ply" });
  const red: number | undefined = attributes.red?.[0];
  readPly(await client.output(job.id, "cloud.ply", { points: 5 }));
  if (red === undefined) throw new Problem(500, { title: "no colours" });
  // @ts-expect-error: no such parameter
  await client.simplify(cloud, { ration: 0.1 });
  // @ts-expect-error: no such value
  await client.simplify(cloud, { surface: "round" });
  // @ts-expect-error: a number isn't a source
  await client.upload(7);
  return positions.length + triangles.length;
}
