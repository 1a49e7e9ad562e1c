// Round steps between the lines of a scale.

// The least of 1, 2 and 5 times a power of ten that is at least a length.
export function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= least);
}

// Number of decimals that tell multiples of a step apart.
export function digitsOf(step) {
  return Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
}
