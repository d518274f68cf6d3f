// What is on the page beside the viewer.

import { PageSession } from "./session.js";
import { cursorRequest, startPlayback } from "./playback.js";
import { startSteering } from "./steer.js";
import { addLayer, startViewer } from "./viewer.js";

const at = (id) => document.getElementById(id);
const LEVELS = { ok: "good", waiting: "idle", closed: "idle", LOST: "bad", FAILED: "bad" };
let state = null;
let clockSkew_s = 0;
let skipped = 0;
const rows = new Map();
const replies = [];

const session = new PageSession(show, lost);
const steering = startSteering(command, session);
const words = (text) => (at("viewer-words").textContent = text);
let viewer = null;
const playback = startPlayback(async (timeline, ns) => {
  if (!viewer) {
    throw new Error("it has not started");
  }
  await viewer.viewer_control(cursorRequest(timeline, ns));
});
startViewer(at("canvas"), words, showLag, (event) => document.dispatchEvent(new CustomEvent("viewer", { detail: event })))
  .then((handle) => (viewer = handle))
  .catch((error) => words(`no viewer: ${error}`));

function show(next) {
  state = next;
  document.body.dataset.connected = "";
  clockSkew_s = performance.now() / 1000 - next.now_s;
  document.title = `${next.phase === "recording" ? "● " : ""}${next.title} – deformscope`;
  at("title").textContent = next.title || "deformscope";
  at("phase").textContent = next.phase;
  at("phase").dataset.phase = next.phase;
  at("reason").textContent = at("reason").title = next.reason;
  showDevices(next.devices);
  showControls(next);
  showTares(next.tares);
  steering.show(next);
  playback.load(next.playback);
  showLayer();
  showRemarks();
  showClock();
}

// Once the recording is there, whose views it replaces.
let layer = "";
let opened = false;
document.addEventListener("viewer", ({ detail }) => {
  opened ||= detail.type === "recording_open";
  if (detail.type === "recording_open" || detail.type === "timeline_change") {
    playback.stand(); // the recording's own views let the viewer follow the newest data
  } else if (detail.type === "time_update") {
    playback.moved(detail.time);
  }
  showLayer();
});
function showLayer() {
  if (opened && viewer && state?.playback?.layer && state.playback.layer !== layer) {
    layer = state.playback.layer;
    addLayer(viewer, layer).then(playback.stand).catch((error) => note(`no layer: ${error}`, true));
  }
}

function lost(reason) {
  if (state?.phase === "stopped") {
    return;
  }
  steering.close();
  at("phase").textContent = "lost";
  at("phase").dataset.phase = "lost";
  at("reason").textContent = reason;
}

function showDevices(devices) {
  const names = new Set(devices.map((device) => device.name));
  for (const [name, row] of rows) {
    if (!names.has(name)) {
      row.remove();
      rows.delete(name);
    }
  }
  for (const device of devices) {
    let row = rows.get(device.name);
    if (!row) {
      row = made("div", "device");
      const head = made("p", "head");
      head.append(made("b"), made("small"), made("span", "state"));
      row.append(head, made("table"), made("p", "drift numbers"), made("p", "why"));
      row.querySelector(".why").append(made("span"));
      for (const pair of [["rate", "jitter"], ["age", "lost"], ["", "dropped"]]) {
        const line = row.querySelector("table").insertRow();
        for (const what of pair) {
          line.insertCell().textContent = what;
          line.insertCell().dataset.of = what;
        }
      }
      at("devices").append(row);
      rows.set(device.name, row);
    }
    row.dataset.level = LEVELS[device.state] ?? "warn";
    row.querySelector("b").textContent = row.querySelector("b").title = device.name;
    row.querySelector(".state").textContent = device.state;
    row.querySelector("small").textContent = device.simulated ? "simulated" : "";
    const say = (what, words) => (row.querySelector(`[data-of=${what}]`).textContent = words);
    say("rate", `${device.rate_hz >= 100 ? device.rate_hz.toFixed(0) : device.rate_hz.toFixed(1)} /s`);
    say("jitter", `${(device.jitter_s * 1000).toFixed(1)} ms`);
    say("age", device.age_s === null ? "–" : device.age_s < 1 ? `${(device.age_s * 1000).toFixed(0)} ms` : `${device.age_s.toFixed(1)} s`);
    say("lost", device.lost);
    say("dropped", device.dropped);
    showDrift(row.querySelector(".drift"), device.drift);
    const more = [
      device.refused && `${device.refused} frames refused`,
      device.bad_bytes && `${device.bad_bytes} bad bytes`,
      device.reconnects && `${device.reconnects} reconnects`,
      device.reason,
    ];
    const why = row.querySelector(".why"); // its lines are always there: nothing moves when they are filled
    why.firstChild.textContent = why.title = more.filter(Boolean).join(", ");
  }
}

