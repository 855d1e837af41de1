// SPDX-License-Identifier: GPL-3.0-or-later
// A file becomes a cloud of the service, by a resumable upload.
import { authorization, base } from "./api.js";

const PIECE_BYTES = 8 * 1024 * 1024; // what a broken connection loses at most

// Calls progress(sent, all); gives the cloud's id.  signal stops it; the same file goes on where it stopped.
export async function upload(file, progress, signal) {
  await import("tus-js-client");
  let cloud = null;
  await new Promise((resolve, reject) => {
    const sending = new globalThis.tus.Upload(file, {
      endpoint: `${base}/v1/uploads`,
      chunkSize: PIECE_BYTES,
      retryDelays: [0, 1000, 3000, 5000, 10000],
      headers: authorization(),
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

// What the service said, of a failure of the above.
export function reasonOf(error) {
  try {
    const said = JSON.parse(error.originalResponse.getBody());
    return { status: error.originalResponse.getStatus(), text: said.detail || said.title };
  } catch {
    return { status: error.originalResponse?.getStatus?.() ?? 0, text: error.message };
  }
}
