// Robots on canvases: mountPlayer(element, payload, {autoplay}), see player.py. No library, no network.
"use strict";

globalThis.mountPlayer ??= (() => {
  const FORMAT = 1;
  const SPEEDS = [0.25, 0.5, 1, 2, 4];
  const STEP = 0.1, LEAP = 1, PAGE = 10; // s, of the arrow keys, with shift, and of the page keys
  const GROUND = 30; // px from the floor to the lower edge: marks and their numbers
  const NARROWEST = 1.9; // body lengths across the window at least, of a camera that follows
  const MARGIN = 0.75; // body lengths from the centres to the edges
  const TALLEST = [360, 220, 170]; // px of a lane, if there is one, two, more
  const MARKS_APART = 52; // px at least
  const LONGEST_FRAME = 250; // ms that the clock goes on in a frame: a tab in the background has none

  // --- unpacking -----------------------------------------------------------------------------------------------

  async function unpacked(robot) {
    const { data, planes, frames, nodes, quantum, interval, end } = robot.coordinates;
    const packed = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const count = 2 * nodes * frames;
    if (bytes.length !== planes * count) throw new Error("its length is not what it says");
    return { ...robot, frames, nodes, interval, end, quantum, whole: summed(bytes, planes, count, frames) };
  }

  // Whole quanta of each coordinate, frame by frame, from the bytes of their second differences.
  function summed(bytes, planes, count, frames) {
    const whole = new Int32Array(count);
    for (let start = 0; start < count; start += frames) {
      let value = 0, change = 0;
      for (let i = start; i < start + frames; i++) {
        let unsigned = 0;
        for (let plane = 0; plane < planes; plane++) unsigned |= bytes[plane * count + i] << (8 * plane);
        change += (unsigned >>> 1) ^ -(unsigned & 1);
        value += change;
        whole[i] = value;
      }
    }
    return whole;
  }

  // What the camera needs to know of all frames, in body lengths from the start.
  function surveyed(robot) {
    const { frames, nodes, whole, quantum, length, center } = robot;
    const mean = (axis, f) =>
      center.reduce((sum, node) => sum + whole[(2 * node + axis) * frames + f], 0) * quantum / center.length;
    const startX = mean(0, 0), startY = robot.floor ?? mean(1, 0);
    const series = (axis, start) => Float64Array.from({ length: frames }, (_, f) => (mean(axis, f) - start) / length);
    const x = series(0, startX), y = series(1, startY);
    let left = Infinity, right = -Infinity;
    const high = new Float64Array(frames).fill(-Infinity);
    for (let node = 0; node < nodes; node++) {
      for (let f = 0; f < frames; f++) {
        left = Math.min(left, whole[2 * node * frames + f]);
        right = Math.max(right, whole[2 * node * frames + f]);
        high[f] = Math.max(high[f], (whole[(2 * node + 1) * frames + f] * quantum - startY) / length);
      }
    }
    const second = Math.round(1 / (robot.interval || 1));
    return {
      ...robot, startX, startY, x, y,
      smooth: [x, y].map((values) => averaged(values, second / 2)),
      left: (left * quantum - startX) / length,
      right: (right * quantum - startX) / length,
      tall: robot.floor === null ? new Float64Array(frames).fill(1.2) : headroom(high, 2 * second),
      xy: new Float64Array(2 * nodes),
    };
  }

  // The height above all that is still to come, falling smoothly: the camera only ever comes nearer.
  function headroom(high, frames) {
    const still = high.slice();
    for (let f = still.length - 2; f >= 0; f--) still[f] = Math.max(still[f], still[f + 1]);
    let sum = 0;
    return still.map((value, f) => {
      sum += value - (f > frames ? still[f - frames - 1] : 0);
      return 1.05 * (sum / Math.min(f + 1, frames + 1));
    });
  }

  // Means over as many frames before as after, `reach` of them where there are: a camera that does not shake.
  function averaged(values, reach) {
    const sums = new Float64Array(values.length + 1);
    values.forEach((value, f) => { sums[f + 1] = sums[f] + value; });
    return values.map((_, f) => {
      const near = Math.min(Math.floor(reach), f, values.length - 1 - f);
      return (sums[f + near + 1] - sums[f - near]) / (2 * near + 1);
    });
  }

  // --- a moment ------------------------------------------------------------------------------------------------

  // The frame before a time, the one after it, and how far between them the time is.
  function between(robot, time) {
    const { frames, interval, end } = robot;
    if (time >= end || frames < 2) return [frames - 1, frames - 1, 0];
    const first = Math.min(Math.floor(time / interval), frames - 2);
    const next = first + 1 === frames - 1 ? end : (first + 1) * interval;
    return [first, first + 1, (time - first * interval) / (next - first * interval)];
  }

  function at(robot, values, time) {
    const [a, b, part] = between(robot, time);
    return values[a] + (values[b] - values[a]) * part;
  }

  // Positions at a time, u: x of node 0, y of node 0, x of node 1 ...
  function positions(robot, time) {
    const { frames, whole, quantum, xy } = robot;
    const [a, b, part] = between(robot, time);
    for (let c = 0; c < xy.length; c++) {
      const start = whole[c * frames + a];
      xy[c] = (start + (whole[c * frames + b] - start) * part) * quantum;
    }
    return xy;
  }

  function contraction(robot, xy, muscle) {
    const a = 2 * robot.muscles[2 * muscle], b = 2 * robot.muscles[2 * muscle + 1];
    return 1 - Math.hypot(xy[b] - xy[a], xy[b + 1] - xy[a + 1]) / robot.rest[muscle];
  }

  function muscleColor(stops, strain, shorter) {
    const place = ((Math.min(Math.max(shorter / strain, -1), 1) + 1) / 2) * (stops.length - 1);
    const first = Math.min(Math.floor(place), stops.length - 2);
    const part = place - first;
    const mixed = [1, 3, 5].map((i) => {
      const [a, b] = [stops[first], stops[first + 1]].map((stop) => parseInt(stop.slice(i, i + 2), 16));
      return Math.floor(a + (b - a) * part + 0.5);
    });
    return `rgb(${mixed.join(", ")})`;
  }

  // --- the camera ----------------------------------------------------------------------------------------------

  // What all lanes show at a time: the middle of the window and px a body length.
  function camera(robots, time, follow, width, height) {
    const centers = robots.map((robot) => at(robot, robot.smooth[0], time));
    const [left, right] = follow
      ? [Math.min(...centers) - MARGIN, Math.max(...centers) + MARGIN]
      : [Math.min(...robots.map((robot) => robot.left)) - 0.1, Math.max(...robots.map((robot) => robot.right)) + 0.1];
    const wide = Math.max(right - left, NARROWEST);
    const tall = Math.max(...robots.map((robot) => at(robot, robot.tall, follow ? time : 0)));
    return { middle: (left + right) / 2, scale: Math.min(width / wide, (height - GROUND) / tall) };
  }

  // Height of a lane for its width, so that a robot that fills it across is not cut off.
  function laneHeight(robots, width) {
    const tallest = TALLEST[Math.min(robots.length, TALLEST.length) - 1];
    const tall = Math.max(...robots.map((robot) => robot.tall[0]));
    return Math.round(Math.min(tallest, Math.max(110, (width / NARROWEST) * tall + GROUND)));
  }

  // From u to px of a lane's canvas.
  function lens(robot, time, shot, width, height) {
    const scale = shot.scale / robot.length;
    const up = robot.floor === null ? at(robot, robot.smooth[1], time) : 0;
    const floor = robot.floor === null ? height / 2 : height - GROUND;
    return {
      scale,
      x: (x) => width / 2 + (x - robot.startX) * scale - shot.middle * shot.scale,
      y: (y) => floor - (y - robot.startY) * scale + up * shot.scale,
      mark: (bodyLengths) => width / 2 + (bodyLengths - shot.middle) * shot.scale,
    };
  }

  // --- drawing -------------------------------------------------------------------------------------------------

  function draw(context, robot, time, shot, size, colors, strain) {
    const { width, height } = size;
    const through = lens(robot, time, shot, width, height);
    context.fillStyle = colors.sky;
    context.fillRect(0, 0, width, height);
    drawMarks(context, robot, shot, through, size, colors);
    drawTrail(context, robot, time, through, colors);
    drawRobot(context, robot, positions(robot, time), through, colors, strain);
    drawPointer(context, robot, time, through, height, colors);
  }

  // 0.1, 0.2, 0.5, 1, 2, 5 ... body lengths, the least that is far enough apart.
  function markStep(scale) {
    const least = MARKS_APART / scale;
    const power = 10 ** Math.floor(Math.log10(least));
    return [1, 2, 5, 10].map((k) => k * power).find((step) => step >= least * (1 - 1e-9));
  }

  function drawMarks(context, robot, shot, through, { width, height }, colors) {
    const floor = height - GROUND;
    const flies = robot.floor === null;
    context.fillStyle = colors.ground;
    context.fillRect(0, floor, width, GROUND);
    const step = markStep(shot.scale), half = width / 2 / shot.scale;
    const first = Math.ceil((shot.middle - half) / step - 1), last = Math.floor((shot.middle + half) / step + 1);
    for (let k = first; k <= last; k++) context.fillRect(Math.round(through.mark(k * step)), 0, 1, floor);
    drawStart(context, through, floor, colors);
    context.fillStyle = colors.line;
    if (!flies) context.fillRect(0, floor, width, 1.5);
    for (let k = 5 * first; k <= 5 * last; k++) {
      context.fillRect(Math.round(through.mark((k * step) / 5)), floor, 1, k % 5 ? 3 : 7);
    }
    numberMarks(context, step, first, last, through, width, floor, colors);
  }

  function drawStart(context, through, floor, colors) {
    context.fillStyle = colors.trail;
    const x = Math.round(through.mark(0));
    for (let y = floor - 6; y > 0; y -= 8) context.fillRect(x, y, 1, 4);
  }

  // The unit stands at the right edge, numbers where there is room beside it.
  function numberMarks(context, step, first, last, through, width, floor, colors) {
    context.font = '11px system-ui, -apple-system, "Segoe UI", sans-serif';
    context.textBaseline = "middle";
    context.fillStyle = colors.text;
    const y = floor + 19, unit = "body lengths";
    const room = width - context.measureText(unit).width - 8;
    context.textAlign = "left";
    context.fillText(unit, room, y);
    context.textAlign = "center";
    for (let k = first; k <= last; k++) {
      const label = k === 0 ? "start" : signless(k * step, step < 1 ? 1 : 0);
      const x = through.mark(k * step), reach = context.measureText(label).width / 2;
      if (x + reach < room - 10 && x - reach > 2) context.fillText(label, x, y);
    }
  }

  function drawTrail(context, robot, time, through, colors) {
    const [last] = between(robot, time);
    const place = (f) => [
      through.x(robot.startX + robot.x[f] * robot.length), through.y(robot.startY + robot.y[f] * robot.length),
    ];
    context.beginPath();
    context.moveTo(...place(0));
    for (let f = 1; f <= last; f++) context.lineTo(...place(f));
    context.lineTo(
      through.x(robot.startX + at(robot, robot.x, time) * robot.length),
      through.y(robot.startY + at(robot, robot.y, time) * robot.length),
    );
    context.strokeStyle = colors.trail;
    context.globalAlpha = 0.45;
    context.lineWidth = 1;
    context.lineJoin = "round";
    context.stroke();
    context.globalAlpha = 1;
  }

  function drawRobot(context, robot, xy, through, colors, strain) {
    const px = (node) => [through.x(xy[2 * node]), through.y(xy[2 * node + 1])];
    const lines = (ends, from, to) => {
      context.beginPath();
      for (let i = from; i < to; i += 2) {
        context.moveTo(...px(ends[i]));
        context.lineTo(...px(ends[i + 1]));
      }
      context.stroke();
    };
    const thickness = Math.min(Math.max(9 * through.scale * (robot.length / 772), 1.4), 5);
    context.lineCap = context.lineJoin = "round";
    context.beginPath();
    for (let i = 0; i < robot.cells.length; i += 4) {
      context.moveTo(...px(robot.cells[i]));
      for (let k = 1; k < 4; k++) context.lineTo(...px(robot.cells[i + k]));
    }
    context.fillStyle = colors.skin;
    context.fill();
    context.strokeStyle = colors.spring;
    context.lineWidth = Math.max(0.5, 0.25 * thickness);
    lines(robot.springs, 0, robot.springs.length);
    context.lineWidth = thickness;
    for (let muscle = 0; muscle < robot.rest.length; muscle++) {
      context.strokeStyle = muscleColor(colors.muscle, strain, contraction(robot, xy, muscle));
      lines(robot.muscles, 2 * muscle, 2 * muscle + 2);
    }
    context.beginPath();
    for (let node = 0; node < robot.nodes; node++) {
      const [x, y] = px(node), radius = 0.36 * thickness;
      context.moveTo(x + radius, y);
      context.arc(x, y, radius, 0, 2 * Math.PI);
    }
    context.fillStyle = colors.node;
    context.fill();
  }

  // Where on the scale the robot is.
  function drawPointer(context, robot, time, through, height, colors) {
    const x = through.mark(at(robot, robot.x, time)), floor = height - GROUND;
    context.beginPath();
    context.moveTo(x, floor + 1);
    context.lineTo(x - 5, floor + 10);
    context.lineTo(x + 5, floor + 10);
    context.closePath();
    context.fillStyle = colors.text;
    context.fill();
  }

  // --- words ---------------------------------------------------------------------------------------------------

  const signless = (number, digits) => number.toFixed(digits).replace("-", "\u2212");
  const signed = (number, digits) => {
    const text = Math.abs(number).toFixed(digits);
    return (number < 0 && Number(text) !== 0 ? "\u2212" : "+") + text;
  };
  const seconds = (time) => `${time.toFixed(1)} s`;

  function standing(robots, time, i) {
    const robot = robots[i];
    if (time >= robot.end && robot.ending === "diverged") return `diverged at ${seconds(robot.end)}`;
    const reached = robots.map((it) => at(it, it.x, time));
    const others = reached.filter((_, k) => k !== i);
    const lead = reached[i] - Math.max(...others);
    return others.length && lead >= 0.005 ? `ahead by ${lead.toFixed(2)}` : "";
  }

  // --- the elements --------------------------------------------------------------------------------------------

  function make(tag, attributes = {}, ...children) {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    element.append(...children);
    return element;
  }

  function makeLane(robot) {
    const lane = {
      distance: make("output", { class: "wp-distance", "aria-live": "off" }),
      standing: make("span", { class: "wp-standing" }),
      canvas: make("canvas", { role: "img", "aria-label": `${robot.condition}, ${robot.run}: the robot from the side` }),
    };
    const head = make(
      "div", { class: "wp-head" },
      make("span", { class: "wp-name" }, robot.condition), make("span", { class: "wp-run" }, robot.run),
      lane.standing, lane.distance,
    );
    const notes = robot.notes.map((note) => make("p", { class: "wp-note" }, note));
    lane.element = make("div", { class: "wp-lane" }, head, lane.canvas, ...notes);
    lane.context = lane.canvas.getContext("2d");
    return lane;
  }

  function makeControls(duration) {
    const speed = make(
      "select", { "aria-label": "Speed" },
      ...SPEEDS.map((it) => make("option", { value: it, ...(it === 1 && { selected: "" }) }, `${it} ×`)),
    );
    const controls = {
      play: make("button", { type: "button", class: "wp-play" }, "Play"),
      time: make("output", { class: "wp-time", "aria-live": "off" }, seconds(0)),
      slider: make("input", { type: "range", min: 0, max: duration, step: "any", value: 0, "aria-label": "Time" }),
      speed,
      follow: make("input", { type: "checkbox", checked: "" }),
      reset: make("button", { type: "button", class: "wp-reset" }, "To start"),
    };
    controls.element = make(
      "div", { class: "wp-controls" },
      controls.play,
      make("span", { class: "wp-clock" }, controls.time, ` of ${seconds(duration)}`),
      controls.slider,
      make("label", {}, "Speed ", speed),
      make("label", {}, controls.follow, " Follow"),
      controls.reset,
    );
    return controls;
  }

  function makeLegend(robots, strain) {
    const percent = `${Math.round(100 * strain)} %`;
    const bar = make("span", { class: "wp-bar" });
    const legend = make(
      "div", { class: "wp-legend" },
      make("span", { class: "wp-title" }, "Muscles against rest:"),
      make("span", { class: "wp-scale" }, `${percent} longer`, bar, `${percent} shorter`),
    );
    legend.hidden = !robots.some((robot) => robot.rest.length);
    return { element: legend, bar };
  }

  // --- the player ----------------------------------------------------------------------------------------------

  return function mountPlayer(element, payload, { autoplay = false } = {}) {
    const data = JSON.parse(payload);
    if (data.format !== FORMAT) throw new Error(`a player of format ${FORMAT} cannot show format ${data.format}`);
    const duration = Math.max(...data.robots.map((robot) => robot.coordinates.end));
    const lanes = data.robots.map(makeLane);
    const controls = makeControls(duration);
    const legend = makeLegend(data.robots, data.strain);
    const message = make("p", { class: "wp-message", role: "alert", hidden: "" });
    element.classList.add("wobble-player");
    element.setAttribute("role", "group");
    element.setAttribute("aria-label", `Player: ${data.robots.map((it) => it.condition).join(" and ")}`);
    element.replaceChildren(message, ...lanes.map((lane) => lane.element), controls.element, legend.element);

    const dark = matchMedia("(prefers-color-scheme: dark)");
    let robots = null, time = 0, speed = 1, follow = true, playing = false, shownAt = 0, drawnWidth = 0;

    function show(wanted) {
      time = Math.min(Math.max(wanted, 0), duration);
      controls.time.textContent = seconds(time);
      controls.slider.value = time;
      controls.slider.setAttribute("aria-valuetext", `${seconds(time)} of ${seconds(duration)}`);
      if (robots) {
        lanes.forEach((lane, i) => {
          lane.distance.textContent = `${signed(at(robots[i], robots[i].x, time), 2)} body lengths`;
          lane.standing.textContent = standing(robots, time, i);
        });
        paint();
      }
    }

    function paint() {
      const width = lanes[0].element.clientWidth;
      if (!width) return;
      drawnWidth = width;
      const size = { width, height: laneHeight(robots, width) };
      const shot = camera(robots, time, follow, size.width, size.height);
      const colors = data.colors[dark.matches ? "dark" : "light"];
      lanes.forEach((lane, i) => {
        fit(lane, size);
        draw(lane.context, robots[i], time, shot, size, colors, data.strain);
      });
    }

    // As many pixels as the screen has for it.
    function fit({ canvas, context }, { width, height }) {
      const ratio = globalThis.devicePixelRatio || 1;
      const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
      if (canvas.width !== w || canvas.height !== h) {
        [canvas.width, canvas.height] = [w, h];
        canvas.style.height = `${height}px`;
      }
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
    }

    function paintLegend() {
      const { muscle } = data.colors[dark.matches ? "dark" : "light"];
      legend.bar.style.background = `linear-gradient(to right, ${muscle.join(", ")})`;
    }

    function tick(now) {
      if (!playing) return;
      const passed = Math.min(Math.max(now - shownAt, 0), LONGEST_FRAME) / 1000;
      shownAt = now;
      show(time + speed * passed);
      if (time >= duration) pause();
      else requestAnimationFrame(tick);
    }

    function setPlaying(now) {
      playing = now;
      controls.play.textContent = playing ? "Pause" : "Play";
    }

    async function play() {
      await unpack();
      if (playing || !robots) return;
      if (time >= duration) show(0);
      setPlaying(true);
      shownAt = performance.now();
      requestAnimationFrame(tick);
    }

    function pause() {
      setPlaying(false);
    }

    function reset() {
      pause();
      show(0);
    }

    let unpacking = null;
    function unpack() {
      unpacking ??= Promise.all(data.robots.map(unpacked)).then(
        (found) => {
          robots = found.map(surveyed);
          show(time);
        },
        (error) => refuse(`The recording cannot be unpacked: ${error.message}.`),
      );
      return unpacking;
    }

    function refuse(sentence) {
      message.textContent = sentence;
      message.hidden = false;
      for (const control of [controls.play, controls.slider, controls.speed, controls.follow, controls.reset]) {
        control.disabled = true;
      }
    }

    // --- what the reader does

    function onKey(event) {
      const { key, target } = event;
      if (event.ctrlKey || event.metaKey || event.altKey || target === controls.speed) return;
      const step = event.shiftKey ? LEAP : STEP;
      const moves = {
        ArrowLeft: -step, ArrowDown: -step, ArrowRight: step, ArrowUp: step, PageDown: -PAGE, PageUp: PAGE,
        Home: -Infinity, End: Infinity,
      };
      const sideways = ["ArrowLeft", "ArrowRight"].includes(key);
      if (key === " " && (target === controls.slider || !element.contains(target))) {
        if (playing) pause();
        else play();
      } else if (key in moves && (target === controls.slider || sideways)) {
        show(moves[key] === -Infinity ? 0 : time + moves[key]);
      } else {
        return;
      }
      event.preventDefault();
    }

    const toggle = () => (playing ? pause() : play());
    controls.play.addEventListener("click", toggle);
    lanes.forEach((lane) => lane.canvas.addEventListener("click", toggle));
    controls.reset.addEventListener("click", reset);
    controls.slider.addEventListener("input", () => show(controls.slider.valueAsNumber));
    controls.speed.addEventListener("change", () => { speed = Number(controls.speed.value); });
    controls.follow.addEventListener("change", () => {
      follow = controls.follow.checked;
      if (robots) paint();
    });
    element.addEventListener("keydown", onKey);
    // On a page with one player the keys are its own also before anything is clicked.
    document.addEventListener("keydown", (event) => {
      const alone = document.querySelectorAll(".wobble-player").length === 1;
      if (alone && event.target === document.body) onKey(event);
    });
    dark.addEventListener("change", () => {
      paintLegend();
      if (robots) paint();
    });
    new ResizeObserver(() => {
      if (robots && lanes[0].element.clientWidth !== drawnWidth) paint();
    }).observe(element);
    if (globalThis.DecompressionStream) {
      new IntersectionObserver(
        (entries, observer) => {
          if (entries.some((entry) => entry.isIntersecting)) {
            observer.disconnect();
            unpack();
          }
        },
        { rootMargin: "600px" },
      ).observe(element);
    } else {
      unpacking = Promise.resolve();
      refuse(
        "This browser cannot unpack the recording, because it has no DecompressionStream. " +
          "Chrome 80, Firefox 113, Safari 16.4 and later ones have it.",
      );
    }

    paintLegend();
    show(0);
    if (autoplay && !matchMedia("(prefers-reduced-motion: reduce)").matches) play();

    const player = {
      unpack, play, pause, reset, seek: show,
      get time() { return time; },
      get playing() { return playing; },
      duration,
      // What is drawn at a time, for those who want to check or extend it: places in u, and px of them in a lane.
      positions: (i, when) => Array.from(positions(robots[i], when)),
      color: (i, muscle, when) => {
        const { muscle: stops } = data.colors[dark.matches ? "dark" : "light"];
        return muscleColor(stops, data.strain, contraction(robots[i], positions(robots[i], when), muscle));
      },
      pixel: (i, x, y) => {
        const { clientWidth: width, clientHeight: height } = lanes[i].canvas;
        const through = lens(robots[i], time, camera(robots, time, follow, width, height), width, height);
        return [through.x(x), through.y(y)];
      },
    };
    element.player = player;
    return player;
  };
})();
