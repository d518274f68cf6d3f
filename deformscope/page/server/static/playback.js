// Plays a recording in the viewer: the page says which moment it shows, and the viewer stands there.

const at = (id) => document.getElementById(id);
const EVERY_MS = 100;
const AGAIN_MS = 300;

// playback: the part of the state; show: stands at a moment [ns], resolves once it does
export function startPlayback(show) {
  let playback = null;
  let now_ns = 0;
  let playing = false;
  let from_ns = 0;
  let until_ns = 0;
  let shown_ms = performance.now();
  let busy = false;
  let stood = false; // the viewer has stood where it was asked to

  const seconds = (ns) => (ns / 1e9).toFixed(2);
  const words = () => {
    at("play").firstChild.textContent = playing ? "Pause " : "Play ";
    at("moment").textContent = playback ? `${seconds(now_ns)} of ${seconds(playback.until_ns)} s` : "";
  };

  function go(ns) {
    now_ns = Math.min(Math.max(Math.round(ns), playback?.from_ns ?? 0), playback?.until_ns ?? 0);
    stand();
  }

  async function stand() {
    words();
    if (busy || !playback) {
      return;
    }
    busy = true;
    const asked_ns = now_ns;
    try {
      await show(playback.timeline, asked_ns);
      stood = true;
      at("moment").title = "";
    } catch (error) {
      at("moment").title = `the viewer: ${error}`; // it is painting, or has no data yet
      setTimeout(stand, AGAIN_MS);
    }
    busy = false;
    if (asked_ns !== now_ns) {
      stand();
    }
  }

  function span(low_ns, high_ns) {
    [from_ns, until_ns] = [low_ns, high_ns];
    at("play-from").value = seconds(low_ns);
    at("play-until").value = seconds(high_ns);
  }

  setInterval(() => {
    const passed_ms = performance.now() - shown_ms;
    shown_ms = performance.now();
    if (!playing || busy) {
      return;
    }
    let next_ns = now_ns + passed_ms * 1e6 * Number(at("speed").value);
    if (next_ns >= until_ns) {
      playing = at("loop").checked;
      next_ns = playing ? from_ns : until_ns;
    }
    go(next_ns);
  }, EVERY_MS);

  const toggle = () => {
    playing = !playing;
    if (playing && (now_ns >= until_ns || now_ns < from_ns)) {
      go(from_ns);
    }
    words();
  };
  const step = (forward) => {
    playing = false;
    go(now_ns + (forward ? 1 : -1) * playback.step_ns);
  };
  at("play").addEventListener("click", toggle);
  at("step-back").addEventListener("click", () => step(false));
  at("step-on").addEventListener("click", () => step(true));
  for (const id of ["play-from", "play-until"]) {
    at(id).addEventListener("change", () => {
      const [low, high] = [at("play-from"), at("play-until")].map((input) => Math.round(input.valueAsNumber * 1e9));
      if (low < high && low < playback.until_ns) {
        span(Math.max(low, playback.from_ns), Math.min(high, playback.until_ns));
      } else {
        span(from_ns, until_ns);
      }
    });
  }

  return {
    stand,
    toggle,
    step,
    load: (given) => {
      if (!given || playback) {
        return;
      }
      playback = given;
      span(given.from_ns, given.until_ns);
      at("chapters").replaceChildren(
        ...[{ name: "all", from_ns: given.from_ns, until_ns: given.until_ns }, ...given.chapters].map((chapter) => {
          const button = document.createElement("button");
          button.type = "button";
          button.textContent = chapter.name;
          button.title = `${seconds(chapter.from_ns)} to ${seconds(chapter.until_ns)} s`;
          button.addEventListener("click", () => {
            span(chapter.from_ns, chapter.until_ns);
            go(chapter.from_ns);
          });
          return button;
        }),
      );
      go(given.from_ns < 0 ? given.from_ns : given.until_ns); // what was found, unless it begins before a contact
    },
    // The viewer's own time, which somebody has moved in it.
    moved: (ns) => {
      if (playback && stood && !busy && !playing) {
        now_ns = ns;
        words();
      }
    },
  };
}

// rerun's `ViewerControlRequest` to set the time cursor, as protobuf: set_time_cursor (6) of timeline (2), time (3) and
// play_state (5), which is paused (1): the viewer would go on by itself
export function cursorRequest(timeline, ns) {
  const name = new TextEncoder().encode(timeline);
  const bytes = (number, content) => [(number << 3) | 2, ...varint(BigInt(content.length)), ...content];
  const time = [1 << 3, ...varint(BigInt.asUintN(64, BigInt(Math.round(ns))))]; // negative ones as protobuf has them
  return new Uint8Array(bytes(6, [...bytes(2, bytes(1, [...name])), ...bytes(3, time), 5 << 3, 1]));
}

function varint(value) {
  const found = [];
  for (; value > 127n; value >>= 7n) {
    found.push(Number(value & 127n) | 128);
  }
  return [...found, Number(value)];
}
