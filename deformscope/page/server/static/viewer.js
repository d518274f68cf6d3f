// rerun's web viewer in the middle of the page, and the data to it.
/* global wasm_bindgen */

import { address } from "./session.js";

const CHANNEL = "recording";
const AGAIN_MS = 1000;
const SLACK_NS = 0.5e9; // it need not show the very newest before it gets more
const IDLE_MS = 5000;
const LONGEST_MS = 10_000;
const LOG_TIMELINES = ["log_time", "log_tick"]; // what the viewer shows before the views of the recording are there
const time = { at_ns: 0, following: true }; // of the viewer; it follows until somebody stops it

// onWords: what to say in the viewer's place, empty once it shows something
// onBatch: after each batch that was drawn, and without one where nothing follows it
export async function startViewer(canvas, onWords, onBatch, onEvent = () => {}) {
  const recording = document.body.dataset.recording; // of a page that plays one
  await wasm_bindgen({ module_or_path: fetch("re_viewer_bg.wasm") });
  const handle = new wasm_bindgen.WebHandle({
    url: null,
    manifest_url: null,
    hide_welcome_screen: true,
    enable_history: false,
    notebook: false,
    persist: false,
    theme: matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark",
    on_viewer_event: (text) => {
      const event = JSON.parse(text);
      if (event.type === "time_update") {
        time.at_ns = event.time;
        time.following = true;
      } else if (event.type === "pause" || event.type === "timeline_change") {
        time.following = false;
      }
      if (recording && event.type === "timeline_change" && !LOG_TIMELINES.includes(event.timeline)) {
        onWords("");
      } else if (recording && event.type === "recording_open") {
        setTimeout(onWords, LONGEST_MS, ""); // a recording without views of its own
      }
      onEvent(event);
    },
  });
  await handle.start(canvas);
  for (const panel of ["top", "blueprint", "selection"]) {
    handle.override_panel_state(panel, "hidden"); // also before the views are there, which hide them
  }
  if (recording) {
    handle.add_receiver(new URL(recording, location.href).href);
  } else {
    handle.open_channel(CHANNEL, "deformscope");
    let covered = true; // until there are data: what the viewer shows of its own before their views nobody needs
    const shown = (batch) => {
      if (covered && (!batch || batch.until_ns)) {
        covered = false;
        onWords("");
      }
      onBatch(batch);
    };
    connect(handle, shown, 0);
  }
  const watch = setInterval(() => {
    if (handle.has_panicked()) {
      clearInterval(watch);
      onWords(`the viewer has crashed: ${handle.panic_message()}; load this page again`);
    }
  }, 1000);
  return handle;
}

// More of the recording that the page plays, or over it, of the same id.
export async function addLayer(handle, name) {
  const answer = await fetch(name);
  handle.open_channel(name, "deformscope");
  handle.send_rrd_to_channel(name, new Uint8Array(await answer.arrayBuffer()));
}

function connect(handle, onBatch, after) {
  const socket = new WebSocket(address(`data?after=${after}`));
  socket.binaryType = "arraybuffer";
  let last = after;
  let idle = 0;
  socket.onmessage = async ({ data }) => {
    clearTimeout(idle);
    if (data instanceof ArrayBuffer) {
      handle.send_rrd_to_channel(CHANNEL, new Uint8Array(data));
      return;
    }
    const batch = JSON.parse(data);
    last = batch.last;
    // A hidden page has no frames, and so asks for nothing more. A viewer that draws slowly takes in a part of what it was
    // given in each frame: while it follows the newest data, its time says how far it is.
    const sent_ms = performance.now();
    do {
      await new Promise(requestAnimationFrame);
    } while (
      time.following && batch.until_ns > time.at_ns + SLACK_NS && performance.now() - sent_ms < LONGEST_MS
    );
    if (socket.readyState === WebSocket.OPEN) {
      socket.send(JSON.stringify({ batch: batch.batch }));
      onBatch(batch);
      idle = setTimeout(onBatch, IDLE_MS, null);
    }
  };
  socket.onclose = () => setTimeout(() => connect(handle, onBatch, last), AGAIN_MS);
}
