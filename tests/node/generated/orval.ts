// SPDX-License-Identifier: GPL-3.0-or-later
import axios from "axios";
import * as api from "../generated-by/orval/api";
import { main } from "./calls";

main((url, token) => {
  axios.defaults.baseURL = url;
  axios.defaults.headers.common.Authorization = token ? `Bearer ${token}` : undefined;
  axios.defaults.paramsSerializer = { indexes: null }; // outputs=cloud&outputs=mesh, without []
  const bytes = { headers: { "Content-Type": "application/octet-stream" } };
  const data = async (reply: Promise<any>) => (await reply).data;
  const blob = async (reply: Promise<any>) => new Blob([await data(reply)]);
  const binary = { responseType: "arraybuffer" as const };
  return {
    info: () => data(api.getInfo()),
    createJob: (body, query) => data(api.createJob(body, query, bytes)),
    getJob: (id) => data(api.getJob(id)),
    getOutput: (id, name) => blob(api.getOutput(id, name, {}, binary)),
    createCloud: (body) => data(api.createCloud(body, bytes)),
    createCloudJob: (id, document) => data(api.createCloudJob(id, document)),
    simplify: (body, query) => blob(api.simplify(body, query, { ...bytes, ...binary })),
    listJobs: (query) => data(api.listJobs(query)),
    createBatch: (document) => data(api.createBatch(document)),
    getBatch: (id) => data(api.getBatch(id)),
    refused: (body) => api.createJob(body, { ratio: 7 }, bytes).catch((error) => error.response.data),
  };
});
