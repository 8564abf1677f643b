// One car in detail: distances per φ, map, and where on the car they touch.
const SHOWN = 60; // ψ of a panel
const STANDING = 0.1; // m/s below which a car stands
const MARGIN = "margin"; // in the choice of ways; no objective is called so
const NEAR = 1; // m of the car's approach that a map shows beyond the trajectories

class Detail {
  constructor(episodes) {
    this.episodes = episodes;
    this.choice = document.getElementById("map-objective");
    this.choice.addEventListener("change", () => this.drawMaps());
    this.of = episodes.subjects.map(() => []);
    for (let k = 0; k < episodes.count; k++) this.of[episodes.columns.subject[k]].push(k);
  }

  async show(number) {
    this.number = number;
    this.subject = this.episodes.subjects[number];
    for (const one of document.querySelectorAll(".of-subject")) one.hidden = Number(one.dataset.subject) !== number;
    const names = Object.keys(this.subject.repeat).filter((name) => name);
    const choices = names.map((name) => [name, `kamikazes of objective ${name}`]);
    if (this.subject.ways.some((ways) => ways.length)) choices.unshift([MARGIN, "margin trajectories"]);
    this.choice.replaceChildren(...choices.map(([value, textContent]) => html("option", { value, textContent })));
    this.choice.value = choices[0][0] === MARGIN ? MARGIN : this.episodes.objectives[this.subject.ranking];
    this.drawMaps();
    await this.drawDistances();
  }

  mine(objective, index) {
    const { columns } = this.episodes;
    const wanted = this.episodes.objectives.indexOf(objective);
    return this.of[this.number].filter((k) => columns.objective[k] === wanted && (index === null || columns.safe_index[k] === index));
  }

  async drawDistances() {
    const { columns, objectives, charts } = this.episodes;
    const [pairs, means] = [[], []];
    this.subject.scene.safe.forEach((phi, index) => {
      const margins = this.subject.margins[index];
      for (const value of margins) pairs.push({ name: phi.name, what: "margin", value });
      if (margins.length) means.push({ name: phi.name, what: "margin", value: this.subject.perSafe[index].margin, count: margins.length });
      const kinds = [
        ["planned deviation", columns.deviation, objectives[this.subject.ranking], "deviation", (k) => this.episodes.isHit(k)],
        ["Fréchet distance", columns.frechet, objectives[this.subject.skd], "skd", (k) => this.episodes.touched(k)],
      ];
      for (const [what, values, objective, key, counts] of kinds) {
        const hits = this.mine(objective, index).filter(counts);
        for (const k of hits) pairs.push({ name: phi.name, what, value: values[k] });
        const value = this.subject.perSafe[index][key];
        if (value !== null) means.push({ name: phi.name, what, value, count: hits.length });
      }
    });
    const spec = structuredClone(charts.perSafe);
    spec.height = 54 * this.subject.scene.safe.length; // three rows a φ
    spec.layer[0].data.values = pairs;
    spec.layer[1].data.values = means;
    await draw(document.getElementById("per-safe-chart"), spec);
  }

  drawMaps() {
    const objective = this.choice.value;
    const { safe } = this.subject.scene;
    const drawn = safe.map((phi, index) => {
      if (objective === MARGIN) {
        const ways = this.subject.ways[index].map((way) => ({ x: way.points.map((p) => p[0]), y: way.points.map((p) => p[1]) }));
        return { phi, all: this.subject.margins[index], ways, noun: "ways", margin: true };
      }
      const hits = this.mine(objective, index).filter((k) => this.episodes.touched(k) && this.episodes.columns.rows[k]);
      const every = Math.max(1, Math.ceil(hits.length / SHOWN));
      return { phi, all: hits, noun: "ψ", margin: false, ways: hits.filter((_, place) => place % every === 0).map((k) => this.episodes.way(k)) };
    });
    const points = drawn.flatMap(({ phi, ways }) => [...phi.points, ...ways.flatMap((way) => way.x.map((x, i) => [x, way.y[i]]))]);
    for (const { ways, margin } of drawn) {
      if (margin) continue; // where the car was is not in the file
      for (const way of ways) points.push([way.carX.at(-1), way.carY.at(-1)]);
      const way = middle(ways);
      if (way) points.push(...way.carX.map((x, i) => [x, way.carY[i]]).slice(-4));
    }
    const box = bounds(points, NEAR);
    const half = this.subject.scene.car.half + 0.6;
    [box[0], box[2]] = [Math.min(box[0], -half), Math.max(box[2], half)];
    document.getElementById("maps").replaceChildren(...drawn.map((one) => this.panel(one, box)));
    const planned = objective === MARGIN ? this.episodes.objectives[this.subject.ranking] : objective;
    for (const one of document.querySelectorAll(".of-margin")) one.hidden = objective !== MARGIN;
    for (const one of document.querySelectorAll(".of-planned")) one.hidden = objective === MARGIN;
    this.drawContacts(planned, this.mine(planned, null).filter((k) => this.episodes.touched(k) && this.episodes.columns.rows[k]));
  }

