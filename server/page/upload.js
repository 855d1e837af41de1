// SPDX-License-Identifier: GPL-3.0-or-later
// A file becomes a cloud of the service, by a resumable upload.
import { adviceOn, authorization, base } from "./api.js";

const PIECE_BYTES = 8 * 1024 * 1024; // what a broken connection loses at most
const PAUSES_MS = [500, 1000, 2000, ...new Array(100).fill(3000)]; // five minutes without an answer

// Where uploads that broke off are remembered.  A browser that keeps nothing, or has no room, costs that alone.
function memory() {
  const { urlStorage: kept } = globalThis.tus.defaultOptions, none = () => [];
  const or = (work, instead) => new Promise((resolve) => resolve(work())).catch(instead);
  return { findAllUploads: () => or(() => kept.findAllUploads(), none), findUploadsByFingerprint: (print) => or(() => kept.findUploadsByFingerprint(print), none),
    removeUpload: (key) => or(() => kept.removeUpload(key), () => {}), addUpload: (print, upload) => or(() => kept.addUpload(print, upload), () => null) };
}

// The file was moved, changed or deleted meanwhile.
class Gone extends Error {
  constructor() {
    super("the file can't be read any more. Was it moved or changed? Choose it again.");
  }
}

// Calls progress(sent, all), and broken() where no answer came and it tries again; gives the cloud's id.  signal stops it;
// the same file goes on where it stopped.
export async function upload(file, { progress, broken }, signal) {
  await import("tus-js-client");
  let cloud = null;
  await new Promise((resolve, reject) => {
    const sending = new globalThis.tus.Upload(file, {
      endpoint: `${base}/v1/uploads`,
      chunkSize: PIECE_BYTES,
      retryDelays: PAUSES_MS,
      onShouldRetry: (error) => {
        const status = error.originalResponse?.getStatus() ?? 0;
        if (!status) {
          broken();
          file.slice(0, 1).arrayBuffer().catch(() => sending.abort().finally(() => reject(new Gone())));
        }
        return !status || [409, 423, 502, 503, 504].includes(status);
      },
      headers: authorization(),
      urlStorage: memory(),
      metadata: { filename: file.name.slice(0, 200) },
      removeFingerprintOnSuccess: true,
      onAfterResponse: (request, response) => {
        const named = response.getHeader("Whittle-Cloud");
        if (named) cloud = named.split("/").pop();
      },
      onProgress: progress,
      onSuccess: resolve,
      onError: reject,
    });
    signal?.addEventListener("abort", () => sending.abort().then(() => reject(new Error("stopped")), reject));
    sending.findPreviousUploads().then((previous) => {
      if (previous.length) sending.resumeFromPreviousUpload(previous[0]);
      sending.start();
    }, () => sending.start());
  });
  if (!cloud) throw new Error("the service didn't name the cloud");
  return cloud;
}

// What the service said, of a failure of the above, and what to do about it.
export function reasonOf(error) {
  try {
    const said = JSON.parse(error.originalResponse.getBody());
    return { status: error.originalResponse.getStatus(), text: `${(said.detail || said.title).replace(/^the body\b/, "it")}. ${adviceOn(said)}` };
  } catch {
    const status = error.originalResponse?.getStatus?.() ?? 0;
    return { status, text: status || error instanceof Gone ? error.message : "the service doesn't answer. What has come there is kept for a day: drop the same file again and it goes on." };
  }
}
