// SPDX-License-Identifier: GPL-3.0-or-later
import * as api from "../generated-by/hey-api";
import { client } from "../generated-by/hey-api/client.gen";
import { main } from "./calls";

main((baseUrl, token) => {
  client.setConfig({ baseUrl, auth: token });
  const data = async (reply: Promise<any>) => {
    const { data, error } = await reply;
    if (error) throw new Error(JSON.stringify(error));
    return data;
  };
  return {
    info: () => data(api.getInfo()),
    createJob: (body, query) => data(api.createJob({ body, query })),
    getJob: (id) => data(api.getJob({ path: { id } })),
    getOutput: (id, name) => data(api.getOutput({ path: { id, name }, parseAs: "blob" })),
    createCloud: (body) => data(api.createCloud({ body })),
    createCloudJob: (id, body) => data(api.createCloudJob({ path: { id }, body })),
    simplify: (body, query) => data(api.simplify({ body, query, parseAs: "blob" })),
    listJobs: (query) => data(api.listJobs({ query })),
    createBatch: (body) => data(api.createBatch({ body })),
    getBatch: (id) => data(api.getBatch({ path: { id } })),
    refused: async (body) => ((await api.createJob({ body, query: { ratio: 7 } })) as any).error,
  };
});
