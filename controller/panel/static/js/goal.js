// The card of the goal: number fields, the plan in words, Go and Hold now.

import { inWords } from "./connection.js";
import { el, fill, number, unitMark } from "./dom.js";
import { situation } from "./editor.js";
import { incomplete, showFields } from "./goal-fields.js";
import { showPoses } from "./poses.js";
import { showProgress } from "./progress.js";

const CERTIFICATES = {
  optimal: "proven optimal: no collision-free configuration costs less",
  unreachable: "proven unreachable",
  unknown: "unknown: fewer switches may suffice",
};

export function showGoal(connection, editor, notify) {
  const card = document.getElementById("goal");
  let fields = null; // of the arm's dimension
  const message = el("p", { class: "message", role: "status" });
  const { words, showPlan } = planCard(connection);
  const why = el("p", { class: "why", role: "status" }); // why Go is disabled
  const go = el("button", { type: "button", id: "go", class: "primary" }, "Go");
  const cancel = el("button", { type: "button", id: "cancel" }, "Hold now");
  const clear = el("button", { type: "button" }, "Clear");
  const brief = el("span", {}); // the plan in a line, beside Go on a small screen
  const answer = document.getElementById("answer"); // the same below the picture on a large screen
  const pace = el("b", {}); // the progress in a line
  const bar = el("div", { class: "go-bar" }, el("span", { class: "brief" }, pace, brief), go);
  const upload = el("input", { type: "file", accept: ".csv,.json,.yaml,.yml", id: "upload" });
  const progress = showProgress(connection, pace);
  card.append(
    progress,
    el("div", { class: "buttons" }, bar, cancel, clear),
    why,
    el("label", { class: "upload" }, "Goal file ", upload),
    showPoses(connection, editor, notify),
    words,
    message,
  );
  let arm = null;
  let sent = null; // the goal that Go sent, until it has ended
  let silent = false; // whether the arm's values are old
  let going = false; // whether the answer to Go is awaited
  let before = ""; // what the card said of the arm's state
  let about = ""; // the goal that the message is about
  const say = (text, fine) => {
    about = JSON.stringify(editor.goal);
    message.textContent = text;
    message.classList.toggle("bad", !fine);
  };
  connection.on("arm", (description) => {
    if (fields === null || arm.dimension !== description.dimension) {
      fields?.remove();
      fields = showFields(editor, description);
      card.querySelector("h2").after(fields);
    }
    arm = description;
    describe();
  });
  go.addEventListener("click", async () => {
    going = go.disabled = true;
    const goal = JSON.stringify(editor.goal);
    const answer = await editor.go();
    going = false;
    sent = answer.accepted ? { id: answer.id, goal } : sent;
    describe();
    say(inWords(answer), answer.accepted);
    showResult(connection.latest.goals ?? { goals: [] }); // it may have come before this answer
  });
  connection.on("goals", showResult);

  function showResult({ goals }) {
    const entry = goals.find(({ id }) => id === sent?.id);
    if (!entry || entry.status === "running") return;
    say(`${entry.status}: ${entry.message ?? ""}`, entry.status === "succeeded");
    if (entry.status === "succeeded" && JSON.stringify(editor.goal) === sent.goal) editor.clear();
    sent = null;
  }
  connection.on("state", (state) => {
    const now = JSON.stringify([state.mode, state.goal, situation(state)]);
    if (now === before) return;
    before = now;
    editor.changed(); // the plan began in another state
  });
  cancel.addEventListener("click", async () => notify(await connection.ask({ do: "cancel" }), "Hold now"));
  clear.addEventListener("click", () => {
    message.textContent = "";
    editor.clear();
  });
  upload.addEventListener("change", async () => {
    if (upload.files.length) await openFile(upload.files[0]);
    upload.value = "";
  });
  const view = document.querySelector(".view");
  view.addEventListener("dragover", (event) => event.preventDefault()); // otherwise the browser opens the file
  view.addEventListener("drop", (event) => {
    event.preventDefault();
    const [file] = event.dataTransfer.files;
    if (file && connection.mayCommand) openFile(file);
  });

  async function openFile(file) {
    await editor.open({ do: "file", text: await file.text(), name: file.name });
  }
  editor.on(describe);
  connection.on("you", describe);

  function describe() {
    if (arm === null) return;
    const obstacle = incomplete(fields, editor) ? "A field of the goal has no number." : goObstacle(editor, sent, silent);
    go.disabled = going || editor.goal === null || obstacle !== "" || document.body.classList.contains("viewer");
    const running = !go.disabled && editor.state?.mode === "executing";
    const note = running ? "Go replaces the running goal." : editor.goal === null ? "" : obstacle;
    if (why.textContent !== note) why.textContent = note;
    words.classList.toggle("late", editor.goal !== null && !editor.upToDate);
    const line = obstacle === REFUSED ? refusal(editor) : editor.goal === null ? hint(editor) : note || inBrief(editor.validPlan);
    for (const place of [brief, answer]) {
      if (place.textContent !== line) place.textContent = place.title = line;
      place.classList.toggle("bad", obstacle === REFUSED);
    }
    if (editor.goal !== null && JSON.stringify(editor.goal) !== about) message.textContent = "";
    showPlan(editor);
  }
  const watch = setInterval(() => {
    if (!go.isConnected) return clearInterval(watch); // the login form is shown
    const now = connection.silence() !== null;
    if (now !== silent) {
      silent = now;
      describe();
    }
  }, 200);
  describe();
}

