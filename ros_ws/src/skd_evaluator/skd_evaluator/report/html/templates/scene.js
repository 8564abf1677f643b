// Seen from above: roads, cars, people, as SVG. World frame in metres, North to the right: a long lane fits a page.
const SVG = "http://www.w3.org/2000/svg";
const SCALE = 30; // units of the picture a metre

function element(tag, attributes = {}, ...children) {
  const found = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) found.setAttribute(name, value);
  found.append(...children);
  return found;
}

function html(tag, properties = {}, ...children) {
  const found = Object.assign(document.createElement(tag), properties);
  found.append(...children);
  return found;
}

class Picture {
  // `box`: [x0, y0, x1, y1], m. East is down.
  constructor(box, scene, label) {
    [this.x0, this.y0, this.x1, this.y1] = box;
    const [width, height] = [this.y1 - this.y0, this.x1 - this.x0];
    const size = `0 0 ${(SCALE * width).toFixed(1)} ${(SCALE * height).toFixed(1)}`;
    this.svg = element("svg", { class: "scene", viewBox: size, role: "img", "aria-label": label });
    this.wide = width;
    this.high = height;
    this.scene = scene;
  }

  at(x, y) { return [SCALE * (y - this.y0), SCALE * (x - this.x0)]; }
  points(xs, ys) { return Array.from(xs, (x, i) => this.at(x, ys[i]).map((one) => one.toFixed(1)).join(",")).join(" "); }
  add(...children) { this.svg.append(...children); return children[0]; }

  line(xs, ys, name) { return this.add(element("polyline", { points: this.points(xs, ys), class: name, "vector-effect": "non-scaling-stroke", fill: "none" })); }
  disc(x, y, radius, name) { const [cx, cy] = this.at(x, y); return this.add(element("circle", { cx, cy, r: SCALE * radius, class: name, "vector-effect": "non-scaling-stroke" })); }
  polygon(corners, name) { return this.add(element("polygon", { points: this.points(corners.map((c) => c[0]), corners.map((c) => c[1])), class: name, "vector-effect": "non-scaling-stroke" })); }

  road() {
    for (const [left, right] of this.scene.lanes) this.polygon([...left, ...right.slice().reverse()], "road").setAttribute("stroke", "none");
    for (const arrow of this.scene.arrows) this.polygon(arrow, "arrow");
    for (const corners of this.scene.obstacles) this.polygon(corners, "obstacle");
    this.others(0, true);
    for (const edge of this.scene.lanes.flat()) this.line(edge.map((c) => c[0]), edge.map((c) => c[1]), "edge");
  }

  // Units of the picture in a pixel, where there are so many pixels for it.
  units(width, height) { return SCALE * Math.max(this.wide / width, this.high / height); }

  // A scale along the left and the lower edge, with numbers of a size in units of the picture.
  scale(size) {
    const step = niceStep(Math.min(this.x1 - this.x0, this.y1 - this.y0) / 5);
    const bottom = SCALE * this.high, right = SCALE * this.wide;
    this.add(this.text(0.8 * size, 1.3 * size, "x, East ↓", size));
    this.add(this.text(right - 0.5 * size, 1.3 * size, "y, North →", size)).setAttribute("text-anchor", "end");
    for (const value of steps(this.x0, this.x1, step)) {
      const v = this.at(value, 0)[1];
      if (v > bottom - 2.5 * size || v < 2.4 * size) continue;
      this.add(element("line", { x1: 0, x2: 0.6 * size, y1: v, y2: v, class: "tick" }), this.text(0.8 * size, v + 0.35 * size, value, size));
    }
    for (const value of steps(this.y0, this.y1, step)) {
      const u = this.at(0, value)[0];
      if (u < 3 * size || u > right - 2 * size) continue;
      this.add(element("line", { x1: u, x2: u, y1: bottom - 0.6 * size, y2: bottom, class: "tick" }), this.text(u + 0.3 * size, bottom - 0.3 * size, value, size));
    }
  }

  text(x, y, value, size) { return element("text", { x, y, style: `font-size:${size.toFixed(1)}px` }, `${value}`.replace("-", "−")); }

  car(x, y, heading, name) { return this.polygon(carCorners(this.scene.car, x, y, heading), name); }

  // The others of the scenario, so many ticks after its start: those that stand, or those that move.
  others(ticks, standing) {
    for (const other of this.scene.others) {
      if ((other.points.length === 1) !== standing) continue;
      const last = other.points.length - 1, tick = Math.min(Math.floor(ticks), last), next = Math.min(tick + 1, last);
      const share = Math.min(ticks - tick, 1);
      const [x, y] = [0, 1].map((axis) => other.points[tick][axis] + share * (other.points[next][axis] - other.points[tick][axis]));
      this.body(other, x, y, other.headings[next], "obstacle");
    }
  }

  user(x, y, heading, name) { return this.body(this.scene.user, x, y, heading, name); }

  body({ radius, halfLength, halfWidth }, x, y, heading, name) {
    if (radius > 0) return this.disc(x, y, radius, name);
    return this.polygon(box(x, y, heading, halfLength, halfLength, halfWidth), name);
  }
}

function box(x, y, heading, front, rear, half) {
  const [c, s] = [Math.cos(heading), Math.sin(heading)];
  return [[front, half], [-rear, half], [-rear, -half], [front, -half]].map(([a, l]) => [x + a * c - l * s, y + a * s + l * c]);
}