  panel({ phi, all, ways, noun, margin }, box) {
    const picture = new Picture(box, this.subject.scene, `Map of ${phi.name}: safe trajectory and ${ways.length} ${margin ? "margin trajectories" : "kamikaze trajectories"}`);
    picture.road();
    const way = margin ? null : middle(ways);
    if (way) {
      for (let i = 0; i < way.x.length - 1; i++) picture.car(way.carX[i], way.carY[i], way.heading[i], "ghost");
      picture.car(way.carX.at(-1), way.carY.at(-1), way.heading.at(-1), "car");
    }
    for (const one of ways) {
      picture.line(one.x, one.y, margin ? "psi least" : "psi");
      const [x, y] = [one.x.at(-1), one.y.at(-1)];
      picture.line([x - 0.1, x + 0.1], [y - 0.1, y + 0.1], margin ? "cross least" : "cross");
      picture.line([x - 0.1, x + 0.1], [y + 0.1, y - 0.1], margin ? "cross least" : "cross");
    }
    picture.line(phi.points.map((p) => p[0]), phi.points.map((p) => p[1]), "phi");
    for (const [x, y] of phi.points) picture.disc(x, y, 0.09, "dot");
    picture.scale(2);
    const beyond = margin ? all.filter((one) => one >= this.subject.etaMax).length : 0;
    const found = all.length - beyond;
    const few = ways.length < found ? `, the ${margin ? "least " : ""}${ways.length} drawn` : "";
    const none = beyond ? `, none in ${beyond} of ${all.length} trials` : "";
    const text = all.length ? `${found} ${noun}${few}${none}` : "no kamikaze";
    return html("figure", {}, picture.svg, html("figcaption", { textContent: `${phi.name}: ${text}` }));
  }

  drawContacts(objective, hits) {
    const { car, user } = this.subject.scene;
    const air = (user.radius || user.halfLength) + 0.5;
    const picture = new Picture([-car.half - air - 0.8, -car.rear - air, car.half + air + 0.8, car.front + air], this.subject.scene, "Where on the car the adversaries touch it");
    picture.car(0, 0, Math.PI / 2, "car");
    picture.line([-car.half, car.half], [car.front, car.front], "bumper");
    const counts = { front: 0, left: 0, right: 0, rear: 0 };
    let standing = 0;
    for (const k of hits) {
      const way = this.episodes.way(k);
      const [ahead, left] = inCar(way.x.at(-1), way.y.at(-1), way.carX.at(-1), way.carY.at(-1), way.heading.at(-1));
      const still = this.episodes.columns.impact_speed[k] < STANDING;
      const touched = [Math.min(Math.max(ahead, -car.rear), car.front), Math.min(Math.max(left, -car.half), car.half)];
      picture.disc(-touched[1], touched[0], 0.07, still ? "touch standing" : "touch");
      standing += still;
      const beyond = { front: ahead - car.front, rear: -car.rear - ahead, left: left - car.half, right: -car.half - left };
      counts[Object.keys(beyond).reduce((best, side) => (beyond[side] > beyond[best] ? side : best))]++;
    }
    const [u, v] = picture.at(0, car.front + 0.35 * air);
    picture.add(element("text", { x: u, y: v, "text-anchor": "middle" }, "front"));
    document.getElementById("contact").replaceChildren(picture.svg);
    const parts = Object.entries(counts).map(([side, count]) => `${side} ${count}`).join(", ");
    const hollow = standing ? ` Hollow: ${standing} walked into a standing car.` : "";
    document.getElementById("contact-caption").textContent = hits.length
      ? `${hits.length} contacts of ${this.subject.label}, kamikazes of objective ${objective}: ${parts}.${hollow}`
      : "No kamikaze of this objective touched the car.";
  }
}

// The way whose contact is the median in time.
function middle(ways) {
  const ordered = ways.slice().sort((one, other) => one.times.at(-1) - other.times.at(-1));
  return ordered[Math.floor(ordered.length / 2)];
}
