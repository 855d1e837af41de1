// SPDX-License-Identifier: GPL-3.0-or-later
import { Api, ContentType } from "../generated-by/swagger-typescript-api/api";
import { main } from "./calls";

// Its own serializers know forms, not plain bytes; the service takes a form for each cloud.
const type = ContentType.FormData;
const form = (file: Blob): any => ({ file });

main((baseUrl, token) => {
  const headers: Record<string, string> = token ? { Authorization: `Bearer ${token}` } : {};
  const { v1 } = new Api({ baseUrl, baseApiParams: { headers } });
  const data = async (reply: Promise<any>) => (await reply).data;
  return {
    info: () => data(v1.getInfo()),
    createJob: (body, query) => data(v1.createJob(form(body), query, { type, format: "json" })),
    getJob: (id) => data(v1.getJob(id)),
    getOutput: (id, name) => data(v1.getOutput(id, name, {}, { format: "blob" })),
    createCloud: (body) => data(v1.createCloud(form(body), { type })),
    createCloudJob: (id, document) => data(v1.createCloudJob(id, document, { format: "json" })),
    simplify: (body, query) => data(v1.simplify(form(body), query, { type, format: "blob" })),
    listJobs: (query) => data(v1.listJobs(query)),
    createBatch: (document) => data(v1.createBatch(document, { format: "json" })),
    getBatch: (id) => data(v1.getBatch(id, {}, { format: "json" })),
    refused: (body) => v1.createJob(form(body), { ratio: 7 }, { type, format: "json" }).catch((reply) => reply.error),
  };
});
