// One episode: from above, and distances over time.
const RATE = 0.5; // of real time
const HIGHEST = 460; // px of a picture, as in style.css
const DEVIATIONS = 2; // standard deviations of a belief that are shown to each side: about 95 %
const MOST = 10; // s, m/s²: longer times to collision and what no tyres have are drawn as this
const TYRES = 9.81; // m/s², where the table's required deceleration ends
const CHART = { width: 620, height: 240, left: 44, right: 10, top: 34, bottom: 34 };

class Player {
  constructor(data, step) {
    this.data = data;
    for (const id of ["view", "distances", "surrogates", "state", "time", "clock", "play", "playing", "place", "command", "copy", "previous", "next"]) this[id] = document.getElementById(id);
    this.time.addEventListener("input", () => { this.stop(); this.set(Number(this.time.value)); });
    this.play.addEventListener("click", () => (this.timer ? this.stop() : this.start()));
    this.previous.addEventListener("click", () => step(-1));
    this.next.addEventListener("click", () => step(1));
    this.copy.addEventListener("click", () => copyText(this.command.textContent, this.copy));
    document.getElementById("charts").addEventListener("toggle", () => { if (!this.course) return; this.drawCharts(); this.set(this.now); });
  }

  load(episode) {
    this.stop();
    this.episode = episode;
    this.course = episode.course;
    const several = this.data.subjects.length > 1 ? `${episode.owner.label}: ` : "";
    const worst = episode.number === 0 && episode.failure === undefined ? "The worst of these episodes: " : "";
    this.playing.textContent = `${worst}${several}${episode.safe.name}, ${episode.name}, ${episode.outcome}`;
    this.place.textContent = where(episode, this.course) + (worst && leastOfMargin(episode.owner));
    this.command.textContent = episode.command;
    const there = this.course !== null;
    const believes = there && this.course.belief !== null;
    for (const one of document.querySelectorAll(".of-belief")) one.hidden = !believes;
    for (const control of [this.time, this.play]) control.disabled = !there;
    if (there) this.drawScene();
    drawHits(this.data, episode);
    if (!there) {
      this.view.replaceChildren(html("p", { className: "note", textContent: "The trajectory of this episode is not in this file; episodes.npz of the result folder has it." }));
      for (const one of [this.distances, this.surrogates]) one.replaceChildren();
      [this.state.textContent, this.clock.textContent] = ["", ""];
      return;
    }
    this.time.max = this.course.times.at(-1);
    this.drawCharts();
    this.set(this.course.times.at(-1));
  }

  drawScene() {
    const { course, episode } = this;
    const { scene } = episode.owner, { points } = episode.safe;
    const cars = course.carX.map((x, i) => [x, course.carY[i]]);
    const area = bounds([...points, ...course.x.map((x, i) => [x, course.y[i]]), ...cars.flatMap(([x, y]) => [[x, y - scene.car.rear], [x, y + scene.car.front]])], 0.6);
    area[0] = Math.min(area[0], -3.5);
    area[2] = Math.max(area[2], 3.5) + 0.8; // room for the scale
    area[1] -= 1; // and for its numbers beside the car at the start
    const picture = (this.picture = new Picture(area, scene, "The episode seen from above"));
    picture.road();
    picture.line(course.carX, course.carY, "ghost");
    picture.line(points.map((p) => p[0]), points.map((p) => p[1]), "phi");
    for (const [x, y] of points) picture.disc(x, y, 0.09, "dot");
    picture.line(course.x, course.y, "psi bold");
    course.x.forEach((x, i) => picture.disc(x, course.y[i], 0.12, "tick-ring"));
    picture.car(course.carX[0], course.carY[0], course.heading[0], "ghost");
    picture.scale(12 * picture.units(this.view.clientWidth || CHART.width, HIGHEST));
    this.moving = picture.add(element("g"));
    this.view.replaceChildren(picture.svg);
  }

  drawCharts() {
    const end = this.course.times.at(-1) || 1;
    const fine = Array.from({ length: 121 }, (_, i) => (i * end) / 120);
    const states = fine.map((t) => this.at(t));
    const lines = (name, dash, colour, values) => ({ name, dash, colour, values });
    this.cursors = [];
    this.drawChart(this.distances, "Distances over time", "m", 0, fine, [
      lines("gap between car and adversary", "", "var(--car)", states.map((one) => one.gap)),
      lines("distance from where φ is then", "7 3", "var(--kamikaze)", states.map((one) => one.away)),
    ]);
    this.drawChart(this.surrogates, "Time to collision and required deceleration over time", `s, m/s²; at most ${MOST}`, MOST, fine, [
      lines("time to collision (s)", "", "var(--car)", states.map((one) => Math.min(one.collision, MOST))),
      lines("required deceleration (m/s²)", "7 3", "var(--kamikaze)", states.map((one) => Math.min(one.braking, MOST))),
    ]);
  }

