// The WebSocket of a page: receives sections, sends requests, and reconnects automatically.

const SILENT_AFTER = 1.5; // [s] without a state until values count as old
const STALE = 5000; // [ms] without a heartbeat, or until a WebSocket is open; then another one is opened
const NO_LOGIN = 4401; // close code of the server: log in first
const REFUSED = 4429; // close code of the server, with a reason

export class Connection {
  constructor(path, { onLogin }) {
    this.path = path;
    this.onLogin = onLogin;
    this.latest = {}; // the latest message of each section
    this.listeners = new Map();
    this.waiting = new Map(); // callback for the answer to each request
    this.number = 0;
    this.heartbeat = null; // number of the server's latest heartbeat on this WebSocket
    this.heardAt = -Infinity; // latest state of the arm [ms]
    this.serverAt = performance.now();
    this.pause = 250;
    this.refusal = ""; // why the server closed the WebSocket
    this.again = null; // timer of the next WebSocket, while there is none
    this.connect();
    addEventListener("pagehide", () => this.socket.close()); // the browser may keep the page: it gives control up
    // After a sleep of the computer the WebSocket is dead, and the browser may not tell for many minutes.
    const watch = setInterval(() => this.renew(STALE), 1000);
    const wake = () => {
      if (this.again !== null) this.connect();
      else setTimeout(() => this.renew(SILENT_AFTER * 1000), SILENT_AFTER * 1000);
    };
    const events = [[document, "visibilitychange"], [window, "online"], [window, "pageshow"]];
    for (const [target, event] of events) target.addEventListener(event, wake);
    this.end = () => {
      clearInterval(watch);
      for (const [target, event] of events) target.removeEventListener(event, wake);
    };
  }

  connect() {
    clearTimeout(this.again);
    this.again = null;
    this.heartbeat = null;
    this.livedAt = performance.now();
    this.socket = new WebSocket(new URL(this.path, document.baseURI).href.replace(/^http/, "ws"));
    this.socket.onmessage = (event) => {
      this.livedAt = this.serverAt = performance.now();
      this.pause = 250;
      for (const message of JSON.parse(event.data)) this.receiveMessage(message);
    };
    this.socket.onclose = (event) => {
      this.refuseWaiting();
      this.refusal = event.code === REFUSED ? event.reason : "";
      if (event.code !== NO_LOGIN) {
        this.again = setTimeout(() => this.connect(), (this.pause = Math.min(this.pause * 2, 5000)));
        return;
      }
      this.end();
      this.onLogin();
    };
  }

  // Opens another WebSocket if this one shows no sign of life for `limit` [ms].
  renew(limit) {
    if (this.again !== null || performance.now() - this.livedAt < limit) return;
    this.socket.onmessage = this.socket.onclose = null;
    this.socket.close();
    this.refuseWaiting();
    this.connect();
  }

  refuseWaiting() {
    for (const answer of this.waiting.values()) answer({ accepted: false, message: "the connection was lost" });
    this.waiting.clear();
  }

  receiveMessage(message) {
    if (message.section === "reply") {
      this.waiting.get(message.n)?.(message);
      this.waiting.delete(message.n);
      return;
    }
    if (message.section === "heartbeat") {
      this.heartbeat = message.number;
      return;
    }
    if (message.section === "state" || message.section === "timeline") this.heardAt = performance.now();
    if (message.section === "presence" && message.age !== null) {
      this.heardAt = performance.now() - message.age * 1000; // an unchanged state is not sent again
    }
    this.latest[message.section] = message;
    for (const listener of this.listeners.get(message.section) ?? []) tell(listener, message);
  }

  // Whether this page may command: its person is an operator, and the server shows no replay. No message of an arm changes that.
  get mayCommand() {
    return this.latest.you?.role === "operator" && !this.latest.you.replay;
  }

  get mayStop() {
    return Boolean(this.latest.you?.stop) && !this.latest.you.replay;
  }

  on(section, listener) {
    if (!this.listeners.has(section)) this.listeners.set(section, []);
    this.listeners.get(section).push(listener);
    if (this.latest[section]) tell(listener, this.latest[section]);
  }

  get open() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  // Sends a request; the promise always resolves to an answer with `accepted` and `message`. By the heartbeat the server
  // sees how old a command is that waited in the network, and refuses it.
  ask(request) {
    if (!this.open) return Promise.resolve({ accepted: false, message: "there is no connection to the server" });
    const n = ++this.number;
    return new Promise((answer) => {
      this.waiting.set(n, answer);
      this.socket.send(JSON.stringify({ ...request, n, heartbeat: this.heartbeat }));
    });
  }

  // Age of the arm's values [s], and which part is silent; null while the values are fresh.
  silence() {
    const now = performance.now();
    const seconds = (now - Math.max(this.heardAt, -1e9)) / 1000;
    const server = (now - this.serverAt) / 1000;
    if (server > SILENT_AFTER) return { seconds: Math.max(seconds, server), who: "the server" };
    if (seconds > SILENT_AFTER) return { seconds, who: "the arm" };
    if (this.latest.presence && !this.latest.presence.alive) return { seconds, who: "the daemon" };
    return null;
  }
}

// Calls one listener. A message that it cannot read harms no other part of the page.
function tell(listener, message) {
  try {
    listener(message);
  } catch (error) {
    console.warn(`a message of the section ${message.section} cannot be read:`, error);
  }
}

// The message of an answer, and the advice if the request was refused. The points have the numbers of the picture.
export function inWords({ message, advice }) {
  const numbered = String(message).replace(/\bwaypoint (\d+)(, \w+(?=:))?/g, "point $1");
  return advice ? `${numbered} → ${advice}` : numbered;
}
