// Builds elements. Texts are never parsed as HTML, whatever an arm sends.

export function el(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "class") element.className = value;
    else if (name === "data") Object.assign(element.dataset, value);
    else if (name in element) element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

// Replaces the children of an element.
export function fill(element, ...children) {
  element.replaceChildren(...children.filter((child) => child !== null && child !== undefined));
}

export function show(template) {
  document.body.replaceChildren(
    ...document.querySelectorAll("template"),
    document.getElementById(template).content.cloneNode(true),
  );
}

// A number as text with a fixed number of decimals; a dash if it is unknown.
export function number(value, digits = 4) {
  return typeof value === "number" && Number.isFinite(value) ? value.toFixed(digits) : "–";
}

// What follows a length: the unit of the arm's file, or nothing if it names none.
export function unitMark(arm) {
  return arm?.unit ? ` ${arm.unit}` : "";
}

export function clock(seconds) {
  return new Date(seconds * 1000).toLocaleTimeString([], { hour12: false });
}

export function date(seconds) {
  return new Date(seconds * 1000).toLocaleDateString([], { dateStyle: "long" });
}

// An input field for a number; `change` gets each number that is typed, or null if there is none. `set` shows another number,
// with `digits` decimals at most.
export function numberField(label, change, { digits = 5, ...properties } = {}) {
  const input = el("input", { type: "number", step: "any", inputMode: "decimal", ...properties });
  const rounded = (value) => Number(value.toFixed(digits));
  input.addEventListener("input", () => change(input.value === "" ? null : input.valueAsNumber));
  const field = el("label", {}, label, " ", input);
  field.set = (value) => {
    const same = value === null ? input.value === "" : input.value !== "" && rounded(input.valueAsNumber) === rounded(value);
    if (!same) input.value = value === null ? "" : String(rounded(value));
  };
  return field;
}
