// Types of whittle.js.
//
// SPDX-License-Identifier: GPL-3.0-or-later
import type { Parameters } from "./parameters.js";

export type { Parameters };

/** A problem document (RFC 9457), with whatever members the problem has besides. */
export interface ProblemDocument {
  type?: string;
  title?: string;
  status?: number;
  detail?: string;
  errors?: { parameter: string; value?: string; allowed?: string; suggestion?: string }[];
  [member: string]: unknown;
}

/** What the service refused, or why a job failed. */
export class Problem extends Error {
  constructor(status: number, document: ProblemDocument);
  readonly status: number;
  readonly document: ProblemDocument;
}

export type Status = "accepted" | "running" | "successful" | "failed" | "dismissed";

/** The job's document; /openapi.json describes all of it. */
export interface Job {
  id: string;
  status: Status;
  stage: string | null;
  /** Percent. */
  progress: number;
  message: string | null;
  label: string | null;
  input: { cloud: string; points?: number | null; bytes: number; format: string };
  params: Record<string, unknown>;
  report: Record<string, unknown> | null;
  problem: ProblemDocument | null;
  [member: string]: unknown;
}

/** The document of a batch: jobs of several clouds that came together. */
export interface Batch {
  id: string;
  status: Status;
  /** Percent. */
  progress: number;
  finished: string | null;
  label: string | null;
  counts: Record<"total" | "deleted" | Status, number>;
  /** In the order of the clouds. */
  jobs: { id: string; status: Status; progress: number; cloud: string; href: string }[];
  [member: string]: unknown;
}

/** The cloud's document. */
export interface Cloud {
  id: string;
  bytes: number;
  format: string;
  [member: string]: unknown;
}

/** A Blob or File, bytes, or in Node the name of a file. */
export type Source = Blob | ArrayBuffer | ArrayBufferView | string | URL;

export interface Options {
  /** Ends the call. */
  signal?: AbortSignal;
}

export interface ClientOptions {
  /** Where the service wants one. */
  token?: string;
  /** How often what broke is tried again without a byte gained in between, after pauses that double; default 5. */
  retries?: number;
  /** In which some of a reply has to come, in ms; default 60 000. */
  timeout?: number;
  /** Of an upload; default 4 MiB. */
  pieceBytes?: number;
  /** In the place of the global one. */
  fetch?: typeof fetch;
}

export interface UploadOptions extends Options {
  onProgress?: (sentBytes: number, totalBytes: number) => void;
  /** The URL of the upload, for resume. */
  onStarted?: (url: string) => void;
  resume?: string;
}

export interface SubmitOptions extends Options {
  label?: string;
  /** 0 to 9, larger is sooner. */
  priority?: number;
  webhook?: string;
}

export interface OutputOptions extends Options {
  /** The coarser cloud of so many points. */
  points?: number;
  /** The coarser cloud of this part of the points. */
  ratio?: number;
}

export type Column =
  Int8Array | Uint8Array | Int16Array | Uint16Array | Int32Array | Uint32Array | Float32Array | Float64Array;

export interface Ply {
  count: number;
  /** x, y, z of each point; float64 where the file has that. */
  positions: Float32Array | Float64Array;
  /** Every other scalar property of the points, by its name. */
  attributes: Record<string, Column>;
  /** Three ids of each; empty for a cloud. */
  triangles: Uint32Array;
}

export class Client {
  constructor(url: string | URL, options?: ClientOptions);
  request(method: string, path: string, options?: Options & { headers?: HeadersInit; body?: BodyInit }): Promise<Response>;
  upload(source: Source, options?: UploadOptions): Promise<string>;
  clouds(options?: Options): Promise<Cloud[]>;
  simplify(cloud: Source | Source[], params?: Parameters, options?: SubmitOptions): Promise<Job>;
  batch(clouds: Source[], params?: Parameters, options?: SubmitOptions): Promise<Batch>;
  waitBatch(batch: Batch | string, options?: Options & { onProgress?: (batch: Batch) => void }): Promise<Batch>;
  cancelBatch(batch: Batch | string, options?: Options): Promise<Batch>;
  job(job: Job | string, options?: Options): Promise<Job>;
  jobs(options?: Options & { status?: Status; label?: string; limit?: number; after?: string }): Promise<Job[]>;
  wait(job: Job | string, options?: Options & { onProgress?: (job: Job) => void }): Promise<Job>;
  cancel(job: Job | string, options?: Options): Promise<Job>;
  outputUrl(job: Job | string, name: string, options?: { points?: number; ratio?: number }): string;
  output(job: Job | string, name: string, options?: OutputOptions): Promise<ArrayBuffer>;
  points(job: Job | string, options?: OutputOptions & { name?: string }): Promise<Ply>;
  mesh(job: Job | string, options?: OutputOptions & { name?: string }): Promise<Ply>;
}

/** A binary PLY file as typed arrays. */
export function readPly(buffer: ArrayBuffer | Uint8Array): Ply;