const REFUSED = "This goal cannot be planned.";

// Why Go is not possible now; "" if it is. Go starts only what the plan shows, or replaces a goal of this page.
function goObstacle(editor, sent, silent) {
  const { state } = editor;
  if (state === null) return "Nothing was heard from the arm yet.";
  if (silent) return "Nothing is heard from the arm. Go is possible when it is heard again.";
  if (state.mode === "executing") {
    return sent !== null && state.goal === sent.id ? ""
      : `The arm carries out ${state.goal ? `the goal ${state.goal}` : "a motion"}: wait, or press Hold now. The goal is planned when the arm is ready.`;
  }
  if (!editor.ready) return `The arm is not ready (${state.mode}). The goal is planned when it is.`;
  if (!editor.upToDate) return "Planning from the present state …";
  return editor.plan.accepted ? "" : REFUSED;
}

// The words of a refusal. A goal of one point needs no number.
function refusal(editor) {
  const words = inWords(editor.plan);
  return `✗ ${editor.points.length > 1 ? words : words.replace(/^point 1: /, "")}`;
}

function inBrief(plan) {
  if (!plan?.accepted) return "";
  const count = `${plan.switches} ${plan.switches === 1 ? "switch" : "switches"}`;
  const homing = plan.homing?.length ? `${plan.homing.length} to home, then ` : "";
  return homing + (plan.certificate === "optimal" ? `${count}, proven optimal` : count);
}

// The plan in words. The list of stages stays the same element, so that it stays open.
function planCard(connection) {
  const text = el("div", {});
  const summary = el("summary", {});
  const list = el("ol", { class: "stages" });
  const stages = el("details", { hidden: true }, summary, list);
  const words = el("div", { class: "plan" }, text, stages);
  const showPlan = (editor) => {
    // A plan of the goal just before stays until the next one comes. Its refusal does not: it would look like that of this goal.
    const plan = editor.goal === null || editor.validPlan?.accepted || editor.upToDate ? editor.plan : null;
    stages.hidden = !plan?.accepted;
    if (plan?.accepted) {
      const waypoints = plan.waypoints.filter((waypoint) => !waypoint.between);
      const all = waypoints.flatMap((waypoint, k) => (waypoint.stages ?? []).map((stage) => ({ k, stage })));
      summary.textContent = `${all.length} ${all.length === 1 ? "stage" : "stages"}, configuration ${waypoints.at(-1).configuration}`;
      fill(list, ...all.slice(0, 100).map(({ k, stage }) => el("li", {}, waypoints.length > 1 ? `point ${k + 1}: ` : "", stage.join(", "))));
      fill(text, planInNumbers(plan, waypoints, unitMark(connection.latest.arm)));
      return;
    }
    summary.textContent = "";
    fill(list);
    if (plan !== null) fill(text, el("p", { class: "bad" }, refusal(editor)));
    else fill(text);
  };
  return { words, showPlan };
}

function planInNumbers(plan, waypoints, unit) {
  const weighted = plan.cost !== undefined && plan.cost !== plan.switches;
  const least = weighted ? `a cost of at least ${plan.lower_bound}` : `at least ${plan.lower_bound} switches`;
  const proof = plan.certificate === "bound" ? `proven: ${least}` : CERTIFICATES[plan.certificate];
  const excursion = Math.max(...waypoints.map((waypoint) => waypoint.excursion ?? 0));
  const homing = plan.homing ?? []; // actuators of unknown position, which are switched before the plan
  return el("dl", {}, ...(homing.length ? pair("homing first", `${homing.length} more ${homing.length === 1 ? "switch" : "switches"}: ${homing.join(", ")}`) : []),
    ...pair("switches", String(plan.switches)),
    ...(weighted ? pair("cost", number(plan.cost)) : []), ...pair("certificate", proof ?? plan.certificate),
    ...pair("error", number(Math.max(...waypoints.map((waypoint) => waypoint.error ?? 0)), 5) + unit),
    ...pair("deviation", `${number(excursion)}${unit} on the way`));
}

function hint(editor) {
  const { classList } = document.body;
  if (classList.contains("replay")) return "A replay shows the goals of the recording and sends none.";
  return classList.contains("viewer") ? "A viewer sees goals and sends none." : hints[editor.mode];
}

const hints = {
  goal: "Place or type a goal, or drop a file. Nothing moves before Go.",
  curve: "Click the points of a curve, one after the other.",
  turn: "Place a goal first, then drag the rings to turn it.",
  obstacle: "Drag in the picture to draw an obstacle.",
  pan: "Drag to pan, or to orbit around a spatial arm. Turn the wheel to zoom.",
};

function pair(name, value) {
  return [el("dt", {}, name), el("dd", {}, value)];
}
