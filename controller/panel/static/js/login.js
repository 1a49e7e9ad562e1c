// Login: exchanges a token for a cookie that scripts cannot read.

import { show } from "./dom.js";

// Logs in with the token in the address, and removes it from the address bar and the history.
// Returns why the token was refused; null if it was accepted, or if there is none.
export async function enterByAddress() {
  const token = location.hash.slice(1);
  if (!token) return null;
  history.replaceState(null, "", location.pathname);
  const refusal = await enter(token);
  return refusal && `The token in the address was refused: ${refusal}`;
}

// Logs in; returns why the token was refused, or null.
async function enter(token) {
  try {
    const response = await fetch("session", {
      method: "POST",
      headers: { "content-type": "application/json" },
      body: JSON.stringify({ token }),
    });
    return response.ok ? null : await response.text();
  } catch {
    return "The server does not answer.";
  }
}

export function showLogin(message = "") {
  show("login");
  document.querySelector(".message").textContent = message;
  document.title = "hyperbit: log in";
  const form = document.querySelector("form");
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const refusal = await enter(form.elements.token.value);
    if (refusal === null) location.reload();
    else document.querySelector(".message").textContent = refusal;
  });
  form.elements.token.focus();
}

export async function leave() {
  await fetch("session", { method: "DELETE" });
  location.assign(document.baseURI);
}
