// The data of the page: what episodes.py packed.
const RESOLUTION = 0.01; // m, m/s; headings have ten times as many digits

async function unpack(text) {
  const bytes = Uint8Array.from(atob(text.trim()), (one) => one.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Data(await new Response(stream).json());
}

// Values of a series that is stored as its first value and the differences that follow.
function unfold(steps) {
  let sum = 0;
  return steps.map((one) => RESOLUTION * (sum += one));
}

class Episode {
  constructor(data, subject, number) {
    Object.assign(this, data, { owner: subject, number });
    this.safe = subject.scene.safe[this.phi];
    this.name = this.failure ?? (this.objective ? `kamikaze, ${this.objective}` : "along φ");
  }

  get isHit() { return this.outcome === "hit"; } // by the moving car

  get command() {
    const prefix = this.failure === undefined ? this.owner.repeat[this.objective] : this.owner.repeatFailure;
    return `${prefix} --safe-number ${this.phi} --trial ${this.trial}`;
  }

  // Series at ticks, the last value at the contact; null where they are not in the page.
  get course() {
    if (!this.path) return null;
    const [x, y, carX, carY, speed, heading] = this.path.map(unfold);
    const step = this.owner.scene.timeStep;
    const times = x.map((_, row) => row * step);
    if (this.touched) times[times.length - 1] = this.time;
    return { x, y, carX, carY, speed, heading: heading.map((one) => one / 10), belief: this.belief && this.belief.map(unfold), times, step };
  }
}

class Data {
  constructor(content) {
    this.subjects = content.subjects;
    this.charts = content.charts;
    this.episodes = content.episodes.map((one, number) => new Episode(one, this.subjects[one.subject], number));
    for (const one of this.subjects) one.failures = one.failures.map((failure, number) => new Episode(failure, one, number));
  }

  of(number) { return this.episodes.filter((one) => one.subject === number); }
}
