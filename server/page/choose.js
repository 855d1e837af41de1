// SPDX-License-Identifier: GPL-3.0-or-later
// What is asked for: a goal, outputs, and every other parameter as /v1/parameters describes it.
import { askJson, base } from "./api.js";
import { bytes, count, figure, find, make, percent, seconds } from "./words.js";

const OUTPUTS = [
  ["Points as", [["cloud", "PLY"], ["cloud.las", "LAS"], ["cloud.laz", "LAZ"], ["cloud.copc.laz", "COPC"], ["cloud.pcd", "PCD"], ["xyz", "text (XYZ)"], ["tileset", "3D Tiles"]]],
  ["Mesh as", [["mesh", "PLY"], ["mesh.glb", "glTF"], ["mesh.obj", "OBJ"], ["mesh.stl", "STL"]]],
  ["What is lost", [["error", "deviation of every point"], ["preview.png", "picture (PNG)"], ["dso", "shape operator"]]],
];
const USUAL = ["cloud", "mesh", "error", "preview.png"], SMALL = ["cloud", "tileset", "preview.png"];
const MANY = 3000000; // points beyond which a mesh isn't the first suggestion
const ELSEWHERE = ["ratio", "points", "levels", "max_deviation", "max_deviation_rel", "outputs", "threads"];
const FIRST = { // what isn't folded away, and what its values mean
  placement: ["Vertices of the mesh", { auto: "chosen automatically", subset: "points of the file", optimal: "moved for the least error" }],
  surface: ["What was scanned", { auto: "detected automatically", closed: "a solid, all around", open: "a room, or one side", heightfield: "terrain, from above", given: "the file's own faces" }],
};
const COLUMNS = ["What the columns are, in their order", {}]; // of a text alone
const FIELDS = "#choose-first [name], #choose-more [name]";
const PLACES = 300; // of the slider

const PAUSE_MS = 150;

let cloud = null, schema = null, planning = 0, goal = { name: "ratio", value: 0.1 };

function diagonal() {
  const box = cloud?.bounding_box;
  return box ? Math.hypot(...box.max.map((high, i) => high - box.min[i])) : null;
}

// Each goal: the ends of its slider, whose places are even in powers of ten; the number that people write for a value,
// and back; and what it means.  Deviations are shares of the box's diagonal, written in the file's units once it is known.
const GOALS = {
  ratio: {
    label: "Share of the points, in percent", unit: "\u00a0%", ends: () => [0.001, 1], first: 0.1,
    write: (value) => 100 * value, read: (number) => number / 100,
    text: (value) => percent(value) + (cloud?.points ? `: ${count(Math.max(1, Math.floor(value * cloud.points)))} of ${count(cloud.points)} points` : ""),
  },
  points: {
    label: "Points", ends: () => [10, cloud?.points || 1e7], first: 10000,
    write: (value) => value, read: Math.round,
    text: (value) => `${count(value)}${cloud?.points ? ` of ${count(cloud.points)}` : ""} points${cloud?.points ? `, ${percent(value / cloud.points)}` : ""}`,
  },
  max_deviation_rel: {
    label: () => (diagonal() ? "Largest deviation, in the file's units" : "Largest deviation, in percent of the box's diagonal"),
    ends: () => [0.00001, 0.01], first: 0.001,
    write: (value) => value * (diagonal() ?? 100), read: (number) => number / (diagonal() ?? 100),
    text: (value) => `no point farther than ${percent(value)} of the box's diagonal${diagonal() ? `, ${figure(value * diagonal())} in the file's units,` : ""} from the mesh; takes about ten times as long`,
  },
  max_deviation: { // of a file whose box isn't known yet: a number alone
    label: "Largest deviation, in the file's units", write: (value) => value, read: (number) => number,
    text: (value) => (value ? `no point farther than ${figure(value)}, in the file's units, from the mesh; takes about ten times as long`
      : "how far the result may be off: 0.005 is 5 mm where the file's units are metres"),
  },
};
const round = (value) => Number(value.toPrecision(3));

