// Every episode: sorted, searched, a page at a time.
const PAGE = window.innerWidth < 760 ? 10 : 25; // rows; on a telephone each is a block

class Table {
  constructor(data, chosen) {
    this.episodes = data.episodes;
    this.chosen = chosen;
    const number = (name, digits) => ({ value: (one) => one[name] ?? NaN, text: (one) => fixed(one[name], digits), numeric: true });
    const named = (text) => ({ value: text, text });
    this.shape = [
      { title: "#", value: (one) => one.number, text: (one) => String(one.number + 1), numeric: true },
      ...(data.subjects.length > 1 ? [{ title: "car", ...named((one) => one.owner.label) }] : []),
      { title: "φ", ...named((one) => one.safe.name) },
      { title: "adversary", ...named((one) => one.name) },
      { title: "outcome", ...named((one) => one.outcome) },
      { title: "deviation (m)", ...number("deviation", 3) },
      { title: "Fréchet distance (m)", ...number("frechet", 3) },
      { title: "impact (m/s)", ...number("speed", 2) },
      { title: "contact after (s)", ...number("time", 2) },
      { title: "trial", ...number("trial", 0) },
    ];
    this.order = { column: 0, down: false };
    this.page = 0;
    this.table = document.getElementById("table");
    this.texts = this.episodes.map((one) => [one.owner.label, one.safe.name, one.name, one.outcome].join(" ").toLowerCase());
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
    const fill = (id, texts) => {
      const select = document.getElementById(id);
      select.append(...[...new Set(texts)].map((text) => html("option", { value: text, textContent: text })));
      select.addEventListener("change", () => { this.page = 0; this.update(); });
      return select;
    };
    this.outcome = fill("outcome", this.episodes.map((one) => one.outcome));
    this.objective = fill("objective", this.episodes.map((one) => one.name));
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
    const { order } = this;
    const words = this.search.value.toLowerCase().split(/\s+/).filter((word) => word);
    const rows = this.episodes.filter((one, k) =>
      (!this.outcome.value || one.outcome === this.outcome.value) && (!this.objective.value || one.name === this.objective.value) && words.every((word) => this.texts[k].includes(word)));
    const { value } = this.shape[order.column];
    const sign = order.down ? -1 : 1;
    rows.sort((one, other) => {
      const [a, b] = [value(one), value(other)];
      if (typeof a === "string") return sign * a.localeCompare(b, undefined, { numeric: true }) || one.number - other.number;
      if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b) || one.number - other.number; // none: last either way
      return sign * (a - b) || one.number - other.number;
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
    this.table.tBodies[0].replaceChildren(...shown.map((one) => this.row(one)));
    document.getElementById("count").textContent = `${this.rows.length.toLocaleString("en")} of ${this.episodes.length.toLocaleString("en")} episodes`;
    document.getElementById("page").textContent = `page ${this.page + 1} of ${pages}`;
    document.getElementById("page-previous").disabled = this.page === 0;
    document.getElementById("page-next").disabled = this.page === pages - 1;
    this.mark();
  }

  row(episode) {
    const play = html("button", { type: "button", textContent: `▶ ${episode.number + 1}` });
    play.setAttribute("aria-label", `Play episode ${episode.number + 1}`);
    const cells = this.shape.map((one, index) => {
      const cell = html(index ? "td" : "th", { className: one.numeric ? "n" : "" }, index ? one.text(episode) : play);
      cell.dataset.label = one.title;
      return cell;
    });
    const copy = html("button", { type: "button", textContent: "copy", title: episode.command });
    copy.setAttribute("aria-label", `Copy the command of episode ${episode.number + 1}`);
    copy.addEventListener("click", (event) => { event.stopPropagation(); copyText(episode.command, copy); });
    const last = html("td", {}, copy);
    last.dataset.label = "command";
    const row = html("tr", {}, ...cells, last);
    row.dataset.episode = episode.number;
    row.addEventListener("click", () => { this.choose(episode); reveal(document.getElementById("player")); });
    return row;
  }

  choose(episode) {
    this.current = episode;
    this.mark();
    this.chosen(episode);
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
    for (const row of this.table.tBodies[0].rows) row.classList.toggle("chosen", Number(row.dataset.episode) === this.current?.number);
  }
}