function carCorners(car, x, y, heading) { return box(x, y, heading, car.front, car.rear, car.half); }

// Position of a point in the car's frame: [ahead, left], m.
function inCar(x, y, carX, carY, heading) {
  const [c, s, dx, dy] = [Math.cos(heading), Math.sin(heading), x - carX, y - carY];
  return [c * dx + s * dy, c * dy - s * dx];
}

// Gap between the car's outline and the adversary's centre less its radius, m; a box counts as the disc in it.
function gap(scene, x, y, carX, carY, heading) {
  const [ahead, left] = inCar(x, y, carX, carY, heading);
  const { front, rear, half } = scene.car;
  const outside = Math.hypot(Math.max(0, ahead - front, -rear - ahead), Math.max(0, Math.abs(left) - half));
  return Math.max(0, outside - (scene.user.radius || scene.user.halfWidth));
}

// Time to collision of the adversary at (ahead, left) of the car if both kept their velocities, s; infinite without one.
const HORIZON = 20; // s
function timeToCollision(scene, ahead, left, [va, vl], turned) {
  const { front, rear, half } = scene.car;
  const { radius, halfLength, halfWidth } = scene.user;
  const enters = (slabs) => {
    let [enter, leave] = [0, HORIZON];
    for (const [start, rate, low, high] of slabs) {
      if (!rate && (start < low || start > high)) return Infinity;
      const [first, last] = rate ? [(low - start) / rate, (high - start) / rate].sort((a, b) => a - b) : [0, HORIZON];
      [enter, leave] = [Math.max(enter, first), Math.min(leave, last)];
    }
    return enter <= leave ? enter : Infinity;
  };
  if (!radius) {
    const [c, s, long, middle] = [Math.cos(turned), Math.sin(turned), (front + rear) / 2, ahead - (front - rear) / 2];
    const slab = (start, rate, reach) => [start, rate, -reach, reach];
    const [ac, as] = [Math.abs(c), Math.abs(s)];
    return enters([slab(middle, va, long + ac * halfLength + as * halfWidth), slab(left, vl, half + as * halfLength + ac * halfWidth), slab(c * middle + s * left, c * va + s * vl, ac * long + as * half + halfLength), slab(c * left - s * middle, c * vl - s * va, as * long + ac * half + halfWidth)]);
  }
  const found = [[radius, 0], [0, radius]].map(([a, l]) => enters([[ahead, va, -rear - a, front + a], [left, vl, -half - l, half + l]]));
  for (const [a, l] of [[front, half], [front, -half], [-rear, half], [-rear, -half]]) {
    const [pa, pl] = [ahead - a, left - l];
    const [b, c, w] = [pa * va + pl * vl, pa * pa + pl * pl - radius * radius, va * va + vl * vl];
    const root = b < 0 && b * b >= w * c ? (-b - Math.sqrt(b * b - w * c)) / w : Infinity;
    found.push(c <= 0 ? 0 : root <= HORIZON ? root : Infinity);
  }
  return Math.min(...found);
}

// Deceleration after which the gap ahead of the car's front no longer closes when it is used up, m/s²; 0 where they pass.
function requiredDeceleration(scene, ahead, [va], turned, time) {
  const { radius, halfLength, halfWidth } = scene.user;
  const reach = radius || Math.abs(Math.cos(turned)) * halfLength + Math.abs(Math.sin(turned)) * halfWidth;
  const left = ahead - reach - scene.car.front;
  return time < Infinity && va < 0 && left >= -0.02 ? (va * va) / (2 * Math.max(0, left)) : 0;
}

// Where things are at a time: values at ticks, straight lines between.
function between(times, values, time) {
  let k = 0;
  while (k < times.length - 2 && times[k + 1] < time) k++;
  if (times.length < 2) return values[0];
  const share = Math.min(1, Math.max(0, (time - times[k]) / (times[k + 1] - times[k] || 1)));
  return values[k] + share * (values[k + 1] - values[k]);
}

// Change a second at a time, of values that change evenly from one to the next.
function rateOf(times, values, time) {
  let k = 0;
  while (k < times.length - 2 && times[k + 1] <= time) k++;
  return times.length < 2 ? 0 : (values[k + 1] - values[k]) / (times[k + 1] - times[k] || 1);
}

// φ at a time, held at its end.
function phiAt(phi, step, time) {
  const place = Math.min(time / step, phi.points.length - 1);
  const [low, high] = [Math.floor(place), Math.min(Math.floor(place) + 1, phi.points.length - 1)];
  return [0, 1].map((axis) => phi.points[low][axis] + (place - low) * (phi.points[high][axis] - phi.points[low][axis]));
}

// Where a box points after its way up to a time: along its last step.
function pointing(way, time) {
  let heading = 0;
  for (let k = 1; k < way.x.length && way.times[k - 1] < time; k++) {
    const [dx, dy] = [way.x[k] - way.x[k - 1], way.y[k] - way.y[k - 1]];
    if (dx || dy) heading = Math.atan2(dy, dx);
  }
  return heading;
}

function steps(low, high, step) {
  const found = [];
  for (let value = Math.ceil(low / step); value * step <= high; value++) found.push(value * step);
  return found;
}

function bounds(points, air) {
  const [xs, ys] = [points.map((p) => p[0]), points.map((p) => p[1])];
  const low = (values) => values.reduce((a, b) => Math.min(a, b), Infinity) - air;
  const high = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity) + air;
  return [low(xs), low(ys), high(xs), high(ys)];
}
