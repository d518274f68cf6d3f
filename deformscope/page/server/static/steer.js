// Touching from the page: what waits for a confirm, places typed or picked in the viewer, expected beside felt.

const at = (id) => document.getElementById(id);
const WIDTH = 180;
const HEIGHT = 94;
const LEFT = 24;
const TOP = 6;
const LET_BE = "let be"; // in the place of what was asked for: nobody confirmed it

// command: sends one, and resolves with whether it was not refused; session: where the same is done and nobody reads of it
export function startSteering(command, session) {
  let state = null;
  let skew_s = 0;
  let answered = 0; // the number of the move that was answered here
  let seen = 0; // the number of the newest that was drawn here
  let place = ""; // what was asked for

  const dialog = at("confirm");
  const answer = async (kind) => {
    if (!state?.pending || !dialog.open) {
      return;
    }
    const { number } = state.pending;
    answered = number;
    dialog.close();
    if (!(await command(kind, { number })) && answered === number) {
      answered = 0; // it still waits, where it has not expired
      show(state);
    }
  };
  at("confirm-yes").addEventListener("click", () => answer("confirm"));
  at("confirm-no").addEventListener("click", () => answer("cancel"));
  dialog.addEventListener("cancel", (event) => {
    event.preventDefault();
    answer("cancel");
  });
  dialog.addEventListener("keydown", (event) => {
    if (event.key === "Enter" && !event.repeat && event.target !== at("confirm-no")) {
      event.preventDefault();
      answer("confirm");
    }
  });

  at("place").addEventListener("submit", (event) => {
    event.preventDefault();
    const [x, y] = [at("place-x"), at("place-y")].map((input) => input.valueAsNumber / 100);
    if (Number.isFinite(x) && Number.isFinite(y)) {
      touch("touch-at", { x_m: x, y_m: y });
    }
  });
  document.addEventListener("viewer", ({ detail }) => {
    const picked = detail.type === "selection_change" && detail.items?.find((item) => item.entity_path && item.position);
    if (picked && state?.controls === session.page && state.commands.includes("touch-picked")) {
      touch("touch-picked", { entity: picked.entity_path, position_m: [...picked.position] });
    }
  });

  async function touch(kind, fields) {
    place = kind;
    say("asking for the touch");
    if (!(await command(kind, fields))) {
      say("refused: see below", true);
    }
  }

  function say(words, bad = false) {
    at("place-words").textContent = words;
    at("place-words").className = bad ? "bad" : "";
  }

  function show(next) {
    const before = state;
    state = next;
    skew_s = performance.now() / 1000 - next.now_s;
    const mine = next.controls === session.page && next.phase !== "stopped";
    const waits = mine && next.pending && next.pending.number !== answered;
    if (waits && !dialog.open) {
      at("help").close();
      at("confirm-what").textContent = next.pending.what;
      dialog.showModal();
      at("confirm-yes").focus();
      place = place === LET_BE ? "" : place;
      if (seen !== next.pending.number) {
        seen = next.pending.number;
        // once it is drawn: its time counts from then
        requestAnimationFrame(() => setTimeout(() => session.command("seen", { number: seen })));
      }
    } else if (!waits && dialog.open) {
      dialog.close();
    }
    showLeft();
    if (mine && before?.pending && !next.pending && before.pending.number !== answered) {
      place = LET_BE; // why comes as a remark
    }
    const planned = next.next_place;
    at("next-place").textContent = planned
      ? `next: (${(100 * planned.x_m).toFixed(1)}, ${(100 * planned.y_m).toFixed(1)}) cm. ${planned.reason}`
      : "";
    const fresh = next.remarks.filter((remark) => remark.number > (before?.remarks.at(-1)?.number ?? 0));
    const refusal = fresh.find((remark) => remark.bad);
    if (next.phase !== "paused" || next.curve?.words) {
      place = "";
    }
    if (place && refusal) {
      say(refusal.words, true);
    } else if (place && (next.pending || fresh.length)) {
      say(next.pending ? "planned: drawn in the viewer" : fresh.at(-1).words);
    } else if (!place) {
      say(next.commands.includes("touch-picked") ? "or click a point of the surface in the viewer" : "");
    }
    if (next.curve !== before?.curve && JSON.stringify(next.curve) !== JSON.stringify(before?.curve ?? null)) {
      showCurve(next.curve);
    }
  }

  function showLeft() {
    if (state?.pending && dialog.open) {
      const left_s = state.pending.until_s - (performance.now() / 1000 - skew_s);
      at("confirm-left").textContent = Math.max(0, Math.ceil(left_s));
      if (left_s <= 0 && state.pending.seen) {
        dialog.close();
      }
    }
  }
  setInterval(showLeft, 250);

  return { show, close: () => dialog.close() };
}

function showCurve(curve) {
  at("curve").hidden = !curve;
  if (!curve) {
    return;
  }
  const most_mm = nice(Math.max(...curve.depth_mm, ...curve.felt_mm) * 1.3);
  const most_n = nice(Math.max(...curve.force_n, ...curve.felt_n));
  const point = (mm, n) => `${(LEFT + (WIDTH * Math.min(mm, most_mm)) / most_mm).toFixed(1)} ${(TOP + HEIGHT * (1 - n / most_n)).toFixed(1)}`;
  const line = (mm, n) => mm.map((one, i) => `${i ? "L" : "M"}${point(one, n[i])}`).join("");
  const set = (name, d) => at("curve").querySelector(name).setAttribute("d", d);
  const back = (values) => [...values].reverse();
  const { force_n, depth_mm, depth_low_mm, depth_high_mm, felt_mm, felt_n } = curve;
  set(".band", `${line([...depth_low_mm, ...back(depth_high_mm)], [...force_n, ...back(force_n)])}Z`);
  set(".expected", line(depth_mm, force_n));
  set(".felt", line(felt_mm, felt_n));
  at("curve").querySelector(".most-n").textContent = most_n;
  at("curve").querySelector(".most-mm").textContent = `${most_mm} mm`;
  at("curve").querySelector("figcaption").textContent =
    `at (${(100 * curve.x_m).toFixed(1)}, ${(100 * curve.y_m).toFixed(1)}) cm: ${curve.words || `expected (blue, 90 %) from ${curve.known}`}`;
}

// the next round number
function nice(value) {
  const step = 10 ** Math.floor(Math.log10(Math.max(value, 1e-6)));
  return Number((step * [1, 2, 3, 4, 5, 6, 8, 10].find((one) => one * step >= value * 0.999)).toPrecision(2));
}
