// The state from the server, and commands to it. The page keeps no state of its own: it shows what the server says.

export const VERSION = 1;
const AGAIN_MS = [200, 500, 1000, 2000];

export class Desk {
  #socket = null;
  #id = 0;
  #waiting = new Map();
  #tries = 0;

  constructor(onState, onLost) {
    this.page = sessionStorage.getItem("page") ?? Math.random().toString(36).slice(2, 12);
    sessionStorage.setItem("page", this.page);
    this.onState = onState;
    this.onLost = onLost;
    this.#connect();
  }

  // Resolves with the reply: { outcome: "done" | "begun" | "refused", words }.
  command(kind, fields = {}) {
    if (this.#socket?.readyState !== WebSocket.OPEN) {
      return Promise.resolve({ outcome: "refused", words: "no connection to the command" });
    }
    const id = ++this.#id;
    this.#socket.send(JSON.stringify({ kind, id, ...fields }));
    return new Promise((resolve) => this.#waiting.set(id, resolve));
  }

  #connect() {
    const socket = new WebSocket(address("desk"));
    this.#socket = socket;
    socket.onopen = () => {
      this.#tries = 0;
      socket.send(JSON.stringify({ kind: "hello", id: 0, version: VERSION, page: this.page }));
    };
    socket.onmessage = ({ data }) => {
      const message = JSON.parse(data);
      if (message.kind === "state") {
        this.onState(message);
      } else {
        this.#waiting.get(message.id)?.(message);
        this.#waiting.delete(message.id);
      }
    };
    socket.onclose = ({ code }) => {
      for (const resolve of this.#waiting.values()) {
        resolve({ outcome: "refused", words: "the connection was lost: whether it was done is not known" });
      }
      this.#waiting.clear();
      this.onLost(code === 4000 ? "another version: load this page again" : "no connection to the command");
      if (code !== 4000) {
        setTimeout(() => this.#connect(), AGAIN_MS[Math.min(this.#tries++, AGAIN_MS.length - 1)]);
      }
    };
  }
}

export function address(path) {
  return new URL(path, location.href).href.replace(/^http/, "ws");
}
