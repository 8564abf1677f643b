// Maps: where a car hits, and each φ with the trajectories around it.
const SHOWN = 60; // ψ of a panel
const MARGIN = "margin"; // in the choice of trajectories; no objective is called so
const AIR = 1; // m around what is drawn

function crossAt(picture, x, y, name) {
  for (const side of [-0.1, 0.1]) picture.line([x - 0.1, x + 0.1], [y - side, y + side], name);
}

// Where the hits of a car are: of margin trajectories, and of all episodes; the chosen one stands out.
function drawHits(data, episode) {
  const { scene, least } = episode.owner;
  const mine = data.of(episode.subject).filter((one) => one.isHit && one.path);
  const ends = least.flat().map((one) => one.points.at(-1));
  const places = mine.map((one) => { const { x, y } = one.course; return [x.at(-1), y.at(-1)]; });
  const box = bounds([...scene.safe.flatMap((phi) => phi.points), ...ends, ...places], AIR);
  box[1] = Math.min(box[1], box[3] - 1.2 * (box[2] - box[0])); // as wide as its place
  const picture = new Picture(box, scene, "Map of where the car hits");
  picture.road();
  for (const phi of scene.safe) picture.line(phi.points.map((p) => p[0]), phi.points.map((p) => p[1]), "phi thin");
  for (const [x, y] of ends) picture.disc(x, y, 0.09, "end least");
  for (const [x, y] of places) picture.disc(x, y, 0.09, "end");
  if (episode.path && episode.touched) {
    const { x, y } = episode.course;
    picture.disc(x.at(-1), y.at(-1), 0.3, "ring");
  }
  picture.scale(12 * picture.units(document.getElementById("hits").clientWidth || 380, 330));
  document.getElementById("hits").replaceChildren(picture.svg);
  const times = mine.map((one) => one.time).sort((a, b) => a - b);
  document.getElementById("hits-caption").textContent = times.length
    ? `${times.length.toLocaleString("en")} hits of planned kamikazes and runs along φ, ${fixed(times[0], 1)} to ${fixed(times.at(-1), 1)} s after the start, half of them by ${fixed(times[Math.floor(times.length / 2)], 1)} s. The ring is the episode in the player.`
    : "No episode of this car ended in a hit.";
  for (const one of document.querySelectorAll(".of-least")) one.hidden = !ends.length;
  for (const one of document.querySelectorAll(".of-hits")) one.hidden = !places.length;
}

// A panel for each φ of one car.
class Maps {
  constructor(data) {
    this.data = data;
    this.choice = document.getElementById("map-objective");
    this.choice.addEventListener("change", () => this.draw());
  }

  show(number) {
    this.number = number;
    this.subject = this.data.subjects[number];
    for (const one of document.querySelectorAll(".of-subject")) one.hidden = Number(one.dataset.subject) !== number;
    const choices = Object.keys(this.subject.repeat).filter((name) => name).map((name) => [name, `kamikazes of objective ${name}`]);
    if (this.subject.least.some((one) => one.length)) choices.unshift([MARGIN, "margin trajectories"]);
    this.choice.replaceChildren(...choices.map(([value, textContent]) => html("option", { value, textContent })));
    this.choice.value = choices[0][0] === MARGIN ? MARGIN : this.subject.ranking;
    this.draw();
  }

  draw() {
    const objective = this.choice.value, { safe } = this.subject.scene, margin = objective === MARGIN;
    const mine = this.data.of(this.number).filter((one) => one.objective === objective && one.touched && one.path);
    const drawn = safe.map((phi, index) => {
      if (margin) {
        const courses = this.subject.least[index].map((one) => ({ x: one.points.map((p) => p[0]), y: one.points.map((p) => p[1]) }));
        return { phi, all: this.subject.margins[index], courses };
      }
      const hits = mine.filter((one) => one.phi === index);
      const every = Math.max(1, Math.ceil(hits.length / SHOWN));
      return { phi, all: hits, courses: hits.filter((_, place) => place % every === 0).map((one) => one.course) };
    });
    const box = bounds(drawn.flatMap(({ phi, courses }) => [...phi.points, ...courses.flatMap((one) => one.x.map((x, i) => [x, one.y[i]]))]), AIR);
    document.getElementById("maps").replaceChildren(...drawn.map((one) => this.panel(one, box, margin)));
    for (const one of document.querySelectorAll(".of-margin")) one.hidden = !margin;
    for (const one of document.querySelectorAll(".of-planned")) one.hidden = margin;
  }

  panel({ phi, all, courses }, box, margin) {
    const picture = new Picture(box, this.subject.scene, `Map of ${phi.name}: safe trajectory and ${courses.length} ${margin ? "margin" : "kamikaze"} trajectories`);
    picture.road();
    for (const { x, y } of courses) {
      picture.line(x, y, margin ? "psi least" : "psi");
      crossAt(picture, x.at(-1), y.at(-1), margin ? "cross least" : "cross");
    }
    picture.line(phi.points.map((p) => p[0]), phi.points.map((p) => p[1]), "phi");
    for (const [x, y] of phi.points) picture.disc(x, y, 0.09, "dot");
    picture.scale(0.075 * SCALE * picture.wide);
    const beyond = margin ? all.filter((one) => one >= this.subject.etaMax).length : 0;
    const found = all.length - beyond;
    const few = courses.length < found ? `, the ${margin ? "least " : ""}${courses.length} drawn` : "";
    const none = beyond ? `, none in ${beyond} of ${all.length} trials` : "";
    const text = all.length ? `${found} trajector${found === 1 ? "y" : "ies"}${few}${none}` : "no kamikaze";
    return html("figure", {}, picture.svg, html("figcaption", { textContent: `${phi.name}: ${text}` }));
  }
}