  // Series over time; `most` 0: as much as they have.
  drawChart(place, label, unit, most, fine, series) {
    const { height, left, right, top, bottom } = CHART;
    const width = Math.max(300, place.clientWidth || CHART.width);
    const end = fine.at(-1);
    most = most || Math.max(1, ...series.flatMap((one) => one.values));
    const step = niceStep(most / 4);
    this.x = (t) => left + (t / end) * (width - left - right);
    const y = (d) => height - bottom - (d / most) * (height - top - bottom);
    const svg = element("svg", { class: "scene", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });
    for (let d = 0; d <= most; d += step) {
      svg.append(element("line", { x1: left, x2: width - right, y1: y(d), y2: y(d), class: "tick" }), element("text", { x: left - 6, y: y(d) + 4, "text-anchor": "end" }, fixed(d, step < 1 ? 1 : 0)));
    }
    const every = niceStep(end / 6);
    for (let t = 0; t <= end + 1e-9; t += every) {
      svg.append(element("text", { x: this.x(t), y: height - bottom + 15, "text-anchor": "middle" }, fixed(t, every < 1 ? 1 : 0)));
    }
    svg.append(element("text", { x: width - right, y: height - 4, "text-anchor": "end" }, "time (s)"), element("text", { x: 4, y: height - 4 }, unit));
    series.forEach((one, i) => {
      const points = fine.map((t, j) => `${this.x(t).toFixed(1)},${y(one.values[j]).toFixed(1)}`).join(" ");
      svg.append(element("polyline", { points, fill: "none", stroke: one.colour, "stroke-width": 2, "stroke-dasharray": one.dash }));
      const at = width < 560 ? left : left + i * 260;
      const row = width < 560 ? 9 + 15 * i : 9;
      svg.append(element("line", { x1: at, x2: at + 24, y1: row, y2: row, stroke: one.colour, "stroke-width": 2, "stroke-dasharray": one.dash }), element("text", { x: at + 30, y: row + 4 }, one.name));
    });
    this.cursors.push(element("line", { y1: top - 4, y2: height - bottom, stroke: "currentColor", "stroke-width": 1 }));
    svg.append(this.cursors.at(-1));
    place.replaceChildren(svg);
  }

  // All that is known at a time.
  at(time) {
    const { course: way } = this;
    const [x, y, carX, carY, speed, heading] = [way.x, way.y, way.carX, way.carY, way.speed, way.heading].map((values) => between(way.times, values, time));
    const there = phiAt(this.episode.safe, way.step, time);
    const { scene } = this.episode.owner;
    const belief = way.belief && way.belief.map((values) => between(way.times, values, time));
    const [ahead, left] = inCar(x, y, carX, carY, heading);
    const velocity = inCar(...[way.x, way.y].map((values) => rateOf(way.times, values, time)), 0, 0, heading);
    const rates = [velocity[0] - speed, velocity[1]]; // seen from the car
    const turned = pointing(way, time) - heading;
    const collision = timeToCollision(scene, ahead, left, rates, turned);
    const braking = requiredDeceleration(scene, ahead, rates, turned, collision);
    return { x, y, carX, carY, speed, heading, belief, there, collision, braking, gap: gap(scene, x, y, carX, carY, heading), away: Math.hypot(x - there[0], y - there[1]) };
  }

  set(time) {
    const now = this.at(time);
    const { picture } = this;
    const before = picture.svg;
    picture.svg = this.moving;
    this.moving.replaceChildren();
    picture.car(now.carX, now.carY, now.heading, "car");
    if (now.belief) this.drawBelief(picture, now);
    picture.others(time / picture.scene.timeStep, false);
    picture.user(...now.there, 0, "there");
    picture.user(now.x, now.y, pointing(this.course, time), "user");
    picture.svg = before;
    for (const cursor of this.cursors) for (const end of ["x1", "x2"]) cursor.setAttribute(end, this.x(time));
    this.time.value = time;
    this.now = time;
    this.clock.textContent = `${fixed(time, 2)} of ${fixed(this.course.times.at(-1), 2)} s`;
    this.state.textContent = `car ${fixed(now.speed, 1)} m/s · gap ${fixed(now.gap, 2)} m · ${fixed(now.away, 2)} m from where φ is then\n${this.episode.touched && time >= this.course.times.at(-1) ? "in contact" : soon(now)}${believed(now.belief)}`;
  }

