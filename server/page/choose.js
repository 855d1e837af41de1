// SPDX-License-Identifier: GPL-3.0-or-later
// What is asked for: a goal, outputs, and every other parameter as /v1/parameters describes it.
import { askJson, base } from "./api.js";
import { bytes, count, figure, find, make, percent, seconds } from "./words.js";

const OUTPUTS = [["cloud", "Cloud"], ["mesh", "Mesh"], ["error", "Deviation of every point"], ["preview.png", "Picture"],
  ["dso", "Shape operator"], ["mesh.glb", "Mesh as glTF"], ["mesh.obj", "Mesh as OBJ"], ["mesh.stl", "Mesh as STL"],
  ["cloud.las", "Cloud as LAS"], ["cloud.laz", "Cloud as LAZ"], ["cloud.pcd", "Cloud as PCD"], ["xyz", "Cloud as text"]];
const USUAL = ["cloud", "mesh", "error", "preview.png"], SMALL = ["cloud", "preview.png"];
const MANY = 3000000; // points beyond which a mesh isn't the first suggestion
const ELSEWHERE = ["ratio", "points", "max_deviation", "max_deviation_rel", "outputs", "threads"];

const PAUSE_MS = 150;

let cloud = null, schema = null, planning = 0;

const goalName = () => document.querySelector('input[name="goal"]:checked').value;

// The slider's places are even in powers of ten: 0.001 to 1 of the points, 0.00001 to 0.01 of the diagonal.
const goalValue = () => Number((10 ** (find("goal-slider").value / 100 - (goalName() === "ratio" ? 3 : 5))).toPrecision(3));

function diagonal() {
  const box = cloud?.bounding_box;
  return box ? Math.hypot(...box.max.map((high, i) => high - box.min[i])) : null;
}

function sayGoal() {
  const value = goalValue(), slider = find("goal-slider");
  let text = `${percent(value)} of the box's diagonal`;
  if (goalName() === "ratio") {
    text = percent(value);
    if (cloud?.points) text += `: ${count(Math.max(1, Math.floor(value * cloud.points)))} of ${count(cloud.points)} points`;
  } else if (diagonal()) text += `, ${figure(value * diagonal())} in the file's units; takes about ten times as long`;
  else text += "; takes about ten times as long";
  find("goal-label").textContent = goalName() === "ratio" ? "Share of the points" : "Largest deviation";
  find("goal-text").textContent = text;
  slider.setAttribute("aria-valuetext", text);
  sayCommand();
  sayPlan();
}

// What differs from the defaults.
export function chosen() {
  const params = { [goalName()]: goalValue() };
  params.outputs = [...document.querySelectorAll("#choose-outputs input:checked")].map((box) => box.value);
  for (const input of document.querySelectorAll("#choose-more [name]")) {
    const row = schema[input.name];
    if (input.value === "" || input.value === String(row.default ?? "")) continue;
    if (row.type === "number" || row.type === "integer") params[input.name] = Number(input.value);
    else if (row.type === "array") params[input.name] = input.value.split(",").map(Number);
    else params[input.name] = input.value;
  }
  return params;
}

const queryOf = (params) => Object.entries(params)
  .map(([key, value]) => `${key}=${encodeURIComponent(value).replaceAll("%2C", ",")}`).join("&");

export function commandOf(params, name) {
  const quoted = `'${(name || "scan.ply").replaceAll("'", "'\\''")}'`;
  return `curl -sS --fail-with-body -X POST -T ${quoted} \\\n  '${location.origin}${base}/v1/jobs?${queryOf(params)}'`;
}

// What the service foresees for what is chosen, once that has stood still for a moment.
function sayPlan() {
  clearTimeout(planning);
  planning = setTimeout(async () => {
    const asked = cloud.id, query = queryOf(chosen());
    let text = "";
    try {
      const plan = await askJson(`/v1/clouds/${asked}/plan?${query}`);
      if (plan.problem) text = `${plan.problem.detail}${plan.problem.hint ? `; ${plan.problem.hint}` : ""}`;
      else if (plan.memory_bytes) text = `Takes up to ${bytes(plan.memory_bytes)} of ${bytes(plan.memory_limit_bytes)}`;
      else text = "How much memory it takes is known once the file has been read";
      if (!plan.problem) text += plan.seconds === null ? "." : `, about ${seconds(plan.seconds)}.`;
    } catch (error) {
      text = error.message;
    }
    if (asked === cloud.id && query === queryOf(chosen())) find("choose-plan").textContent = text;
  }, PAUSE_MS);
}

const sayCommand = () => { find("choose-curl").textContent = commandOf(chosen(), cloud?.label); };

function fieldOf(name, row) {
  const id = `param-${name}`, attributes = { id, name, "aria-describedby": `${id}-help` };
  let input;
  if (row.enum) {
    input = make("select", attributes, ...row.enum.map((each) => make("option", { selected: each === row.default }, each)));
  } else {
    const numeric = row.type === "number" || row.type === "integer";
    input = make("input", { ...attributes, type: numeric ? "number" : "text", step: row.type === "integer" ? 1 : "any",
      min: row.minimum, max: row.maximum, placeholder: row.default ?? "" });
  }
  return make("div", {}, make("label", { for: id }, name.replaceAll("_", " ")), input,
    make("p", { id: `${id}-help` }, `${row.description}.`));
}

async function fillForm() {
  schema = (await askJson("/v1/parameters")).properties;
  const rows = Object.entries(schema).filter(([name, row]) => !ELSEWHERE.includes(name) && !row.deprecated);
  find("choose-more").replaceChildren(...rows.map(([name, row]) => fieldOf(name, row)));
}

function fact(name, value) {
  return make("div", {}, make("dt", {}, name), make("dd", {}, value));
}

// Shows the form for a cloud, as the service describes it, with what is to be filled in already.
export async function choose(described, params = {}) {
  cloud = described;
  if (!schema) await fillForm();
  const box = cloud.bounding_box, usual = cloud.points > MANY ? SMALL : USUAL;
  find("cloud-facts").replaceChildren(
    fact("File", cloud.label || cloud.id.slice(0, 12)), fact("Format", cloud.format?.replace("/", ", ").replaceAll("_", " ") ?? "unknown"), fact("Size", bytes(cloud.bytes)),
    fact("Points", cloud.points ? count(cloud.points) : "counted when it is read"),
    ...(cloud.properties ? [fact("Properties", cloud.properties.map((p) => p.name).join(", "))] : []),
    ...(box ? [fact("Box", box.max.map((high, i) => figure(high - box.min[i])).join(" × "))] : []));
  const wanted = params.outputs?.filter((name) => name !== "report") ?? usual;
  find("choose-outputs").replaceChildren(...OUTPUTS.map(([value, text]) => make("label", {},
    make("input", { type: "checkbox", value, checked: wanted.includes(value) }), ` ${text}`)));
  const bounded = params.max_deviation_rel;
  document.querySelector(`input[name="goal"][value="${bounded ? "max_deviation_rel" : "ratio"}"]`).checked = true;
  const value = bounded ? 100 * (Math.log10(bounded) + 5) : 100 * (Math.log10(params.ratio ?? 0.1) + 3);
  find("goal-slider").value = Math.round(value);
  for (const input of document.querySelectorAll("#choose-more [name]")) {
    const given = params[input.name], usualValue = schema[input.name].default;
    input.value = given !== undefined && String(given) !== String(usualValue) ? given : input.matches("select") ? usualValue : "";
  }
  sayGoal();
}

find("choose-form").addEventListener("input", sayGoal);