// A line since the tare, and the drift now by axis.
function showDrift(place, drift) {
  if (!drift) {
    return;
  }
  const digits = drift.unit === "N" ? 3 : 1;
  const most = Math.max(...drift.line, 1e-9);
  const last = Math.max(drift.line.length - 1, 1);
  const points = drift.line.map((value, at) => `${((200 * at) / last).toFixed(1)},${(22 - (20 * value) / most).toFixed(1)}`);
  if (!place.firstChild) {
    place.innerHTML = '<span></span><svg viewBox="0 0 200 24" preserveAspectRatio="none" role="img" aria-label="drift since the tare"><polyline /></svg>';
    place.title = "drift since the tare, or the beginning, while nothing touches it; the line: its length, largest at the top";
  }
  place.firstChild.textContent = place.firstChild.title = !drift.line.length ? "drift: not known yet" :
    `drift ≤ ${most.toFixed(digits)} ${drift.unit} in ${minutes(drift.lasted_s / 60)}\n${drift.loaded ? "touched now" : `now ${drift.now.map((value) => value.toFixed(digits)).join(", ")}`}`;
  place.querySelector("polyline").setAttribute("points", points.join(" "));
}

function showControls(next) {
  const mine = next.controls === session.page;
  const over = next.phase === "stopped";
  const possible = (kind) => next.commands.includes(kind);
  for (const section of document.querySelectorAll("[data-for]")) {
    if (section.dataset.for.split(" ").some(possible)) {
      section.dataset.shown = ""; // and from then on: what cannot be asked for meanwhile is pale, and nothing moves
    }
    section.hidden = section.dataset.shown === undefined;
  }
  for (const button of document.querySelectorAll("[data-kind]")) {
    const kind = button.dataset.kind;
    button.disabled = over || (kind !== "take-controls" && !possible(kind)) || (!mine && kind !== "stop" && kind !== "take-controls");
  }
  at("keep").firstChild.textContent = next.held_s === null ? "Keep the last seconds " : `Keep the last ${next.held_s.toFixed(0)} s `;
  at("holder").firstElementChild.textContent = over
    ? ""
    : mine
      ? next.pages > 1 ? `this page has the controls; ${next.pages} pages are open` : "this page has the controls"
      : next.controls ? "another page has the controls" : "no page has the controls";
  at("take").hidden = mine || over;
}

function showTares(names) {
  const shown = [...at("tares").children].map((button) => button.dataset.device);
  if (shown.join("\n") !== names.join("\n")) {
    at("tares").replaceChildren(
      ...names.map((name) => {
        const button = made("button");
        button.type = "button";
        button.dataset.device = name;
        button.dataset.kind = "tare";
        button.textContent = name;
        return button;
      }),
    );
    showControls(state);
  }
}

function showRemarks() {
  const all = [...state.remarks, ...replies].sort((a, b) => b.at_s - a.at_s).slice(0, 60);
  at("remarks").replaceChildren(
    ...all.map((remark) => {
      const line = made("li", remark.bad ? "bad" : "");
      const time = made("time");
      time.textContent = `${remark.at_s.toFixed(1)} s `;
      line.append(time, remark.words);
      return line;
    }),
  );
}

function showClock() {
  if (state?.recording) {
    const seconds = Math.max(0, performance.now() / 1000 - clockSkew_s - state.recorded_since_s);
    const room = state.free_minutes === null ? "" : `, room for ${minutes(state.free_minutes)}`;
    at("recording").textContent =
      `${minutes(seconds / 60)}, ${(state.recorded_bytes / 1e6).toFixed(1)} MB${room} ${state.recording}`;
  } else {
    at("recording").textContent = "nothing is being recorded";
  }
}
setInterval(() => state && showClock(), 500);

function minutes(value) {
  const seconds = Math.round(value * 60);
  return value >= 120 ? `${(value / 60).toFixed(1)} h` : `${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")} min`;
}

function showLag(batch) {
  skipped = batch?.skipped ?? skipped;
  const behind = !batch ? "the viewer shows all" : batch.behind_s === null ? "" : `viewer ${batch.behind_s.toFixed(1)} s behind`;
  at("lag").textContent = [behind, skipped && `${skipped} skipped`].filter(Boolean).join(", ");
}

