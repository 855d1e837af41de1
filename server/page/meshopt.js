// SPDX-License-Identifier: GPL-3.0-or-later
// Unpacks what is packed by EXT_meshopt_compression (Khronos Group, 2021) in glTF, modes ATTRIBUTES, without filters, and
// INDICES, as core/io/out/meshopt.c writes them.  Attributes: blocks of elements, in planes of one byte of each, each byte as how far it
// is from the one before, in groups of sixteen of 0, 2, 4 or 8 bits.  Indices: how far each is from one
// of the two before that is nearer, in seven bits a byte.

const UNREAD = "The file is packed in a way that this page doesn't read", INDICES_MARK = 0xD1;
const MARK = 0xA0, BLOCK_BYTES = 8192, BLOCK_MOST = 256, GROUP = 16, LEAST_TAIL = 32;

// Reads a group's bytes from `at` on into `to`; returns where the next group is.
function readGroup(from, at, mode, to) {
  if (mode === 0) to.fill(0);
  if (mode === 3) for (let i = 0; i < GROUP; i++) to[i] = from[at + i];
  if (mode === 0 || mode === 3) return at + (mode ? GROUP : 0);
  const bits = 2 * mode, most = (1 << bits) - 1; // all ones: the number follows as a byte
  let more = at + GROUP * bits / 8;
  for (let i = 0; i < GROUP; i++) {
    const value = from[at + (i * bits >> 3)] >> 8 - bits - (i * bits & 7) & most;
    to[i] = value === most ? from[more++] : value;
  }
  return more;
}

// The n elements of `stride` bytes that `from` holds.
export function readAttributes(from, n, stride) {
  if (from[0] !== MARK) throw new Error(UNREAD);
  const to = new Uint8Array(n * stride), last = from.slice(from.length - stride), difference = new Uint8Array(GROUP);
  const block = Math.min(BLOCK_MOST, Math.floor(BLOCK_BYTES / stride / GROUP) * GROUP), end = from.length - Math.max(LEAST_TAIL, stride);
  let at = 1;
  for (let begin = 0; begin < n && at <= end; begin += block) {
    const count = Math.min(block, n - begin), groups = Math.ceil(count / GROUP);
    for (let k = 0; k < stride; k++) {
      const modes = at;
      at += Math.ceil(groups / 4);
      for (let g = 0; g < groups; g++) {
        at = readGroup(from, at, from[modes + (g >> 2)] >> 2 * (g & 3) & 3, difference);
        for (let i = g * GROUP; i < Math.min(count, (g + 1) * GROUP); i++) {
          const step = difference[i % GROUP];
          last[k] += step & 1 ? ~(step >> 1) : step >> 1;
          to[(begin + i) * stride + k] = last[k];
        }
      }
    }
  }
  if (at !== end) throw new Error("The file isn't whole");
  return to;
}

// What a view's extension describes, of a binary glTF's bytes.
export function readPacked(binary, { byteOffset = 0, byteLength, byteStride, count, mode, filter = "NONE" }) {
  if (mode !== "ATTRIBUTES" || filter !== "NONE") throw new Error(UNREAD);
  return readAttributes(binary.subarray(byteOffset, byteOffset + byteLength), count, byteStride);
}

// Indices of vertices that a view's extension describes.
export function readIndices(binary, { byteOffset = 0, count, mode }) {
  if (mode !== "INDICES" || binary[byteOffset] !== INDICES_MARK) throw new Error(UNREAD);
  const to = new Uint32Array(count), last = [0, 0];
  for (let i = 0, at = byteOffset + 1; i < count; i++) {
    let value = 0, bits = 0;
    for (; binary[at] & 0x80; bits += 7) value += (binary[at++] & 0x7f) * 2 ** bits;
    value += binary[at++] * 2 ** bits;
    const which = value & 1, folded = Math.floor(value / 2);
    last[which] += folded & 1 ? -(folded + 1) / 2 : folded / 2;
    to[i] = last[which];
  }
  return to;
}
