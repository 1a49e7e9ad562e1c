// The question of a commission, in place of picture and goals: the command asks it, and the first answer counts.

import { el, fill } from "./dom.js";
import { onHold } from "./hold.js";

export function showCommission(connection, notify) {
  const card = document.getElementById("commission");
  const about = el("h2");
  const told = el("pre", { class: "told", tabIndex: 0, "aria-label": "What was seen" });
  const text = el("p", { class: "asked", "aria-live": "assertive" });
  const answers = el("div", { class: "answers" });
  const hint = el("p", { class: "hint" }, "Nothing looks at obstacles. Keep the switch that cuts the power at hand.");
  card.append(about, text, answers, told, hint);
  let shown = ""; // what the answers were made for
  for (const section of ["state", "you", "arm"]) connection.on(section, describe);

  function describe() {
    const commission = connection.latest.state?.commission;
    card.hidden = !commission;
    document.body.classList.toggle("commission", Boolean(commission));
    if (!commission) return;
    const { question } = commission;
    about.textContent = commission.about;
    const lines = commission.told.join("\n");
    told.hidden = lines === "";
    if (told.textContent !== lines) {
      told.textContent = lines;
      told.scrollTop = told.scrollHeight;
    }
    const now = JSON.stringify([question, connection.mayCommand, connection.latest.arm?.actuators]);
    if (now === shown) return;
    shown = now;
    text.textContent = question ? sentence(question.text) : "No question: look at the arm, and wait.";
    fill(answers, ...(question && connection.mayCommand ? buttons(question) : []));
  }

  // New buttons for each question: a press that was meant for another one answers nothing.
  function buttons({ number, choices, others }) {
    const answer = async (key, words) => {
      const own = [...answers.querySelectorAll("button")];
      for (const each of own) each.disabled = true;
      const answered = await connection.ask({ do: "answer", question: number, answer: key });
      for (const each of own) each.disabled = answered.accepted;
      if (!answered.accepted) notify(answered, words);
    };
    const made = choices.map(({ key, words, hold }) => {
      const label = hold ? `Hold to ${words}` : sentence(words);
      const button = el("button", { type: "button", class: hold ? "primary" : "", data: { key } }, label);
      if (hold) return onHold(button, () => answer(key, words), notify);
      button.addEventListener("click", () => answer(key, words));
      return button;
    });
    return others ? [...made, another(answer)] : made;
  }

  // Another actuator than the one that was commanded has moved.
  function another(answer) {
    const labels = connection.latest.arm?.actuators ?? [];
    const which = el("select", { name: "which" }, ...labels.map((label) => el("option", { value: label }, label)));
    const moved = (end, words) =>
      el("button", { type: "button", onclick: () => answer(`${which.value} ${end}`, `${which.value} ${words}`) }, words);
    return el("fieldset", { class: "another" }, el("legend", {}, "Another one moved"),
      el("label", {}, "Actuator ", which), moved("e", "extended"), moved("c", "contracted"));
  }
}

function sentence(words) {
  return words[0].toUpperCase() + words.slice(1);
}
