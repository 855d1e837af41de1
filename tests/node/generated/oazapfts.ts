// SPDX-License-Identifier: GPL-3.0-or-later
import * as api from "../generated-by/oazapfts/api";
import { main } from "./calls";

const data = async (reply: Promise<any>) => {
  const { status, data } = await reply;
  if (status >= 400) throw new Error(`${status} ${JSON.stringify(data)}`);
  return data;
};
const blob = async (reply: Promise<any>) => {
  const found = await data(reply);
  return found instanceof Blob ? found : new Blob([found]);
};

main((url, token) => {
  api.defaults.baseUrl = url;
  api.defaults.headers = token ? { Authorization: `Bearer ${token}` } : {};
  return {
    info: () => data(api.getInfo()),
    createJob: (body, query) => data(api.createJob(body, query)),
    getJob: (id) => data(api.getJob(id)),
    getOutput: (id, name) => blob(api.getOutput(id, name)),
    createCloud: (body) => data(api.createCloud(body)),
    createCloudJob: (id, document) => data(api.createCloudJob(id, document)),
    simplify: (body, query) => blob(api.simplify(body, query)),
    listJobs: (query) => data(api.listJobs(query)),
    createBatch: (document) => data(api.createBatch(document)),
    getBatch: (id) => data(api.getBatch(id)),
    refused: async (body) => ((await api.createJob(body, { ratio: 7 })) as any).data,
  };
});
