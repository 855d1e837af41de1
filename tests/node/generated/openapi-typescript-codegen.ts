// SPDX-License-Identifier: GPL-3.0-or-later
// Its functions take parameters by place; those that aren't given are named here to find theirs.
import { BatchesService, CloudsService, JobsService, OpenAPI, OutputsService, ServiceService } from "../generated-by/openapi-typescript-codegen";
import { main } from "./calls";

/* The arguments of a function in their order, by name. */
function places(call: Function, given: Record<string, any>): any[] {
  const names = call.toString().match(/^[^(]*\(([^)]*)\)/)![1].split(",").map((each) => each.trim().split(/\s|=/)[0]);
  return names.map((name) => given[name]);
}

main((url, token) => {
  OpenAPI.BASE = url;
  OpenAPI.TOKEN = token;
  const by = (service: any, name: string, given: any) => service[name](...places(service[name], given));
  const blob = async (reply: any) => new Blob([await reply]);
  return {
    info: () => ServiceService.getInfo(),
    createJob: (requestBody, query) => by(JobsService, "createJob", { requestBody, ...query }),
    getJob: (id) => by(JobsService, "getJob", { id }),
    getOutput: (id, name) => blob(by(OutputsService, "getOutput", { id, name })),
    createCloud: (requestBody) => by(CloudsService, "createCloud", { requestBody }),
    createCloudJob: (id, requestBody) => by(CloudsService, "createCloudJob", { id, requestBody }),
    simplify: (requestBody, query) => blob(by(JobsService, "simplify", { requestBody, ...query })),
    listJobs: (query) => by(JobsService, "listJobs", query),
    createBatch: (requestBody) => by(BatchesService, "createBatch", { requestBody }),
    getBatch: (id) => by(BatchesService, "getBatch", { id }),
    refused: (requestBody) => by(JobsService, "createJob", { requestBody, ratio: 7 }).catch((error: any) => error.body),
  };
});
