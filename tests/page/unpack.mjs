// SPDX-License-Identifier: GPL-3.0-or-later
// Writes FILE.plain beside each binary glTF: its packed views as the page's reader unpacks them, one behind the other.
//
// Usage: node unpack.mjs FILE...
import { readFileSync, writeFileSync } from "node:fs";

import { readPacked } from "../../server/page/meshopt.js";

for (const path of process.argv.slice(2)) {
  const file = readFileSync(path), length = file.readUInt32LE(12), { bufferViews } = JSON.parse(file.subarray(20, 20 + length).toString());
  const packed = bufferViews.map(({ extensions }) => readPacked(file.subarray(28 + length), extensions.EXT_meshopt_compression));
  writeFileSync(`${path}.plain`, Buffer.concat(packed));
}
