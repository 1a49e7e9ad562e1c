// Login: exchanges a token for a cookie that scripts cannot read.

import { show } from "./dom.js";

// Logs in with the token in the address, and removes it from the address bar and the history.
export async function enterByAddress() {
  const token = location.hash.slice(1);
  if (!token) return;
  history.replaceState(null, "", location.pathname);
  await enter(token);
}

async function enter(token) {
  const response = await fetch("/session", {
    method: "POST",
    headers: { "content-type": "application/json" },
    body: JSON.stringify({ token }),
  });
  return response.ok ? null : await response.text();
}

export function showLogin() {
  show("login");
  document.title = "hyperbit: log in";
  const form = document.querySelector("form");
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const refusal = await enter(form.elements.token.value).catch(() => "The server does not answer.");
    if (refusal === null) location.reload();
    else document.querySelector(".message").textContent = refusal;
  });
  form.elements.token.focus();
}

export async function leave() {
  await fetch("/session", { method: "DELETE" });
  location.assign("/");
}
