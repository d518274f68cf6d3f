// The state from the server, and commands to it. The page keeps no state of its own: it shows what the server says.

export const VERSION = 1;
const AGAIN_MS = [200, 500, 1000, 2000];
const ALIVE_EVERY_MS = 200;
const UNLOADED_MS = 500; // so long a page that is loaded again may still hold its own name

export class PageSession {
  #link = new Worker("link.js");
  #open = false;
  #id = 0;
  #waiting = new Map();
  #tries = 0;

  constructor(onState, onLost) {
    this.page = sessionStorage.getItem("page") ?? newName();
    this.onState = onState;
    this.onLost = onLost;
    this.#link.onmessage = ({ data }) => this.#came(data);
    this.#claim().then(() => this.#connect());
    const alive = () => this.#link.postMessage({ visible: document.visibilityState === "visible" });
    setInterval(alive, ALIVE_EVERY_MS);
    document.addEventListener("visibilitychange", alive);
    window.addEventListener("pagehide", () => this.#link.postMessage({ visible: false }));
    alive();
  }

  // Resolves with the reply: { outcome: "done" | "begun" | "refused", words }.
  command(kind, fields = {}) {
    if (!this.#open) {
      return Promise.resolve({ outcome: "refused", words: "no connection to the command" });
    }
    const id = ++this.#id;
    this.#send({ kind, id, ...fields });
    return new Promise((resolve) => this.#waiting.set(id, resolve));
  }

  // A page keeps its name, and with it the controls, when it is loaded again; a copy of its tab, which has the name as
  // well, takes another.
  async #claim() {
    if (!(await holdName(this.page))) {
      this.page = newName();
      await holdName(this.page);
    }
    sessionStorage.setItem("page", this.page);
  }

  #connect() {
    this.#link.postMessage({ connect: address("session") });
  }

  #send(message) {
    this.#link.postMessage({ send: JSON.stringify(message) });
  }

  #came({ opened, message, closed }) {
    if (opened) {
      this.#open = true;
      this.#tries = 0;
      this.#send({ kind: "hello", id: 0, version: VERSION, page: this.page });
    } else if (message) {
      const said = JSON.parse(message);
      if (said.kind === "state") {
        this.onState(said);
      } else {
        this.#waiting.get(said.id)?.(said);
        this.#waiting.delete(said.id);
      }
    } else if (closed !== undefined) {
      this.#open = false;
      for (const resolve of this.#waiting.values()) {
        resolve({ outcome: "refused", words: "the connection was lost: whether it was done is not known" });
      }
      this.#waiting.clear();
      this.onLost(closed === 4000 ? "another version: load this page again" : "no connection to the command");
      if (closed !== 4000) {
        setTimeout(() => this.#connect(), AGAIN_MS[Math.min(this.#tries++, AGAIN_MS.length - 1)]);
      }
    }
  }
}

function newName() {
  return Math.random().toString(36).slice(2, 12);
}

// Whether no other page has the name; this one then holds it until it is gone.
function holdName(name) {
  return new Promise((resolve) => {
    const held = () => {
      resolve(true);
      return new Promise(() => {});
    };
    if (navigator.locks) {
      navigator.locks.request(name, { signal: AbortSignal.timeout(UNLOADED_MS) }, held).catch(() => resolve(false));
    } else {
      resolve(true);
    }
  });
}

export function address(path) {
  return new URL(path, location.href).href.replace(/^http/, "ws");
}