function made(tag, name = "") {
  const element = document.createElement(tag);
  element.className = name;
  return element;
}

async function command(kind, fields) {
  const reply = await session.command(kind, fields);
  note(`${kind}: ${reply.outcome}${reply.words ? `, ${reply.words}` : ""}`, reply.outcome === "refused");
  return reply.outcome !== "refused";
}

function note(text, bad) {
  replies.push({ at_s: performance.now() / 1000 - clockSkew_s, words: text, bad });
  replies.splice(0, replies.length - 20);
  if (state) {
    showRemarks();
  }
}

// Buttons and forms

document.addEventListener("click", ({ target }) => {
  const button = target.closest?.("button[data-kind]");
  if (button && button.type !== "submit") {
    const { kind, device, parameter } = button.dataset;
    command(kind, { device, parameter });
  }
});
for (const [form, input, kind, field] of [
  ["note", "note-text", "write-note", "text"],
  ["episode", "episode-label", "begin-episode", "label"],
  ["discard", "discard-reason", "discard", "reason"],
]) {
  at(form).addEventListener("submit", async (event) => {
    event.preventDefault();
    const text = at(input).value.trim();
    at(input).blur(); // at once: what is typed next are keys again
    const what = event.submitter?.value ? { what: event.submitter.value } : {};
    if (text && (await command(kind, { [field]: text, ...what })) && at(input).value.trim() === text) {
      at(input).value = "";
    }
  });
}
at("help-button").addEventListener("click", () => at("help").showModal());
at("help").addEventListener("click", () => at("help").close());

// Keys: before the viewer gets them, whose own hidden field for text has the focus whenever the viewer has it

const ownField = (element) => element?.matches?.("#controls input");
const typeless = (element) => ["range", "checkbox", "radio"].includes(element.type); // what is typed there is no text
const writes = (element) => ownField(element) && !typeless(element) && element.type !== "number"; // a space is text there
let pointed = null;
window.addEventListener("pointerdown", ({ target }) => (pointed = target), { capture: true });
window.addEventListener("focusin", ({ target, relatedTarget }) => {
  if (ownField(relatedTarget) && !target.closest("aside, dialog, header") && pointed !== at("canvas")) {
    relatedTarget.focus(); // nobody clicked on the viewer: it takes the focus when it starts
  }
});

function write(kind, field) {
  if (!state?.commands.includes(kind)) {
    const recorded = !state?.commands.includes("start-recording");
    note(`${kind}: ${recorded ? "not possible now" : "nothing is being recorded; r starts a recording"}`, true);
    return;
  }
  at(field).focus();
}

function stop() {
  if (state?.playback) {
    playback.toggle();
  } else {
    command("stop");
  }
}

const KEYS = {
  r: () => command(state?.recording ? "stop-recording" : "start-recording"),
  k: () => command("keep-recent"),
  n: () => write("write-note", "note-text"),
  e: () => (state?.episode ? command("end-episode") : write("begin-episode", "episode-label")),
  d: () => write("discard", "discard-reason"),
  t: () => state?.tares.forEach((device) => command("tare", { device })),
  ",": () => state?.playback && playback.step(false),
  ".": () => state?.playback && playback.step(true),
  p: () => command("pause"),
  x: () => command(state?.commands.includes("squeeze") ? "squeeze" : "explore"),
  v: () => command("veto"),
  "?": () => (at("help").open ? at("help").close() : at("help").showModal()),
};
window.addEventListener(
  "keydown",
  (event) => {
    const stops = event.key === " " && (event.ctrlKey || !writes(event.target));
    if (event.key === "Enter" && event.target.type === "checkbox") {
      event.target.click();
      return;
    }
    if (ownField(event.target) && !stops && !(typeless(event.target) && KEYS[event.key])) {
      if (event.key === "Escape") {
        event.target.blur();
      }
      return;
    }
    if (!stops && (event.ctrlKey || event.altKey || event.metaKey)) {
      return;
    }
    const act = stops ? stop : KEYS[event.key];
    if (act) {
      event.preventDefault();
      event.stopPropagation();
      if (!event.repeat) {
        act();
      }
    }
  },
  { capture: true },
);
// what has the focus is not pressed by the space that stops
window.addEventListener("keyup", (event) => event.key === " " && !writes(event.target) && event.preventDefault());
