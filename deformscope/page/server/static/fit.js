// A fit that is set on the page: sliders, region and outline go to the server, and what it simulates is drawn at once.

const at = (id) => document.getElementById(id);
const HELD = ["top", "bottom", "left", "right", "border", "contact"];
const COLORS = { rest: "#1ebe50", observed: "#286eff", simulated: "#eb2d2d", held: "#ffc800", box: "#ffffff", scale: "#00d2d2" };
const FINEST_PX = 4;
const MOST_CHANGES = 1000; // of so many, the newest, it is said how long they took to be seen
const NEAR_PX = 12; // of the screen: a click so near to the first corner closes an outline

// session: gives commands; say: words that answer them
export function startFitting(session, say) {
  let fit = null;
  let mine = false;
  let settings = null; // as they are on the page, shown or not
  let changed_ms = null; // when a person changed what was not sent yet
  let flight = null; // what was sent and is not drawn yet
  let running = false; // a whole fit is wanted of what was changed and is not drawn yet
  let number = Date.now(); // counts on over pages
  let shown = "";
  const drawing = () => `${fit.number} ${fit.pictures} ${fit.rest.length} ${fit.simulated.length}`;
  let drag = null;
  let tool = "region";
  let showing = "deformed";
  const waits_ms = [];
  const images = new Map(); // that were loaded, by name
  let loading = false;
  let newest = null; // state that came, and of which page
  const canvas = at("fit-canvas");

  // What is set -------------------------------------------------------------------------------------------------------

  function change(changes) {
    if (!fit || !mine) {
      return;
    }
    settings = { ...settings, ...changes };
    running = false;
    changed_ms ??= performance.now();
    showControls();
    draw();
    send();
  }

  // One at a time: what is changed meanwhile is sent together once that is drawn, the newest of it.
  async function send() {
    if (flight || changed_ms === null) {
      return;
    }
    const sent = { number: ++number, since_ms: changed_ms };
    flight = sent;
    changed_ms = null;
    const reply = await session.command("set-fit", { number: sent.number, settings });
    if (reply.outcome === "refused" && flight === sent) {
      flight = null;
      say(`not set: ${reply.words}`);
    }
  }

  function drawn(sent) {
    const after_ms = performance.now() - sent.since_ms;
    waits_ms.push(after_ms);
    waits_ms.splice(0, waits_ms.length - MOST_CHANGES);
    session.command("fit-drawn", { number: sent.number, after_ms });
    const rising = [...waits_ms].sort((a, b) => a - b);
    const share = (part) => rising[Math.min(rising.length - 1, Math.floor(part * rising.length))].toFixed(0);
    at("fit-waits").textContent = `slider to picture: p50 ${share(0.5)} ms, p95 ${share(0.95)} ms, ${rising.length} changes`;
    flight = null;
    send();
    if (running && !flight) {
      run();
    }
  }

  // From the server ---------------------------------------------------------------------------------------------------

  function show(state, page) {
    if (!state.fit) {
      [mine, flight, changed_ms, running] = [false, null, null, false];
      return;
    }
    if (missing(state, page)) {
      return; // particles are drawn on the picture that they were seen in
    }
    fit = state.fit;
    mine = state.controls === page && state.commands.includes("set-fit");
    if (!mine) {
      [flight, changed_ms, running] = [null, null, false]; // another page goes on with it
    }
    const sent = flight?.number === fit.number ? flight : null;
    if (!flight && changed_ms === null) {
      settings = fit.settings;
    }
    if (showing === "result" && !fit.picture) {
      showing = "deformed";
    }
    showControls();
    showNumbers();
    if (sent) {
      requestAnimationFrame(() => {
        draw();
        setTimeout(() => flight === sent && drawn(sent));
      });
    } else if (drawing() !== shown) {
      requestAnimationFrame(draw);
    }
    shown = drawing();
  }

  // Whether pictures of a state are still to be loaded: it is shown with them, and after it the newest that came meanwhile.
  function missing(state, page) {
    newest = [state, page];
    const names = state.fit.pictures;
    if (names.every((name) => images.has(name))) {
      return false;
    }
    if (!loading) {
      loading = true;
      Promise.all(names.map(loaded)).then((all) => {
        images.clear();
        names.forEach((name, i) => images.set(name, all[i]));
        loading = false;
        const later = newest;
        show(state, page);
        if (later[0] !== state) {
          show(...later);
        }
      });
    }
    return true;
  }

  async function loaded(name) {
    const image = images.get(name) ?? new Image();
    if (!image.src) {
      image.src = name;
      await image.decode().catch(() => null);
    }
    return image;
  }

  function showControls() {
    const now = settings;
    for (const field of document.querySelectorAll("#fit-controls :is(input, button), #fit-tools :is(input, button)")) {
      field.disabled = !mine && field.name !== "fit-show";
    }
    const pair = fit.kind === "pair";
    for (const element of document.querySelectorAll(".of-images")) {
      element.hidden = pair;
    }
    const spacing = now.spacing_px ?? fit.spacing_px;
    const [width, height] = fit.size_px;
    if (spacing) {
      const [low, high] = [Math.log(FINEST_PX), Math.log(Math.min(width, height) / 2)];
      at("fit-spacing").value = (1000 * (Math.log(spacing) - low)) / (high - low);
      at("fit-spacing-words").textContent = `${spacing.toFixed(1)} px${fit.grid ? `, ${fit.grid.join("x")}` : ""}`;
    }
    const none = fit.parameter === "theta" ? 1 : 0; // one cluster of all
    at("fit-cluster").min = 2 - none;
    at("fit-cluster").value = now.cluster_size ?? 1;
    at("fit-cluster-words").textContent = now.cluster_size ? `${now.cluster_size} a side` : "one of all";
    for (const name of ["beta", "theta"]) {
      at(`fit-${name}`).max = name === fit.parameter ? fit.bounds[1] : name === "beta" ? 0.99 : 1;
      at(`fit-${name}`).value = now[name];
      at(`fit-${name}-words`).textContent = now[name].toFixed(3);
    }
    for (const name of HELD) {
      at(`held-${name}`).checked = now.held.includes(name);
    }
    for (const [name, box] of [["roi", now.roi], ["contact", now.contact]]) {
      if (document.activeElement !== at(`fit-${name}`)) {
        at(`fit-${name}`).value = box ? box.join(",") : "";
      }
    }
    at("fit-outline-words").textContent = now.outline.length ? `${now.outline.length} corners` : "none";
    at("show-result").disabled = !fit.picture;
    for (const input of document.querySelectorAll("[name=fit-show]")) {
      input.checked = input.value === showing;
    }
    at("fit-result").hidden = showing !== "result";
    if (showing === "result" && at("fit-result").dataset.of !== JSON.stringify(fit.found)) {
      at("fit-result").dataset.of = JSON.stringify(fit.found);
      at("fit-result").src = `${fit.picture}?${Date.now()}`;
    }
  }

  function showNumbers() {
    const length = (value) => (value === null ? "–" : fit.unit === "px" ? `${value.toFixed(3)} px` : `${(1000 * value).toFixed(3)} mm`);
    at("fit-error").textContent = `average error ${length(fit.aee)} (all particles; free ones alone ${length(fit.aee_free)})`;
    at("fit-error").title = `${fit.aee} ${fit.unit} all, ${fit.aee_free} ${fit.unit} free`;
    at("fit-problem").textContent = fit.problem || fit.busy;
    at("fit-problem").className = fit.problem ? "numbers bad" : "numbers";
    at("fit-command").textContent = fit.command;
    at("fit-copy").disabled = !fit.command;
    at("fit-words").textContent = fit.kind === "images" && !fit.pictures.length ? fit.busy : "";
    const found = fit.found;
    at("fit-found").textContent = found
      ? `${fit.parameter} ${found.value.toFixed(4)}, ${found.low.toFixed(3)} to ${found.high.toFixed(3)} (${100 * found.level} %). ${found.verdict}${found.force && `. ${found.force}`}`
      : "";
    at("fit-found").title = found ? `${found.value}` : "";
    const least = Math.min(...fit.errors.filter((error) => error !== null));
    const lowest = fit.values[fit.errors.indexOf(least)];
    at("fit-least").textContent = lowest === undefined ? "" : `least of ${fit.values.length} tried: ${length(least)} (all particles) at ${fit.parameter} ${lowest.toFixed(2)}`;
    showCurve();
  }

  function showCurve() {
    const [low, high] = fit.bounds;
    const points = fit.values.map((value, i) => [value, fit.errors[i]]).filter(([, error]) => error !== null);
    const errors = points.map(([, error]) => error);
    if (fit.aee !== null) {
      errors.push(fit.aee);
    }
    const [least, most] = [Math.min(...errors), Math.max(...errors)];
    const x = (value) => 24 + (180 * (value - low)) / (high - low);
    const y = (error) => 100 - 90 * ((error - least) / (most - least || 1)) - 2;
    const line = points.map(([value, error], i) => `${i ? "L" : "M"}${x(value).toFixed(1)} ${y(error).toFixed(1)}`).join("");
    const set = (name, path) => at("fit-curve").querySelector(name).setAttribute("d", path);
    set(".expected", line);
    const here = settings[fit.parameter];
    set(".felt", fit.aee === null ? "" : `M${x(here).toFixed(1)} 6V100`);
    set(".band", fit.found ? `M${x(fit.found.low).toFixed(1)} 6H${x(fit.found.high).toFixed(1)}V100H${x(fit.found.low).toFixed(1)}Z` : "");
    const scale = fit.unit === "px" ? 1 : 1000;
    const axis = (value) => (value > 0 && value < 1e-3 ? value.toExponential(0) : value.toPrecision(3));
    at("fit-curve").querySelector(".most").textContent = errors.length ? axis(scale * most) : "";
    at("fit-curve").querySelector(".least").textContent = errors.length ? axis(scale * least) : "";
    at("fit-curve").querySelector(".low").textContent = low.toFixed(2);
    at("fit-curve").querySelector(".high").textContent = `${fit.parameter} ${high.toFixed(2)}`;
  }

  // The picture -------------------------------------------------------------------------------------------------------

  let shift = { scale: 1, x: 0, y: 0 };

  function draw() {
    if (!fit) {
      return;
    }
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth, clientHeight } = canvas;
    if (canvas.width !== Math.round(clientWidth * ratio) || canvas.height !== Math.round(clientHeight * ratio)) {
      canvas.width = Math.round(clientWidth * ratio);
      canvas.height = Math.round(clientHeight * ratio);
    }
    const [width, height] = fit.size_px;
    const scale = Math.min(clientWidth / width, clientHeight / height);
    shift = { scale, x: (clientWidth - width * scale) / 2, y: (clientHeight - height * scale) / 2 };
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, clientWidth, clientHeight);
    pen.setTransform(ratio * scale, 0, 0, ratio * scale, ratio * shift.x, ratio * shift.y);
    const image = images.get(showing === "rest" ? fit.pictures[0] : fit.pictures[1]);
    if (image?.complete && image.naturalWidth) {
      pen.drawImage(image, 0, 0, width, height);
    } else if (fit.pictures.length || fit.kind === "pair") {
      pen.fillStyle = "#e8ebf0";
      pen.fillRect(0, 0, width, height);
    }
    drawParticles(pen, scale);
    if (showing === "rest" || drag || tool === "outline" || fit.busy) {
      drawRegion(pen, scale);
    }
  }

  function drawParticles(pen, scale) {
    const size = Math.max(2.2, Math.min(5, (0.16 * (fit.spacing_px ?? 30)) * scale)) / scale;
    const [from, to] = showing === "rest" ? [fit.rest, null] : [fit.observed, fit.simulated];
    const ok = (point) => point && point[0] !== null && point[1] !== null;
    const strokes = (color, width, path) => {
      pen.beginPath();
      path();
      pen.lineWidth = width / scale;
      pen.strokeStyle = color;
      pen.stroke();
    };
    if (to) {
      strokes(COLORS.simulated, 1, () =>
        from.forEach((point, i) => {
          if (ok(to[i]) && fit.seen[i]) {
            pen.moveTo(...point);
            pen.lineTo(...to[i]);
          }
        }),
      );
    }
    strokes(showing === "rest" ? COLORS.rest : COLORS.observed, 2, () =>
      from.forEach(([x, y], i) => {
        if (fit.seen[i] || showing === "rest") {
          pen.moveTo(x + size, y);
          pen.arc(x, y, size, 0, 7);
        }
      }),
    );
    if (to) {
      strokes(COLORS.simulated, 2, () =>
        to.filter(ok).forEach(([x, y]) => {
          pen.moveTo(x - size, y - size);
          pen.lineTo(x + size, y + size);
          pen.moveTo(x - size, y + size);
          pen.lineTo(x + size, y - size);
        }),
      );
    }
    strokes(COLORS.held, 2, () =>
      fit.held.forEach((i) => {
        const [x, y] = from[i];
        pen.rect(x - 1.5 * size, y - 1.5 * size, 3 * size, 3 * size);
      }),
    );
  }

  function drawRegion(pen, scale) {
    pen.lineWidth = 2 / scale;
    for (const [box, dash] of [[settings.roi, [8, 5]], [settings.contact, [2, 3]]]) {
      if (box) {
        pen.setLineDash(dash.map((one) => one / scale));
        for (const [color, inset] of [["#000000", 1], [COLORS.box, 0]]) {
          pen.strokeStyle = color;
          pen.strokeRect(box[0] - inset / scale, box[1] - inset / scale, box[2], box[3]);
        }
      }
    }
    pen.setLineDash([]);
    const corners = corners_now();
    if (corners.length) {
      pen.beginPath();
      corners.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      if (!pending.length) {
        pen.closePath();
      }
      pen.strokeStyle = COLORS.box;
      pen.stroke();
      pen.fillStyle = COLORS.box;
      corners.forEach(([x, y]) => pen.fillRect(x - 3 / scale, y - 3 / scale, 6 / scale, 6 / scale));
    }
    if (fit.scale) {
      const [x, y, to_x, to_y, metres] = fit.scale;
      pen.beginPath();
      pen.moveTo(x, y);
      pen.lineTo(to_x, to_y);
      pen.lineWidth = 3 / scale;
      pen.strokeStyle = pen.fillStyle = COLORS.scale;
      pen.stroke();
      pen.font = `${15 / scale}px sans-serif`;
      pen.fillText(`${Number((1000 * metres).toPrecision(4))} mm`, (x + to_x) / 2, (y + to_y) / 2 - 6 / scale);
    }
  }

  // Clicks and drags --------------------------------------------------------------------------------------------------

  let pending = []; // corners of an outline that is not closed

  const corners_now = () => (pending.length ? pending : settings.outline);

  function place({ clientX, clientY }) {
    const { left, top } = canvas.getBoundingClientRect();
    const [width, height] = fit.size_px;
    const held = (value, most) => Math.min(Math.max(Math.round(value), 0), most);
    return [
      held((clientX - left - shift.x) / shift.scale, width),
      held((clientY - top - shift.y) / shift.scale, height),
    ];
  }

  const box_of = ([x0, y0], [x1, y1]) => [Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0)];

  function setBox(box) {
    if (tool === "region") {
      change({ roi: box });
    } else {
      change({ contact: box, held: [...new Set([...settings.held, "contact"])] });
    }
  }

  canvas.addEventListener("pointerdown", (event) => {
    if (!mine || fit.kind === "pair") {
      return;
    }
    showing = "rest"; // the region is one of the first picture
    const point = place(event);
    if (tool === "outline") {
      const [first] = pending;
      const near = first && Math.hypot(point[0] - first[0], point[1] - first[1]) * shift.scale < NEAR_PX;
      if (near && pending.length > 2) {
        const closed = pending;
        pending = [];
        change({ outline: closed });
      } else {
        pending = [...pending, point];
        showControls();
        draw();
      }
      return;
    }
    canvas.setPointerCapture(event.pointerId);
    drag = point;
  });
  canvas.addEventListener("pointermove", (event) => {
    if (drag) {
      const box = box_of(drag, place(event));
      if (box[2] > 4 && box[3] > 4) {
        setBox(box);
      }
    }
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, () => (drag = null));
  }
  canvas.addEventListener("dblclick", () => {
    if (tool === "outline" && pending.length > 2) {
      const closed = pending.filter((point, i) => i === 0 || point.join() !== pending[i - 1].join());
      pending = [];
      change({ outline: closed });
    }
  });

  // Sliders, fields and buttons ---------------------------------------------------------------------------------------

  at("fit-spacing").addEventListener("input", ({ target }) => {
    const [low, high] = [Math.log(FINEST_PX), Math.log(Math.min(...fit.size_px) / 2)];
    const spacing = Math.round(10 * Math.exp(low + (target.valueAsNumber / 1000) * (high - low))) / 10;
    change({ spacing_px: spacing, grid: null });
  });
  at("fit-cluster").addEventListener("input", ({ target }) =>
    change({ cluster_size: target.valueAsNumber < 2 ? null : target.valueAsNumber }),
  );
  for (const name of ["beta", "theta"]) {
    at(`fit-${name}`).addEventListener("input", ({ target }) => change({ [name]: target.valueAsNumber }));
  }
  for (const name of HELD) {
    at(`held-${name}`).addEventListener("change", ({ target }) => {
      const held = HELD.filter((one) => (one === name ? target.checked : settings.held.includes(one)));
      if (name === "contact" && target.checked && !settings.contact) {
        tool = "contact";
        say("drag the tool's footprint on the picture");
        showTool();
        showControls();
        return;
      }
      change({ held, ...(held.includes("contact") ? {} : { contact: null }) });
    });
  }
  for (const name of ["roi", "contact"]) {
    at(`fit-${name}`).addEventListener("change", ({ target }) => {
      const box = target.value.trim() ? target.value.split(",").map(Number) : null;
      if (box && (box.length !== 4 || box.some((value) => !Number.isFinite(value)))) {
        say("four numbers: x, y, width, height in pixels");
      } else if (name === "roi") {
        change({ roi: box });
      } else {
        const others = settings.held.filter((one) => one !== "contact");
        change({ contact: box, held: box ? [...others, "contact"] : others });
      }
    });
  }
  at("fit-clear").addEventListener("click", () => {
    pending = [];
    change({ outline: [] });
  });
  at("fit-run").addEventListener("click", run);
  for (const input of document.querySelectorAll("[name=fit-tool]")) {
    input.addEventListener("change", () => {
      tool = input.value;
      pending = [];
      showing = "rest";
      showControls();
      draw();
    });
  }
  for (const input of document.querySelectorAll("[name=fit-show]")) {
    input.addEventListener("change", () => {
      showing = input.value;
      showControls();
      draw();
    });
  }
  at("fit-copy").addEventListener("click", () => navigator.clipboard?.writeText(fit.command));
  new ResizeObserver(draw).observe(canvas);

  function showTool() {
    for (const input of document.querySelectorAll("[name=fit-tool]")) {
      input.checked = input.value === tool;
    }
  }

  // What was changed before it is not to end it.
  async function run() {
    running = flight !== null || changed_ms !== null;
    if (mine && !running) {
      const reply = await session.command("run-fit");
      if (reply.outcome === "refused") {
        say(`not fitted: ${reply.words}`);
      }
    }
  }

  return { show, run };
}
