// SPDX-License-Identifier: GPL-3.0-or-later
// Validates Kubernetes objects, a JSON array on standard input, against the JSON schemas of their kinds.  Prints what
// is wrong, one line each; exit status 1 when there is something.
const fs = require("fs");

const places = ["kubernetes-models", "@kubernetes-models/prometheus-operator"];

function modelOf(object) {
  const wanted = `${object.apiVersion}/${object.kind}`;
  for (const place of places) {
    for (const path of [wanted, wanted.replace(/^([^./]+)\.k8s\.io\//, "$1.k8s.io/")]) {
      try {
        return require(`${place}/${path}`)[object.kind];
      } catch (error) {
        if (error.code !== "MODULE_NOT_FOUND" && error.code !== "ERR_PACKAGE_PATH_NOT_EXPORTED") throw error;
      }
    }
  }
  throw new Error("no schema is known for it");
}

let wrong = 0;
for (const object of JSON.parse(fs.readFileSync(0, "utf8"))) {
  const name = `${object.kind} ${object.metadata && object.metadata.name}`;
  try {
    const model = new (modelOf(object))(object);
    model.validate();
    console.log(`ok ${name}`);
  } catch (error) {
    console.log(`${name}: ${error.message}`);
    wrong = 1;
  }
}
process.exitCode = wrong;
