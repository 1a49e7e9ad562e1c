// Marks of the planar drawing: goals, waypoints, planned configurations, tip.

// The planned configurations, and the outline of the region that the tip does not leave on the way to the first.
export function drawGhost(view) {
  const plan = view.editor.validPlan;
  if (!plan?.accepted) return;
  const points = plan.waypoints.filter((waypoint) => waypoint.body);
  const { context } = view;
  if (view.state?.tip && points[0]?.excursion) {
    drawCapsule(view, view.toScreen(view.state.tip.position), view.toScreen(points[0].position), points[0].excursion);
  }
  context.globalAlpha = points.length > 1 ? 0.35 : 0.8;
  for (const waypoint of points) view.drawBody(waypoint.body, "ghost", 1.8);
  context.globalAlpha = 1;
}

// The outline of all points within a radius of a line on the screen.
function drawCapsule(view, [x0, y0], [x1, y1], radius) {
  const { context } = view;
  const along = Math.atan2(y1 - y0, x1 - x0);
  const size = radius * view.scale;
  context.globalAlpha = 0.7;
  context.strokeStyle = view.colour("ghost");
  context.lineWidth = 1.2;
  context.setLineDash([2, 5]);
  context.beginPath();
  context.arc(x0, y0, size, along + Math.PI / 2, along - Math.PI / 2);
  context.arc(x1, y1, size, along - Math.PI / 2, along + Math.PI / 2);
  context.closePath();
  context.stroke();
  context.setLineDash([]);
}

export function drawWaypoints(view) {
  const { context } = view;
  context.strokeStyle = context.fillStyle = view.colour("goal");
  context.setLineDash([2, 4]);
  context.lineWidth = 1.4;
  const chosen = view.editor.points.map((point) => point.position);
  for (const line of [view.waypoints.map((waypoint) => waypoint.position), chosen]) {
    if (line.length > 1) view.line(line.map((point) => view.toScreen(point)));
  }
  context.setLineDash([]);
  for (const waypoint of view.waypoints) {
    const [x, y] = view.toScreen(waypoint.position);
    context.fillRect(x - 2, y - 2, 4, 4);
  }
}

export function drawCross(view, position, colour) {
  const [x, y] = view.toScreen(position);
  view.context.strokeStyle = view.colour(colour);
  view.context.lineWidth = 2;
  view.line([[x - 7, y - 7], [x + 7, y + 7]]);
  view.line([[x - 7, y + 7], [x + 7, y - 7]]);
}

// An edited point: a ring of the tolerance's radius, at least a finger wide, and a handle. The ring of a refused point is
// dashed and named, inside of the picture.
export function drawGoal(view, point, k) {
  const { context, editor } = view;
  const [x, y] = view.toScreen(point.position);
  const refused = editor.refusedAt(k);
  const colour = refused ? "bad" : "ghost";
  drawCross(view, point.position, colour);
  context.strokeStyle = context.fillStyle = view.colour(colour);
  context.setLineDash(refused ? [5, 4] : []);
  context.beginPath();
  context.arc(x, y, Math.max(12, (editor.tolerance ?? 0) * view.scale), 0, 2 * Math.PI);
  context.stroke();
  context.setLineDash([]);
  if (refused && !editor.refusedAt(k + 1)) {
    const { clientWidth: width, clientHeight: height } = view.canvas;
    context.fillText("refused", Math.min(x + 16, width - context.measureText("refused").width - 4), Math.min(y + 26, height - 6));
  }
  if (editor.points.length > 1) context.fillText(String(k + 1), x + 14, y - 10);
  if (k !== editor.points.length - 1) return;
  const [hx, hy] = handle(view, point);
  context.setLineDash(point.orientation === null ? [2, 4] : []);
  view.line([[x, y], [hx, hy]]);
  context.setLineDash([]);
  context.beginPath();
  context.arc(hx, hy, 6, 0, 2 * Math.PI);
  if (point.orientation === null) context.stroke();
  else context.fill();
}

// Screen position of the handle that turns a point; it lies on the tip's y axis, the arm's direction.
export function handle(view, point) {
  const [x, y] = view.toScreen(point.position);
  const angle = (point.orientation ?? 0) + Math.PI / 2;
  return [x + 46 * Math.cos(angle), y - 46 * Math.sin(angle)];
}

// A question mark at a module of unknown position.
export function drawQuestion(view, middle) {
  const { context } = view;
  const [x, y] = view.toScreen(middle);
  context.save();
  context.font = "bold 15px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.lineWidth = 4;
  context.strokeStyle = view.colour("card");
  context.fillStyle = view.colour("unknown");
  context.strokeText("?", x, y);
  context.fillText("?", x, y);
  context.restore();
}

export function drawTip(view, tip) {
  const { context } = view;
  const [x, y] = view.toScreen(tip.position);
  const angle = tip.orientation + Math.PI / 2;
  context.strokeStyle = context.fillStyle = view.colour("measured");
  context.beginPath();
  context.arc(x, y, 4, 0, 2 * Math.PI);
  context.fill();
  context.lineWidth = 2;
  view.line([[x, y], [x + 18 * Math.cos(angle), y - 18 * Math.sin(angle)]]);
}
