// A worker: the page's connection to its server, and its heartbeat. Drawing, which may keep a page's own script busy for
// half a second, holds neither up; but a script that does not answer at all has no heartbeat either.

const BEAT_MS = 100;
const ALIVE_MS = 1500;

let socket = null;
let greeted = false; // the first message is the page's hello
let alive_ms = 0;
let visible = true;

onmessage = ({ data }) => {
  if (data.connect) {
    socket = new WebSocket(data.connect);
    greeted = false;
    socket.onopen = () => postMessage({ opened: true });
    socket.onmessage = (event) => postMessage({ message: event.data });
    socket.onclose = ({ code }) => postMessage({ closed: code });
  } else if (data.send) {
    alive_ms = performance.now(); // whoever presses a button is there, however long the page drew before
    beat();
    socket.send(data.send);
    greeted = true;
  } else {
    const changed = visible !== data.visible;
    alive_ms = performance.now();
    visible = data.visible;
    if (changed) {
      beat();
    }
  }
};
setInterval(() => visible && performance.now() - alive_ms < ALIVE_MS && beat(), BEAT_MS);

function beat() {
  if (greeted && socket.readyState === WebSocket.OPEN) {
    socket.send(JSON.stringify({ kind: "beat", id: 0, visible }));
  }
}
