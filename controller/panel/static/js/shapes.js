// Planar obstacles: discs, boxes and half-planes, hatched so that they need no colour.

export function drawObstacles(view, regions) {
  const { context } = view;
  context.strokeStyle = view.colour("obstacle");
  context.fillStyle = hatching(view);
  context.lineWidth = 1.6;
  for (const region of regions) {
    context.beginPath();
    outline(view, region).forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.closePath();
    context.fill();
    context.stroke();
  }
}

function hatching(view) {
  const tile = document.createElement("canvas");
  tile.width = tile.height = 8;
  const context = tile.getContext("2d");
  context.strokeStyle = view.colour("obstacle");
  context.globalAlpha = 0.5;
  context.lineWidth = 1.2;
  for (const shift of [-8, 0, 8]) {
    context.moveTo(shift - 1, 9);
    context.lineTo(shift + 9, -1);
  }
  context.stroke();
  return view.context.createPattern(tile, "repeat");
}

// The corners of an obstacle on the screen.
function outline(view, region) {
  if (region.disc) {
    const { centre, radius } = region.disc;
    return turns(48).map((a) => view.toScreen([centre[0] + radius * Math.cos(a), centre[1] + radius * Math.sin(a)]));
  }
  if (region.box) {
    const { centre, size, angle } = region.box;
    const [c, s] = [Math.cos(angle ?? 0), Math.sin(angle ?? 0)];
    return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([i, j]) => {
      const [x, y] = [(i * size[0]) / 2, (j * size[1]) / 2];
      return view.toScreen([centre[0] + c * x - s * y, centre[1] + s * x + c * y]);
    });
  }
  if (region.half_plane) {
    const { point, normal } = region.half_plane;
    const length = Math.hypot(...normal);
    const [nx, ny] = normal.map((x) => x / length);
    const far = 4 * (view.canvas.clientWidth + view.canvas.clientHeight) / view.scale;
    return [[-far, 0], [far, 0], [far, -far], [-far, -far]].map(([along, up]) =>
      view.toScreen([point[0] - ny * along + nx * up, point[1] + nx * along + ny * up]));
  }
  return [];
}

function turns(parts) {
  return Array.from({ length: parts }, (_, k) => (2 * Math.PI * k) / parts);
}

export function inWords(region) {
  const round = (values) => values.map((x) => Number(x.toFixed(3))).join(", ");
  const kind = ["disc", "sphere", "box", "half_plane", "half_space"].find((name) => region[name]);
  const shape = region[kind];
  const where = kind.startsWith("half") ? `at ${round(shape.point)}` : `at ${round(shape.centre)}`;
  return `${kind.replace("_", "-")} ${where}${shape.radius ? `, radius ${Number(shape.radius.toFixed(3))}` : ""}`;
}
