// Reads LAZ by laz-perf and compares it with the LAS of the same points, byte for byte: node compare_laz.js LAZ LAS
// SPDX-License-Identifier: GPL-3.0-or-later
'use strict';
const fs = require('fs');
const { createLazPerf } = require('laz-perf');

const FIRST_POINT = 96, RECORD_BYTES = 105;

async function main() {
    const [laz, las] = process.argv.slice(2).map((path) => fs.readFileSync(path));
    const lazPerf = await createLazPerf();
    const first = las.readUInt32LE(FIRST_POINT), each = las.readUInt16LE(RECORD_BYTES);
    const bytes = lazPerf._malloc(laz.length), record = lazPerf._malloc(each), reader = new lazPerf.LASZip();
    lazPerf.HEAPU8.set(laz, bytes);
    reader.open(bytes, laz.length);
    const count = reader.getCount();
    for (let i = 0; i < count; i++) {
        reader.getPoint(record);
        const expected = las.subarray(first + i * each, first + (i + 1) * each);
        if (expected.compare(lazPerf.HEAPU8.subarray(record, record + each)) !== 0) throw new Error(`point ${i} differs`);
    }
    console.log(`${count} points`);
}

main().catch((error) => {
    console.error(error.message || error);
    process.exitCode = 1;
});
