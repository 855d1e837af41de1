// SPDX-License-Identifier: GPL-3.0-or-later
// The calls that each generated client makes of a real service.  A client says how it is called, and nothing of it is
// changed by hand.
export interface Client {
  info(): Promise<any>;
  createJob(cloud: Blob, query: { ratio: number; outputs: any[] }): Promise<any>;
  getJob(id: string): Promise<any>;
  getOutput(id: string, name: string): Promise<Blob>;
  createCloud(cloud: Blob): Promise<any>;
  createCloudJob(id: string, document: any): Promise<any>;
  simplify(cloud: Blob, query: { ratio: number }): Promise<Blob>;
  listJobs(query: { limit: number }): Promise<any>;
  createBatch(document: any): Promise<any>;
  getBatch(id: string): Promise<any>;
  refused(cloud: Blob): Promise<any>; // a ratio of 7: the problem document
}

function holds(condition: unknown, what: string): asserts condition {
  if (!condition) throw new Error(what);
}

async function ended(read: (id: string) => Promise<any>, id: string): Promise<any> {
  for (;;) {
    const found = await read(id);
    if (!["accepted", "running"].includes(found.status)) return found;
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}

const points = async (blob: Blob) => Number((await blob.text()).match(/element vertex (\d+)/)?.[1]);

export async function run(client: Client, cloud: Blob): Promise<Record<string, string>> {
  const results: Record<string, string> = {};
  let job: any, stored: any, batch: any;
  const calls: [string, () => Promise<void>][] = [
    ["getInfo", async () => holds((await client.info()).version, "no version")],
    ["createJob", async () => {
      job = await client.createJob(cloud, { ratio: 0.5, outputs: ["cloud", "mesh"] });
      holds(["cloud", "mesh"].every((name) => job.params.outputs.includes(name)), "outputs aren't those asked for");
    }],
    ["getJob", async () => holds((await ended(client.getJob, job.id)).status === "successful", "the job failed")],
    ["getOutput", async () =>
      holds((await points(await client.getOutput(job.id, "cloud.ply"))) === 150, "not the points asked for")],
    ["createCloud", async () => {
      stored = await client.createCloud(cloud);
      holds(/^[0-9a-f]{64}$/.test(stored.id), "no id");
    }],
    ["createCloudJob", async () => {
      const made = await client.createCloudJob(stored.id, { params: { ratio: 0.2, outputs: ["cloud"] } });
      holds((await ended(client.getJob, made.id)).status === "successful" && made.params.ratio === 0.2, "not the job asked for");
    }],
    ["simplify", async () => holds((await points(await client.simplify(cloud, { ratio: 0.1 }))) === 30, "not the cloud")],
    ["listJobs", async () => holds((await client.listJobs({ limit: 1 })).jobs.length === 1, "not one job")],
    ["createBatch", async () => {
      batch = await client.createBatch({ clouds: [`/v1/clouds/${stored.id}`, `/v1/clouds/${stored.id}`], params: { ratio: 0.3 } });
      holds(batch.jobs.length === 2, "not a job for each cloud");
    }],
    ["getBatch", async () =>
      holds((await ended(client.getBatch, batch.id)).counts.successful === 2, "not both jobs have succeeded")],
    ["a problem", async () =>
      holds((await client.refused(cloud)).errors[0].parameter === "ratio", "the problem names no parameter")],
  ];
  for (const [name, call] of calls) {
    try {
      await call();
      results[name] = "ok";
    } catch (error: any) {
      results[name] = String(error?.message ?? JSON.stringify(error)).slice(0, 200);
    }
  }
  return results;
}

// Of a service that wants a token: nothing without it.
async function guarded(client: (token?: string) => Client, token: string): Promise<string> {
  const without = await client().listJobs({ limit: 1 }).then(() => "answered", () => "refused");
  if (without !== "refused") return "no token was wanted";
  return client(token).listJobs({ limit: 1 }).then((list) => (list.jobs.length === 0 ? "ok" : "not its list"), String);
}

// url, the cloud's name; the url of a service that wants a token, and that token.
export async function main(client: (url: string, token?: string) => Client): Promise<void> {
  const { readFileSync } = await import("node:fs");
  const [url, path, other, token] = process.argv.slice(2);
  const results = await run(client(url), new Blob([readFileSync(path)]));
  results["a token"] = await guarded((given) => client(other, given), token);
  console.log(JSON.stringify(results));
}