  // Where the kamikaze believes the car's front to be: a band along the lane, and its middle.
  drawBelief(picture, { carX, carY, heading, belief: [ahead, deviation] }) {
    const { front, half } = this.episode.owner.scene.car;
    const [low, high] = [front + ahead - DEVIATIONS * deviation, front + ahead + DEVIATIONS * deviation];
    picture.polygon(box(carX, carY, heading, high, -low, half + 0.15), "belief");
    const middle = box(carX, carY, heading, front + ahead, -front - ahead, half + 0.15);
    picture.line([middle[0][0], middle[3][0]], [middle[0][1], middle[3][1]], "believed");
  }

  start() {
    if (!this.course) return;
    const end = this.course.times.at(-1);
    const from = this.now >= end ? 0 : this.now;
    const begin = performance.now();
    this.play.textContent = "❚❚ pause";
    const frame = (clock) => {
      const time = Math.min(end, from + (RATE * Math.max(0, clock - begin)) / 1000);
      this.set(time);
      if (time >= end) this.stop();
      else this.timer = requestAnimationFrame(frame);
    };
    this.timer = requestAnimationFrame(frame);
  }

  stop() {
    if (this.timer) cancelAnimationFrame(this.timer);
    this.timer = 0;
    this.play.textContent = "▶ play";
  }
}

// Where and when the car hits, in words.
function where(episode, course) {
  if (!episode.touched) return "";
  const verb = episode.isHit ? "Hit" : "Touched";
  const figures = `${fixed(episode.speed, 1)} m/s, ${fixed(episode.time, 2)} s after the start, ${episode.deviation < 0.005 ? "on φ itself" : `${fixed(episode.deviation, 2)} m from φ`}`;
  if (!course) return `${verb} at ${figures}.`;
  const [x, y, carX, carY, heading] = [course.x, course.y, course.carX, course.carY, course.heading].map((one) => one.at(-1));
  const { front, rear, half } = episode.owner.scene.car;
  const [ahead, left] = inCar(x, y, carX, carY, heading);
  const beyond = { front: ahead - front, rear: -rear - ahead, "left side": left - half, "right side": -half - left };
  const corner = ahead > front - 0.01 && Math.abs(left) > half; // which counts as the front
  const side = corner ? "front corner" : Object.keys(beyond).reduce((best, one) => (beyond[one] > beyond[best] ? one : best));
  return `${verb} by the car's ${side} at ${figures}, at x\u00a0=\u00a0${fixed(x, 1)}\u00a0m, y\u00a0=\u00a0${fixed(y, 1)}\u00a0m.`;
}

// The headline is a mean over the margin's trials: the least of them.
function leastOfMargin({ least, scene }) {
  const [one] = least.flatMap((of, phi) => of.map(({ deviation }) => ({ deviation, phi }))).sort((a, b) => a.deviation - b.deviation);
  return one ? ` The least deviation of the margin is ${fixed(one.deviation, 2)} m, on ${scene.safe[one.phi].name} (map under Each φ).` : "";
}

function soon({ collision, braking }) {
  if (collision === Infinity) return "they would pass each other if both went on so";
  return `time to collision ${fixed(collision, 1)} s · required deceleration ${braking > TYRES ? `above ${TYRES}` : fixed(braking, 1)} m/s²`;
}

function believed(belief) {
  if (!belief) return "";
  const [ahead, deviation, speed, spread] = belief;
  const side = ahead < 0 ? "behind" : "ahead of";
  return `\nthe kamikaze believes the car ${fixed(Math.abs(ahead), 2)} m ${side} its place (± ${fixed(DEVIATIONS * deviation, 2)} m), at ${fixed(speed, 1)} m/s (± ${fixed(DEVIATIONS * spread, 1)} m/s)`;
}

function niceStep(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].find((one) => one * power >= value) * power;
}

function fixed(value, digits) { return value === null || Number.isNaN(value) ? "–" : value.toFixed(digits).replace("-", "−"); }

async function copyText(text, button) {
  const done = (word) => { button.textContent = word; setTimeout(() => (button.textContent = "copy"), 1500); };
  try {
    await navigator.clipboard.writeText(text);
    done("copied");
  } catch { // a file opened from disk may have no clipboard
    const field = html("textarea", { value: text });
    document.body.append(field);
    field.select();
    done(document.execCommand("copy") ? "copied" : "select it");
    field.remove();
  }
}
