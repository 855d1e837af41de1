// SPDX-License-Identifier: GPL-3.0-or-later
import createClient from "openapi-fetch";
import type { paths } from "../generated-by/openapi-typescript/api";
import { main } from "./calls";

const bytes = { bodySerializer: (body: any) => body, headers: { "Content-Type": "application/octet-stream" } };

main((baseUrl, token) => {
  const headers = token ? { Authorization: `Bearer ${token}` } : {};
  const client = createClient<paths>({ baseUrl, headers });
  const data = async (reply: Promise<any>) => {
    const { data, error } = await reply;
    if (error) throw error;
    return data;
  };
  return {
    info: () => data(client.GET("/v1/info")),
    createJob: (body, query) => data(client.POST("/v1/jobs", { params: { query }, body: body as any, ...bytes })),
    getJob: (id) => data(client.GET("/v1/jobs/{id}", { params: { path: { id } } })),
    getOutput: (id, name) =>
      data(client.GET("/v1/jobs/{id}/outputs/{name}", { params: { path: { id, name } }, parseAs: "blob" })),
    createCloud: (body) => data(client.POST("/v1/clouds", { body: body as any, ...bytes })),
    createCloudJob: (id, body) => data(client.POST("/v1/clouds/{id}/jobs", { params: { path: { id } }, body })),
    simplify: (body, query) =>
      data(client.POST("/v1/simplify", { params: { query }, body: body as any, parseAs: "blob", ...bytes })),
    listJobs: (query) => data(client.GET("/v1/jobs", { params: { query } })),
    createBatch: (body) => data(client.POST("/v1/batches", { body })),
    getBatch: (id) => data(client.GET("/v1/batches/{id}", { params: { path: { id } } })),
    refused: async (body) =>
      (await client.POST("/v1/jobs", { params: { query: { ratio: 7 } }, body: body as any, ...bytes })).error,
  };
});
