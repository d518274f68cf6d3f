// rerun's web viewer in the middle of the page, and the data to it.
/* global wasm_bindgen */

import { address } from "./desk.js";

const CHANNEL = "recording";
const AGAIN_MS = 1000;

// onWords: what to say in the viewer's place, empty once it runs; onBatch: after each batch that was drawn
export async function startViewer(canvas, onWords, onBatch, onEvent = () => {}) {
  await wasm_bindgen({ module_or_path: fetch("re_viewer_bg.wasm") });
  const handle = new wasm_bindgen.WebHandle({
    url: null,
    manifest_url: null,
    hide_welcome_screen: true,
    enable_history: false,
    notebook: false,
    persist: false,
    theme: matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark",
    on_viewer_event: (event) => onEvent(JSON.parse(event)),
  });
  await handle.start(canvas);
  handle.override_panel_state("top", "hidden");
  handle.open_channel(CHANNEL, "deformscope");
  onWords("");
  const watch = setInterval(() => {
    if (handle.has_panicked()) {
      clearInterval(watch);
      onWords(`the viewer has crashed: ${handle.panic_message()}; load this page again`);
    }
  }, 1000);
  connect(handle, onBatch, 0);
}

function connect(handle, onBatch, after) {
  const socket = new WebSocket(address(`data?after=${after}`));
  socket.binaryType = "arraybuffer";
  let last = after;
  socket.onmessage = async ({ data }) => {
    if (data instanceof ArrayBuffer) {
      handle.send_rrd_to_channel(CHANNEL, new Uint8Array(data));
      return;
    }
    const batch = JSON.parse(data);
    last = batch.last;
    // The viewer's own callback comes first in each frame: by then it has taken in and drawn what was sent. A hidden page
    // has no frames, and so asks for nothing more.
    await new Promise(requestAnimationFrame);
    if (socket.readyState === WebSocket.OPEN) {
      socket.send(JSON.stringify({ batch: batch.batch }));
      onBatch(batch);
    }
  };
  socket.onclose = () => setTimeout(() => connect(handle, onBatch, last), AGAIN_MS);
}
