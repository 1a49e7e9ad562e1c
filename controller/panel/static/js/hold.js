// A button that acts after a long press by mouse, finger or key, or when it is pressed twice: a screen reader cannot hold.

export const HOLD = 700; // [ms]
const LATEST = 2000; // [ms] after the press; a browser that stood still acts on no press from before
const TWICE = 6000; // [ms] within which the second press must come; it counts only HOLD after the first, so no double click acts

export function onHold(button, act, notify) {
  let timer = null;
  let held = false; // whether the latest press was held to its end
  let asked = null; // time and label of a short press
  const begin = (event) => {
    if (timer !== null || button.disabled) return;
    event.preventDefault();
    button.classList.add("holding");
    held = false;
    const pressed = Date.now(); // performance.now() may stand still while the computer sleeps
    timer = setTimeout(() => {
      end();
      held = true;
      if (Date.now() - pressed < HOLD + LATEST) act();
    }, HOLD);
  };
  const end = () => {
    clearTimeout(timer);
    timer = null;
    button.classList.remove("holding");
  };
  const tap = () => {
    const label = button.getAttribute("aria-label") ?? button.textContent;
    const since = asked?.label === label ? Date.now() - asked.at : Infinity;
    if (since < HOLD) return;
    asked = since < TWICE ? null : { at: Date.now(), label };
    if (asked === null) act();
    else notify({ accepted: true, message: "press and hold, or press again" }, label);
  };
  button.classList.add("hold");
  button.title ||= "Press and hold, or press twice";
  button.addEventListener("pointerdown", (event) => {
    if (event.button === 0) begin(event);
  });
  for (const name of ["pointerup", "pointerleave", "pointercancel", "blur"]) button.addEventListener(name, end);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  button.addEventListener("keydown", (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    if (event.repeat) event.preventDefault();
    else begin(event);
  });
  button.addEventListener("keyup", (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    event.preventDefault();
    if (timer !== null) tap();
    end();
  });
  button.addEventListener("click", () => {
    if (!held) tap();
    held = false;
  });
  return button;
}