// Puts the slider and the number where the goal is; `writing` is the one that is just moved.
function placeGoal(writing) {
  const several = goal.name === "levels", { label, ends, write, unit = "" } = GOALS[goal.name] ?? GOALS.ratio;
  find("goal-one").hidden = several;
  find("goal-several").hidden = !several;
  if (several) return;
  const text = typeof label === "function" ? label() : label, number = find("goal-number");
  find("goal-label").textContent = text;
  find("goal-unit-row").hidden = !goal.name.startsWith("max_deviation") || diagonal() !== null;
  find("goal-unit").value = goal.name;
  find("goal-slider").hidden = find("goal-scale").hidden = !ends;
  number.required = !ends;
  if (writing !== "goal-number") number.value = goal.value ? Number(write(goal.value).toPrecision(4)) : "";
  if (!ends) return;
  const [low, high] = ends();
  find("goal-slider").setAttribute("aria-label", text);
  if (writing !== "goal-slider") find("goal-slider").value = Math.round(PLACES * Math.log(goal.value / low) / Math.log(high / low));
  const tick = (share) => `${figure(round(write(low * (high / low) ** share)))}${unit}`;
  find("goal-scale").replaceChildren(...[0, 1 / 3, 2 / 3, 1].map((share) => make("span", {}, tick(share))));
}

const levels = () => find("goal-levels").value.split(/[\s,;]+/).filter(Boolean).map((each) => round(Number(each) / 100));

function sayGoal() {
  const text = goal.name === "levels" ? levels().map(GOALS.ratio.text).join("; ") : GOALS[goal.name].text(goal.value);
  find("goal-text").textContent = text;
  find("goal-slider").setAttribute("aria-valuetext", text);
  sayCommand();
  sayPlan();
}

function changeGoal({ target }) {
  if (target.name === "goal" || target.id === "goal-unit") goal = { name: target.value, value: GOALS[target.value]?.first };
  const [low, high] = (GOALS[goal.name] ?? GOALS.ratio).ends?.() ?? [];
  if (target.id === "goal-slider") goal.value = Number(target.value) === PLACES ? high : round(low * (high / low) ** (target.value / PLACES));
  if (target.id === "goal-number" && target.value > 0) goal.value = GOALS[goal.name].read(Number(target.value));
  if (target.id === "goal-number" && !target.value && goal.name === "max_deviation") goal.value = undefined;
  if (goal.name === "points" && goal.value) goal.value = Math.max(1, Math.min(high, Math.round(goal.value)));
  placeGoal(target.id);
  sayGoal();
}

// What differs from the defaults.
export function chosen() {
  const params = goal.name === "levels" ? { levels: levels() } : goal.value ? { [goal.name]: goal.value } : {};
  params.outputs = [...document.querySelectorAll("#choose-outputs input:checked")].map((box) => box.value);
  for (const input of document.querySelectorAll(FIELDS)) {
    const row = schema[input.name];
    if (input.value === "" || input.value === String(row.default ?? "")) continue;
    if (row.type === "number" || row.type === "integer") params[input.name] = Number(input.value);
    else if (row.type === "array") params[input.name] = input.value.split(",").map((each) => (row.items.type === "number" ? Number(each) : each.trim()));
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
      else if (plan.memory_bytes) text = `Needs up to ${bytes(plan.memory_bytes)} of memory (${bytes(plan.memory_limit_bytes)} available)`;
      else text = "How much memory it needs is known once the file has been read";
      if (!plan.problem) text += plan.seconds === null ? "." : ` and about ${seconds(plan.seconds)}.`;
    } catch (error) {
      text = error.message;
    }
    if (asked === cloud.id && query === queryOf(chosen())) find("choose-plan").textContent = text;
  }, PAUSE_MS);
}

const sayCommand = () => { find("choose-curl").textContent = commandOf(chosen(), cloud?.label); };

