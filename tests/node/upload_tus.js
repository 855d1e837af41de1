// SPDX-License-Identifier: GPL-3.0-or-later
// Uploads a file with tus-js-client, as often interrupted as it may be, and prints the upload's URL.
//
// Usage: node upload_tus.js ENDPOINT FILE [CHUNK_BYTES [PARTS [PROTOCOL]]]     (in so many parts side by side)
"use strict";
const fs = require("fs");
const tus = require("tus-js-client");

const [endpoint, path, chunk, parts, protocol] = process.argv.slice(2);
const upload = new tus.Upload(parts ? fs.readFileSync(path) : fs.createReadStream(path), {
  endpoint,
  chunkSize: chunk ? Number(chunk) : Infinity,
  ...(parts ? { parallelUploads: Number(parts) } : { uploadSize: fs.statSync(path).size }),
  ...(protocol ? { protocol } : {}),
  metadata: { filename: "a cloud.xyz", filetype: "text/plain" },
  retryDelays: Array(200).fill(20),
  onError: (error) => {
    console.error(String(error));
    process.exit(1);
  },
  onSuccess: () => {
    console.log(upload.url);
    process.exit(0);
  },
});
upload.start();
