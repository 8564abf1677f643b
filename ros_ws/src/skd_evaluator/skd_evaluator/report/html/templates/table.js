// Every episode: sorted, searched, a page at a time.
const PAGE = 25;

class Table {
  constructor(episodes, chosen) {
    this.episodes = episodes;
    this.chosen = chosen;
    const { columns } = episodes;
    const several = episodes.subjects.length > 1;
    const number = (name, digits) => ({ value: (k) => columns[name][k], text: (k) => fixed(columns[name][k], digits), numeric: true });
    const named = (text) => ({ value: text, text });
    this.shape = [
      { title: "#", value: (k) => k, text: (k) => String(k + 1), numeric: true },
      ...(several ? [{ title: "car", ...named((k) => episodes.subject(k).label) }] : []),
      { title: "φ", ...named((k) => episodes.phi(k).name) },
      { title: "adversary", ...named((k) => episodes.adversary(k)) },
      { title: "outcome", ...named((k) => episodes.outcome(k)) },
      { title: "deviation (m)", ...number("deviation", 3) },
      { title: "Fréchet distance (m)", ...number("frechet", 3) },
      { title: "impact (m/s)", ...number("impact_speed", 2) },
      { title: "contact after (s)", ...number("impact_time", 2) },
      { title: "trial", ...number("trial", 0) },
    ];
    this.order = { column: 0, down: false };
    this.page = 0;
    this.table = document.getElementById("table");
    this.texts = Array.from({ length: episodes.count }, (_, k) => [episodes.subject(k).label, episodes.phi(k).name, episodes.adversary(k), episodes.outcome(k)].join(" ").toLowerCase());
    this.head();
    this.filters();
    this.update();
  }

  head() {
    const cells = this.shape.map((one, index) => {
      const button = html("button", { type: "button", textContent: one.title });
      button.addEventListener("click", () => this.sort(index));
      const cell = html("th", { scope: "col", className: one.numeric ? "n" : "" }, button);
      return cell;
    });
    const command = html("th", { scope: "col", textContent: "command" });
    this.table.tHead.rows[0].replaceChildren(...cells, command);
    this.heads = cells;
  }

  filters() {
    const { episodes } = this;
    const fill = (id, texts) => {
      const select = document.getElementById(id);
      select.append(...[...new Set(texts)].map((text) => html("option", { value: text, textContent: text })));
      select.addEventListener("change", () => { this.page = 0; this.update(); });
      return select;
    };
    const all = Array.from({ length: episodes.count }, (_, k) => k);
    this.outcome = fill("outcome", all.map((k) => episodes.outcome(k)));
    this.objective = fill("objective", all.map((k) => episodes.adversary(k)));
    this.search = document.getElementById("search");
    this.search.addEventListener("input", () => { this.page = 0; this.update(); });
    document.getElementById("page-previous").addEventListener("click", () => { this.page--; this.show(); });
    document.getElementById("page-next").addEventListener("click", () => { this.page++; this.show(); });
  }

  sort(column) {
    this.order = { column, down: this.order.column === column && !this.order.down };
    this.page = 0;
    this.update();
  }

  update() {
    const { episodes, order } = this;
    const words = this.search.value.toLowerCase().split(/\s+/).filter((word) => word);
    const rows = [];
    for (let k = 0; k < episodes.count; k++) {
      if (this.outcome.value && episodes.outcome(k) !== this.outcome.value) continue;
      if (this.objective.value && episodes.adversary(k) !== this.objective.value) continue;
      if (words.every((word) => this.texts[k].includes(word))) rows.push(k);
    }
    const { value } = this.shape[order.column];
    const sign = order.down ? -1 : 1;
    rows.sort((one, other) => {
      const [a, b] = [value(one), value(other)];
      if (typeof a === "string") return sign * a.localeCompare(b, undefined, { numeric: true }) || one - other;
      if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b) || one - other; // none: last either way
      return sign * (a - b) || one - other;
    });
    this.rows = rows;
    this.heads.forEach((cell, index) => cell.setAttribute("aria-sort", index !== order.column ? "none" : order.down ? "descending" : "ascending"));
    this.heads.forEach((cell, index) => { cell.firstChild.textContent = this.shape[index].title + (index !== order.column ? "" : order.down ? " ▼" : " ▲"); });
    this.show();
  }

  show() {
    const pages = Math.max(1, Math.ceil(this.rows.length / PAGE));
    this.page = Math.min(Math.max(0, this.page), pages - 1);
    const shown = this.rows.slice(this.page * PAGE, (this.page + 1) * PAGE);
    this.table.tBodies[0].replaceChildren(...shown.map((k) => this.row(k)));
    document.getElementById("count").textContent = `${this.rows.length.toLocaleString("en")} of ${this.episodes.count.toLocaleString("en")} episodes`;
    document.getElementById("page").textContent = `page ${this.page + 1} of ${pages}`;
    document.getElementById("page-previous").disabled = this.page === 0;
    document.getElementById("page-next").disabled = this.page === pages - 1;
    this.mark();
  }

  row(k) {
    const play = html("button", { type: "button", textContent: `▶ ${this.shape[0].text(k)}` });
    play.setAttribute("aria-label", `Play episode ${k + 1}`);
    const cells = this.shape.map((one, index) => html(index ? "td" : "th", { className: one.numeric ? "n" : "" }, index ? one.text(k) : play));
    const copy = html("button", { type: "button", textContent: "copy", title: this.episodes.command(k) });
    copy.setAttribute("aria-label", `Copy the command of episode ${k + 1}`);
    copy.addEventListener("click", (event) => { event.stopPropagation(); copyText(this.episodes.command(k), copy); });
    const row = html("tr", {}, ...cells, html("td", {}, copy));
    row.dataset.episode = k;
    row.addEventListener("click", () => { this.choose(k); reveal(document.getElementById("player")); });
    return row;
  }

  choose(k) {
    this.current = k;
    this.mark();
    this.chosen(k);
  }

  // The one before or after the one that is played, in the order of the table.
  step(by) {
    const place = this.rows.indexOf(this.current) + by;
    if (place < 0 || place >= this.rows.length) return;
    const page = Math.floor(place / PAGE);
    if (page !== this.page) { this.page = page; this.show(); }
    this.choose(this.rows[place]);
  }

  mark() {
    for (const row of this.table.tBodies[0].rows) row.classList.toggle("chosen", Number(row.dataset.episode) === this.current);
  }
}