function fieldOf(name, row, [label, words] = [name.replaceAll("_", " "), {}]) {
  const id = `param-${name}`, attributes = { id, name, "aria-describedby": `${id}-help` };
  let input;
  if (row.enum) {
    input = make("select", attributes, ...row.enum.map((each) => make("option", { value: each, selected: each === row.default }, words[each] ?? each)));
  } else {
    const numeric = row.type === "number" || row.type === "integer";
    input = make("input", { ...attributes, type: numeric ? "number" : "text", step: row.type === "integer" ? 1 : "any",
      min: row.minimum, max: row.maximum, placeholder: row.default ?? "" });
  }
  return make("div", {}, make("label", { for: id }, label), input,
    make("p", { id: `${id}-help` }, `${row.description}.`));
}

async function fetchSchema() {
  schema = (await askJson("/v1/parameters")).properties;
}

// Of a text, columns are among what isn't folded away.
function fillForm(isText) {
  const first = { ...FIRST, ...(isText ? { columns: COLUMNS } : {}) };
  const rows = Object.entries(schema).filter(([name, row]) => !ELSEWHERE.includes(name) && !row.deprecated);
  find("choose-first").replaceChildren(...Object.entries(first).map(([name, said]) => fieldOf(name, schema[name], said)));
  find("choose-more").replaceChildren(...rows.filter(([name]) => !first[name]).map(([name, row]) => fieldOf(name, row)));
}

function fact(name, value) {
  return make("div", {}, make("dt", {}, name), make("dd", {}, value));
}

// Shows the form for a cloud, as the service describes it, with what is to be filled in already.
export async function choose(described, params = {}) {
  cloud = described;
  if (!schema) await fetchSchema();
  fillForm(cloud.format === "xyz");
  const box = cloud.bounding_box, usual = cloud.points > MANY ? SMALL : USUAL;
  find("cloud-facts").replaceChildren(
    fact("File", cloud.label || cloud.id.slice(0, 12)), fact("Format", cloud.format?.replace(/^[^/]+/, (name) => name.toUpperCase()).replace("/", ", ").replace(/_(little|big)_endian/, "").replaceAll("_", " ") ?? "unknown"), fact("Size", bytes(cloud.bytes)),
    fact("Points", Number.isInteger(cloud.points) ? count(cloud.points) : "counted when it is read"),
    ...(cloud.properties ? [fact("Properties", cloud.properties.map((p) => p.name).join(", "))] : []),
    ...(box ? [fact("Box", box.max.map((high, i) => figure(high - box.min[i])).join(" × "))] : []));
  const wanted = params.outputs?.filter((name) => name !== "report") ?? usual;
  find("choose-outputs").replaceChildren(...OUTPUTS.map(([group, rows]) => make("div", { class: "outputs", role: "group", "aria-label": group },
    make("span", {}, group), make("div", { class: "checks" }, ...rows.map(([value, text]) => make("label", {},
      make("input", { type: "checkbox", value, checked: wanted.includes(value) }), ` ${text}`))))));
  if (params.max_deviation && diagonal()) params = { ...params, max_deviation_rel: params.max_deviation / diagonal() };
  const name = ["levels", "max_deviation_rel", "max_deviation", "ratio", "points"].find((each) => params[each]) ?? "ratio";
  goal = { name, value: params[name] ?? GOALS[name]?.first };
  if (name === "levels") find("goal-levels").value = params.levels.map((each) => round(100 * each)).join(", ");
  document.querySelector(`input[name="goal"][value="${name.replace(/^max_deviation$/, "max_deviation_rel")}"]`).checked = true;
  placeGoal();
  for (const input of document.querySelectorAll(FIELDS)) {
    const given = params[input.name], usualValue = schema[input.name].default;
    input.value = given !== undefined && String(given) !== String(usualValue) ? given : input.matches("select") ? usualValue : "";
  }
  sayGoal();
}

find("choose-form").addEventListener("input", changeGoal);
