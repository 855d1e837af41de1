// SPDX-License-Identifier: GPL-3.0-or-later
// Decodes all views of binary glTF with EXT_meshopt_compression by its makers' decoder, and writes the bytes that they
// stand for, one view behind the other: node decode_meshopt.mjs FILE ... (writes FILE.plain)
import { readFileSync, writeFileSync } from "node:fs";
import { MeshoptDecoder } from "three/examples/jsm/libs/meshopt_decoder.module.js";

await MeshoptDecoder.ready;
for (const path of process.argv.slice(2)) {
  const file = readFileSync(path);
  const length = file.readUInt32LE(12);
  const scene = JSON.parse(file.subarray(20, 20 + length));
  const binary = file.subarray(28 + length);
  const views = scene.bufferViews.map((view) => {
    const { byteOffset, byteLength, byteStride, count, mode } = view.extensions.EXT_meshopt_compression;
    const plain = new Uint8Array(count * byteStride);
    MeshoptDecoder.decodeGltfBuffer(plain, count, byteStride, binary.subarray(byteOffset, byteOffset + byteLength), mode);
    return plain.subarray(0, view.byteLength);
  });
  writeFileSync(`${path}.plain`, Buffer.concat(views));
}
