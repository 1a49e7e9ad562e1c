// Stop: asked over the WebSocket and over HTTP until the server confirms it. A stop without an answer is told loudly.

import { el, fill } from "./dom.js";

const BESIDE = 300; // [ms] after which HTTP is tried beside the WebSocket
const UNCONFIRMED = 1000; // [ms] without a confirmation
const AGAIN = 1000; // [ms] between an answer over HTTP and the next request
const HTTP_TIMEOUT = 6000; // [ms]; the server waits 5 s for arms that are silent

// Stops when the button is pressed, without a question. `path` is the stop's address; `connection` the WebSocket of one arm.
export function pressToStop(button, { path, what, notify, connection = null }) {
  const label = button.textContent;
  const words = el("span", {});
  const end = el("button", { type: "button" }, "Stop asking");
  const alarm = el("div", { class: "unconfirmed", role: "alert", hidden: true });
  let busy = false;

  const press = async () => {
    if (busy) return;
    busy = true;
    button.classList.add("pressed");
    button.textContent = "Stopping …";
    const answer = await new Promise(ask);
    alarm.hidden = true;
    fill(alarm);
    button.classList.remove("pressed");
    button.textContent = label;
    busy = false;
    notify(answer, what);
  };

  // Asks until a stop is confirmed, or until the operator ends the asking.
  function ask(resolve) {
    let ended = false;
    let latest = "no answer";
    const finish = (answer) => {
      ended = true;
      clearInterval(watch);
      resolve(answer);
    };
    const hear = (answer) => {
      latest = answer.message;
      if (answer.accepted) finish(answer);
    };
    const askOverHttp = async () => {
      while (!ended) {
        hear(await stopOverHttp(path));
        await new Promise((go) => setTimeout(go, AGAIN));
      }
    };
    end.onclick = () => finish({ accepted: false, message: `not confirmed: ${latest}` });
    const pressed = performance.now();
    const watch = setInterval(() => {
      if (performance.now() - pressed < UNCONFIRMED) return;
      const text = `STOP NOT CONFIRMED: ${latest}. Cut the arm's power by its switch, or run hyperbit halt on its `
        + "computer. This page asks again until a stop is confirmed.";
      document.body.append(...(alarm.isConnected ? [] : [alarm])); // also beside the login form
      alarm.hidden = false;
      if (words.textContent !== text) words.textContent = text;
      if (!end.isConnected) fill(alarm, words, end);
    }, 100);
    if (connection?.open) connection.ask({ do: "stop" }).then(hear);
    setTimeout(askOverHttp, connection?.open ? BESIDE : 0);
  }

  button.addEventListener("pointerdown", (event) => {
    if (event.button === 0) press();
  });
  button.addEventListener("click", (event) => {
    if (event.detail === 0) press(); // by keyboard or screen reader
  });
}

// Requests a stop over HTTP, which needs no WebSocket.
async function stopOverHttp(path) {
  try {
    const response = await fetch(path, { method: "POST", signal: AbortSignal.timeout(HTTP_TIMEOUT) });
    const text = (await response.text()).trim().replace(/\.$/, "");
    return response.headers.get("content-type")?.includes("json")
      ? JSON.parse(text)
      : { accepted: false, message: text };
  } catch {
    return { accepted: false, message: "the server does not answer" };
  }
}
