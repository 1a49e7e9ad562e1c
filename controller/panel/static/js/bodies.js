// The drawn bodies of the arm: which line segments are known, and which belong to modules of unknown position. `commanded` is
// null if the arm is where it was commanded.

export const NOTHING = { commanded: null, measured: null, known: null, unknown: null, marks: [] };

// Divides the measured body by the modules of unknown position.
// `lines`: number of line segments of each module; a segment has two points of `dimension` coordinates.
export function divided(bodies, { lines, dimension }) {
  const { measured } = bodies;
  const commanded = String(bodies.commanded) === String(measured) ? null : bodies.commanded;
  const unknown = new Set(bodies.unknown ?? []);
  if (!measured || unknown.size === 0) return { commanded, measured, known: measured, unknown: null, marks: [] };
  const parts = { known: [], unknown: [] };
  const marks = []; // middle of each unknown module
  let at = 0;
  lines.forEach((count, module) => {
    const own = measured.slice(at, (at += count * 2 * dimension));
    parts[unknown.has(module) ? "unknown" : "known"].push(...own);
    if (unknown.has(module)) marks.push(middle(own, dimension));
  });
  return { commanded, measured, ...parts, marks };
}

function middle(coordinates, dimension) {
  const points = coordinates.length / dimension;
  return Array.from({ length: dimension }, (_, axis) =>
    coordinates.reduce((sum, x, k) => (k % dimension === axis ? sum + x : sum), 0) / points);
}
