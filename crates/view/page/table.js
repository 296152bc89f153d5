"use strict";
// The table of links: sorted by a click on a head, filtered by words and by comparisons, a row leads to its link.
{
  const off = (row) => (csi.isNumber(row.error_from_mean_pose_deg) ? Math.abs(row.error_from_mean_pose_deg) : null);
  const other = (row) => (row.beside ? Math.abs(row.beside.error_deg) : null);
  // Name, value to sort by, text, more of it (a title), whether it is left out on small screens.
  const COLUMNS = [
    { name: "link", key: "link", value: (row) => row.link, text: (row) => row.short },
    { name: "azimuth", key: "azimuth", value: (row) => row.azimuth_deg, text: (row) => csi.figure(row.azimuth_deg, 1, "°") },
    { name: "±", key: "sd", title: "error bar of the azimuth (68 %), degrees", value: (row) => row.azimuth_sd_deg, text: (row) => csi.figure(row.azimuth_sd_deg, 1) },
    { name: "error", key: "error", title: "against the bearing from the mean pose, degrees", value: off, text: (row) => csi.figure(row.error_from_mean_pose_deg, 1), bad: (row) => off(row) > 20 },
    { name: "toolbox", key: "toolbox", title: "error of the program in links.csv on the same link, degrees", value: other, text: (row) => csi.figure(row.beside?.error_deg, 1), beside: true },
    { name: "prob.", key: "prob", title: "probability that the azimuth is within five degrees", value: (row) => row.confidence, text: (row) => csi.figure(row.confidence, 2) },
    { name: "range", key: "range", title: "metres", value: (row) => row.range_m, text: (row) => csi.figure(row.range_m, 1), more: true, most: true },
    { name: "pairs", key: "pairs", title: "pairs used", value: (row) => row.pairs_in_motion, text: (row) => String(row.pairs_in_motion), more: true, most: true },
  ];

  const shownOn = ({ more, most }) => `${more ? "more" : ""} ${most ? "most" : ""}`;

  // Names without the time stamp, where the place says which capture it is.
  const shortNames = (names) => {
    const short = names.map((name) => name.split("/").filter((part, k, all) => k !== all.length - 2 || all.length < 3).join("/"));
    const seen = new Map();
    short.forEach((name) => seen.set(name, (seen.get(name) ?? 0) + 1));
    return names.map((name, k) => (seen.get(short[k]) > 1 ? name : short[k]));
  };

  const collator = new Intl.Collator("en", { numeric: true });

  // `words` are parts of the name or of the error; `error>5`, `prob<0.5` compare a column.
  const filter = (text) => {
    const tests = text.toLowerCase().split(/\s+/).filter(Boolean).map((word) => {
      const parts = /^([a-z]+)([<>])(-?[\d.]+)$/.exec(word);
      const column = parts && COLUMNS.find(({ key }) => key === parts[1]);
      if (!column) return (row) => `${row.link} ${row.error ?? ""}`.toLowerCase().includes(word);
      const bound = Number(parts[3]);
      return (row) => {
        const value = column.value(row);
        return csi.isNumber(value) && (parts[2] === "<" ? value < bound : value > bound);
      };
    });
    return (row) => tests.every((test) => test(row));
  };

  class LinkTable {
    constructor(host, { names, beside, open }) {
      Object.assign(this, { host, open, names, short: shortNames(names), lines: new Map(), sort: "link", down: false, chosen: null, marked: null });
      // What is not evaluated yet has its name only.
      this.rows = names.map((link, number) => ({ number, link, short: this.short[number], waiting: true }));
      this.columns = COLUMNS.filter((column) => beside || !column.beside);
      this.search = csi.el("input", { type: "search", placeholder: "filter: words, error>5, prob<0.5", "aria-label": "filter the links", oninput: () => this.draw() });
      this.counted = csi.el("p", { class: "soft", role: "status" });
      this.body = csi.el("tbody");
      this.heads = this.columns.map((column) => {
        const button = csi.button(column.name, column.title ?? column.name, () => this.sortBy(column.key));
        return csi.el("th", { class: shownOn(column), scope: "col" }, button);
      });
      const table = csi.el("table", {}, csi.el("thead", {}, csi.el("tr", {}, ...this.heads)), this.body);
      host.append(csi.el("div", { class: "head" }, this.search, this.counted), table);
      this.body.addEventListener("click", (event) => {
        const line = event.target.closest("tr");
        if (line) this.open(Number(line.dataset.link));
      });
      this.later = csi.seldom(200, () => this.draw());
      this.draw();
    }

    add(rows) {
      for (const row of rows) this.rows[row.number] = { ...row, short: this.short[row.number] ?? row.link };
      this.later();
    }

    sortBy(key) {
      [this.down, this.sort] = [this.sort === key ? !this.down : key !== "link", key];
      this.draw();
    }

    // Rows that are shown, in their order.
    shown() {
      const { value } = this.columns.find(({ key }) => key === this.sort) ?? this.columns[0];
      const takes = filter(this.search.value);
      const sign = this.down ? -1 : 1;
      return this.rows.filter(takes).sort((a, b) => {
        const [x, y] = [value(a), value(b)];
        if (x === null || x === undefined) return y === null || y === undefined ? a.number - b.number : 1;
        if (y === null || y === undefined) return -1;
        return typeof x === "string" ? sign * collator.compare(x, y) : sign * (x - y);
      });
    }

    draw() {
      const rows = this.shown();
      this.order = rows.map((row) => row.number);
      this.columns.forEach(({ key }, k) => this.heads[k].setAttribute("aria-sort", key !== this.sort ? "none" : this.down ? "descending" : "ascending"));
      this.counted.textContent = rows.length === this.names.length ? csi.count(rows.length, "link", "links") : `${rows.length} of ${csi.count(this.names.length, "link", "links")}`;
      this.body.replaceChildren(...rows.map((row) => this.line(row)));
      this.mark();
    }

    // The line of a row, made once.
    line(row) {
      const kept = this.lines.get(row.number);
      if (kept?.row === row) return kept.line;
      const line = this.newLine(row);
      this.lines.set(row.number, { row, line });
      return line;
    }

    newLine(row) {
      const line = csi.el("tr", { "data-link": row.number, title: row.error ?? row.link, "aria-selected": "false" });
      if (row.waiting || row.error) {
        const words = row.waiting ? "waits to be evaluated" : row.error;
        line.append(csi.el("td", {}, row.short), csi.el("td", { class: row.error ? "words bad" : "words soft", colspan: this.columns.length - 1 }, words));
        return line;
      }
      line.append(...this.columns.map((column) => csi.el("td", { class: `${shownOn(column)} ${column.bad?.(row) ? "bad" : ""}` }, column.text(row))));
      return line;
    }

    choose(number) {
      this.chosen = number;
      this.mark(true);
    }

    // Of hundreds of lines two change at most.
    mark(scroll = false) {
      const line = this.lines.get(this.chosen)?.line ?? null;
      if (this.marked !== line) this.marked?.setAttribute("aria-selected", "false");
      this.marked = line;
      line?.setAttribute("aria-selected", "true");
      if (scroll && line?.isConnected) this.reveal(line);
    }

    // Moves the list until a line is below its head, and no further.
    reveal(line) {
      const [own, all] = [line.getBoundingClientRect(), this.host.getBoundingClientRect()];
      const above = this.host.querySelector("th").getBoundingClientRect().bottom - own.top;
      if (above > 0) this.host.scrollTop -= above;
      else this.host.scrollTop += Math.max(0, own.bottom - all.bottom);
    }

    // The link so many rows further on.
    next(by) {
      if (!this.order.length) return;
      const at = this.order.indexOf(this.chosen);
      const to = at < 0 ? (by > 0 ? 0 : this.order.length - 1) : Math.min(this.order.length - 1, Math.max(0, at + by));
      this.open(this.order[to]);
    }
  }

  csi.linkTable = (host, options) => new LinkTable(host, options);

  // Distributions of errors by set: the share of links within so many degrees. Dashed: the program in links.csv.
  csi.showErrors = (host, rows) => {
    const sets = [...new Set(rows.map((row) => row.set))].sort();
    const sorted = (values) => values.filter(csi.isNumber).sort((a, b) => a - b);
    const curves = sets.flatMap((set, k) => {
      const own = rows.filter((row) => row.set === set);
      const mine = { set, k, dash: null, errors: sorted(own.map(off)) };
      return [mine, { set, k, dash: [6, 4], errors: sorted(own.map(other)) }].filter(({ errors }) => errors.length);
    });
    if (!curves.length) return;
    const grid = sorted([0, ...new Set(curves.flatMap(({ errors }) => errors))]);
    const lines = curves.map(({ errors }) => {
      let seen = 0;
      return grid.map((error) => {
        while (seen < errors.length && errors[seen] <= error) seen += 1;
        return (100 * seen) / errors.length;
      });
    });
    const most = Math.min(180, Math.max(10, grid.at(Math.floor(grid.length * 0.97)) ?? 10));
    const stepped = uPlot.paths.stepped({ align: 1 });
    const { plot } = csi.chart(host, {
      height: 280, x: {}, y: { name: "share of links (%) with at most this error, degrees" },
      options: {
        scales: { x: { time: false, range: (_, low, high) => (csi.isNumber(low) ? [Math.max(0, low), high] : [0, most]) }, y: { range: [0, 101] } },
        cursor: { y: false, points: { show: false } },
        series: [{}, ...curves.map(({ k, dash }) => ({ stroke: () => csi.series(k), width: dash ? 1.2 : 2, dash: dash ?? [], paths: stepped, points: { show: false } }))],
      },
      data: [grid, ...lines],
    });
    plot.setScale("x", { min: 0, max: most });
    plot.over.addEventListener("dblclick", () => plot.setScale("x", { min: 0, max: most }));
    const named = curves.map(({ set, k, dash }) => [csi.seriesName(k), dash ? `${set}, toolbox` : set, dash ? "dash" : undefined]);
    host.append(csi.keyOf(...named));
  };

  // Errors by set in figures.
  csi.setTable = (sets, judged) => {
    const names = [...Object.keys(sets).filter((name) => name !== "all"), ...("all" in sets ? ["all"] : [])];
    const beside = names.some((name) => sets[name].beside);
    const figures = (errors) => [csi.figure(errors?.mean_deg, 2), csi.figure(errors?.median_deg, 2), csi.figure(errors?.p90_deg, 2), csi.isNumber(errors?.over_20) ? `${(100 * errors.over_20).toFixed(0)} %` : "–"];
    const four = (name) => ["mean", "median", "90 %", "over 20°"].map((figure) => `${name}${figure}`);
    const own = judged ? four("") : [];
    const head = ["set", "links", "failed", ...own, ...(beside ? ["toolbox: mean", ...four("").slice(1)] : [])];
    const cells = (name) => {
      const { links, failed, from_mean_pose: mine, beside: theirs } = sets[name];
      return [name, String(links), String(failed), ...(judged ? figures(mine) : []), ...(beside ? figures(theirs) : [])];
    };
    const row = (texts, tag) => csi.el("tr", {}, ...texts.map((text) => csi.el(tag, {}, text)));
    return csi.el("div", { class: "scroll" }, csi.el("table", {},
      csi.el("thead", {}, row(head, "th")), csi.el("tbody", {}, ...names.map((name) => row(cells(name), "td")))));
  };
}
