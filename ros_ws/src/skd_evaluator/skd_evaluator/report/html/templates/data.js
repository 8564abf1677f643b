// The data of the page: what packing.py packed.
const TYPES = { float32: Float32Array, int32: Int32Array, int16: Int16Array, uint16: Uint16Array, uint8: Uint8Array };
const RESOLUTION = 0.01; // m, m/s; headings have ten times as many digits
const WAY = 6; // columns of a way
const BELIEF = 4; // of what was believed of the car: how far ahead of its place, how surely, how fast, how surely

async function unpack(text) {
  const bytes = Uint8Array.from(atob(text.trim()), (one) => one.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(stream).arrayBuffer();
  const length = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const columns = {};
  let offset = 4 + length;
  for (const one of head.columns) {
    offset += (4 - (offset % 4)) % 4;
    columns[one.name] = new TYPES[one.type](buffer, offset, one.length);
    offset += one.length * TYPES[one.type].BYTES_PER_ELEMENT;
  }
  return new Episodes(head, columns);
}

class Episodes {
  constructor(head, columns) {
    Object.assign(this, head, { columns, count: head.listed, total: columns.rows.length });
    this.begin = new Uint32Array(this.total + 1);
    this.believedFrom = new Uint32Array(this.total + 1);
    for (let k = 0; k < this.total; k++) {
      this.begin[k + 1] = this.begin[k] + WAY * columns.rows[k];
      this.believedFrom[k + 1] = this.believedFrom[k] + BELIEF * columns.rows[k] * columns.believed[k];
    }
  }

  subject(k) { return this.subjects[this.columns.subject[k]]; }
  touched(k) { return this.columns.outcome[k] === this.collision; } // at whatever speed
  isHit(k) { return this.columns.hit[k] > 0; } // by the moving car
  phi(k) { return this.subject(k).scene.safe[this.columns.safe_index[k]]; }
  outcome(k) { return this.isHit(k) ? this.hitText : this.outcomes[this.columns.outcome[k]]; }
  plans(k) { return this.columns.objective[k] > 0; } // 0: along φ, where nobody decides
  // The failures of the risk stand behind the episodes of the table, subject by subject.
  isFailure(k) { return k >= this.count; }
  failure(subject, place) { return this.count + this.subjects.slice(0, subject).reduce((sum, one) => sum + one.failures.length, 0) + place; }
  adversary(k) {
    if (this.isFailure(k)) return this.subject(k).failures[k - this.failure(this.columns.subject[k], 0)];
   const name = this.objectives[this.columns.objective[k]];
    return name ? `kamikaze, ${name}` : "along φ";
  }

  command(k) {
    const { repeat, repeatFailure } = this.subject(k);
    const prefix = this.isFailure(k) ? repeatFailure : repeat[this.objectives[this.columns.objective[k]]];
    return `${prefix} --safe-number ${this.columns.safe_index[k]} --trial ${this.columns.trial[k]}`;
  }

  // Positions at ticks, the last at the contact; null where they are not in the page.
  way(k) {
    const rows = this.columns.rows[k];
    if (!rows) return null;
    const unfold = (values, begin, count) => Array.from({ length: count }, (_, column) => {
      let sum = 0;
      return Array.from(values.subarray(begin + column * rows, begin + (column + 1) * rows), (one) => RESOLUTION * (sum += one));
    });
    const series = unfold(this.columns.ways, this.begin[k], WAY);
    const step = this.subject(k).scene.timeStep;
    const times = Array.from({ length: rows }, (_, row) => row * step);
    if (this.touched(k)) times[rows - 1] = this.columns.impact_time[k];
    const [x, y, carX, carY, speed, heading] = series;
    const belief = this.columns.believed[k] ? unfold(this.columns.beliefs, this.believedFrom[k], BELIEF) : null;
    return { x, y, carX, carY, speed, heading: heading.map((one) => one / 10), belief, times, step };
  }
}
