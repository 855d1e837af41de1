// Validates binary glTF by Khronos' own validator: node validate_glb.js FILE ...
// SPDX-License-Identifier: GPL-3.0-or-later
'use strict';
const fs = require('fs');
const validator = require('gltf-validator');

async function main() {
    for (const path of process.argv.slice(2)) {
        const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(path)));
        const problems = report.issues.messages.filter((message) => message.severity < 2);
        for (const problem of problems) console.log(`${path}: ${problem.code}: ${problem.message} ${problem.pointer}`);
        if (problems.length > 0) process.exitCode = 1;
    }
}

main();
