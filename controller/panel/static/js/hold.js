// A button that acts only after a long press: by mouse, finger or key.

export const HOLD = 700; // [ms]
const LATEST = 2000; // [ms] after the press; a browser that stood still acts on no press from before

export function onHold(button, act) {
  let timer = null;
  const begin = (event) => {
    if (timer !== null || button.disabled) return;
    event.preventDefault();
    button.classList.add("holding");
    const pressed = Date.now(); // performance.now() may stand still while the computer sleeps
    timer = setTimeout(() => {
      end();
      if (Date.now() - pressed < HOLD + LATEST) act();
    }, HOLD);
  };
  const end = () => {
    clearTimeout(timer);
    timer = null;
    button.classList.remove("holding");
  };
  button.classList.add("hold");
  button.title ||= "Press and hold";
  button.addEventListener("pointerdown", (event) => {
    if (event.button === 0) begin(event);
  });
  for (const name of ["pointerup", "pointerleave", "pointercancel", "blur"]) button.addEventListener(name, end);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  button.addEventListener("keydown", (event) => {
    if ((event.key === " " || event.key === "Enter") && !event.repeat) begin(event);
    else if (event.key === " ") event.preventDefault();
  });
  button.addEventListener("keyup", end);
  return button;
}
