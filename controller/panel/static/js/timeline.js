// The timeline of a replay: position, speed and pause.

import { clock, date, el, fill } from "./dom.js";

export function showTimeline(connection, editor, notify) {
  const banner = document.getElementById("replay");
  const box = document.querySelector(".timeline");
  const slider = el("input", { type: "range", min: 0, max: 1000, value: 0, "aria-label": "Time in the recording" });
  const words = el("span", { class: "faint" });
  const pause = el("button", { type: "button", id: "pause" });
  const speed = el("select", { "aria-label": "Speed" }, ...[0.1, 0.5, 1, 2, 5, 20].map((factor) => el("option", { value: String(factor) }, `${factor}×`)));
  fill(box, pause, slider, speed, words);
  let timeline = null;
  let sliding = false;
  const seek = async (change) => {
    const answer = await connection.ask({ do: "seek", ...change });
    if (answer.accepted === false) notify(answer, "Replay");
  };
  pause.addEventListener("click", () => seek({ paused: !timeline.paused }));
  speed.addEventListener("change", () => seek({ speed: Number(speed.value) }));
  slider.addEventListener("input", () => (sliding = true));
  slider.addEventListener("blur", () => (sliding = false)); // dragged and brought back: nothing changes
  slider.addEventListener("change", async () => {
    await seek({ at: timeline.begin + (slider.value / 1000) * (timeline.end - timeline.begin) });
    sliding = false;
  });
  // Shows a speed, one that `hyperbit replay --speed` set too.
  const choose = (factor) => {
    const known = [...speed.options].some(({ value }) => value === String(factor));
    if (!known) speed.append(el("option", { value: String(factor) }, `${factor}×`));
    speed.value = String(factor);
  };
  connection.on("you", ({ replay }) => {
    if (!replay || !banner.hidden) return;
    banner.hidden = false;
    if (timeline === null) fill(banner, el("b", {}, "Replay of a recording"), ". Nothing here moves an arm.");
    document.body.classList.add("replay");
    editor.clear();
    editor.setMode("pan");
  });
  connection.on("timeline", (message) => {
    if (timeline === null) {
      const { file, begin } = message;
      fill(banner, el("b", {}, `Replay of ${file ?? "a recording"}`), ` of ${date(begin)}. Nothing here moves an arm.`);
      box.hidden = false;
    }
    timeline = message;
    const share = timeline.end > timeline.begin ? (timeline.at - timeline.begin) / (timeline.end - timeline.begin) : 1;
    if (!sliding) slider.value = String(Math.round(share * 1000));
    pause.textContent = timeline.paused ? "▶ Play" : "❚❚ Pause";
    if (speed.selectedOptions[0]?.value !== String(timeline.speed)) choose(timeline.speed);
    words.textContent = `replay of ${timeline.file ?? "a recording"}, ${clock(timeline.at)} of ${clock(timeline.begin)} to ${clock(timeline.end)}`;
  });
}
