// The goal that the operator edits: a position, a pose or a curve, and the daemon's plan of it.

const PLAN_GAP = 200; // [ms] between two plan requests while a goal is dragged

export class Editor {
  constructor(connection) {
    this.connection = connection;
    this.mode = "goal"; // action of a click: "goal", "turn", "curve", "obstacle" or "pan"
    this.points = []; // position, and orientation or null
    this.file = null; // uploaded goal, used instead of the points
    this.tolerance = null;
    this.pathTolerance = null;
    this.step = null; // [s] between waypoints; null: as long as the arm needs at most
    this.plan = null; // the latest answer
    this.planning = false;
    this.plannedFrom = null; // situation of the arm when the plan was requested
    this.plannedGoal = null; // the goal of the plan, as JSON
    this.listeners = [];
  }

  on(listener) {
    this.listeners.push(listener);
  }

  changed({ plan = true } = {}) {
    if (plan) this.ask();
    for (const listener of this.listeners) listener(this);
  }

  setMode(mode) {
    this.mode = mode;
    this.changed({ plan: false });
  }

  place(position) {
    this.file = null;
    this.points = [{ position, orientation: this.points.length === 1 ? this.points[0].orientation : null }];
    this.changed();
  }

  add(position) {
    this.file = null;
    this.points = [...this.points, { position, orientation: null }];
    this.changed();
  }

  // Changes position or orientation of one point. A named pose or a file is planned as it is.
  change(index, values) {
    if (this.file !== null) return;
    this.points = this.points.map((point, k) => (k === index ? { ...point, ...values } : point));
    this.changed();
  }

  set(values) {
    Object.assign(this, values);
    this.changed();
  }

  removeLast() {
    this.points = this.points.slice(0, -1);
    this.changed();
  }

  clear() {
    this.points = [];
    this.file = this.plan = null;
    this.changed({ plan: false });
  }

  get goal() {
    if (this.file) return this.file;
    if (this.points.length === 0) return null;
    const lines = this.pathTolerance !== null && this.points.length > 1;
    const waypoints = this.points.map(({ position, orientation }, k) => ({
      position,
      ...(this.step === null ? {} : { t: Number((k * this.step).toFixed(6)) }),
      ...(orientation === null || lines ? {} : { orientation }),
    }));
    return {
      waypoints,
      ...(this.tolerance === null ? {} : { tolerance: { position: this.tolerance } }),
      ...(lines ? { path_tolerance: this.pathTolerance } : {}),
    };
  }

  get state() {
    return this.connection.latest.state ?? null;
  }

  get ready() {
    return this.state?.mode === "ready";
  }

  // The plan, if it begins in the present state of the arm; otherwise null. It may be of the goal just before.
  get validPlan() {
    return this.ready && this.plannedFrom === situation(this.state) ? this.plan : null;
  }

  // Whether the plan is of the present goal, too.
  get upToDate() {
    return this.validPlan !== null && this.plannedGoal === JSON.stringify(this.goal);
  }

  // Whether the present goal cannot be planned from the present state.
  get refused() {
    return this.upToDate && !this.plan.accepted;
  }

  // Whether the refusal names a point, counted from 0; a refusal that names none is of all points.
  refusedAt(k) {
    if (!this.refused) return false;
    const [, first, last = first] = /^waypoint (\d+)(?: to (\d+))?/.exec(this.plan.message) ?? [null, 1, this.points.length];
    return first <= k + 1 && k + 1 <= last;
  }

  // Requests a plan of the present goal, and again until the plan belongs to the present goal and state.
  // A moving or stopped arm has no plan: the goal is planned when the arm is ready.
  async ask() {
    if (this.goal === null) {
      this.plan = null;
      return;
    }
    if (this.planning) return;
    this.planning = true;
    while (this.goal !== null && this.ready && !this.upToDate) {
      const goal = this.goal;
      const began = performance.now();
      const from = situation(this.state);
      const plan = await this.connection.ask({ do: "plan", goal });
      if (this.goal !== null) Object.assign(this, { plan, plannedFrom: from, plannedGoal: JSON.stringify(goal) });
      this.changed({ plan: false });
      await new Promise((go) => setTimeout(go, Math.max(PLAN_GAP - (performance.now() - began), 0)));
    }
    this.planning = false;
    this.changed({ plan: false });
  }

  // Shows the plan of a goal that the server has: a file's text, or a goal that was sent before.
  async open(request) {
    const from = situation(this.state);
    const answer = await this.connection.ask(request);
    this.file = answer.file ?? null;
    Object.assign(this, { plan: answer, plannedFrom: from, plannedGoal: JSON.stringify(this.file) });
    const waypoints = Array.isArray(answer.file?.waypoints) ? answer.file.waypoints : [];
    this.points = waypoints
      .filter((waypoint) => Array.isArray(waypoint?.position))
      .map((waypoint) => ({ position: waypoint.position, orientation: waypoint.orientation ?? null }));
    this.changed({ plan: false });
  }

  go() {
    return this.connection.ask({ do: "go", goal: this.goal });
  }
}

// What a plan depends on besides the goal: whether the arm is ready, its configuration, obstacles and locks.
export function situation(state) {
  return JSON.stringify([state?.mode === "ready", state?.configuration, state?.obstacles, state?.degraded]);
}
