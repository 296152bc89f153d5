"use strict";
// A log over time: rate and losses, RSSI and gain, CSI as a heat map, and one column of it under the cursor.
{
  const MAPS = {
    amplitude_db: { words: "amplitude", unit: "dB of the card's step" },
    phase_rad: { words: "phase", unit: "rad, relative to the middle subcarrier" },
  };
  // Rows that have a tick: the outermost subcarriers, one beside the centre, and two between.
  const ticked = (rows) => [...new Set([0, rows / 4, rows / 2, (3 * rows) / 4, rows - 1].map(Math.floor))];
  // What the user chose stays when another log is shown.
  const chosen = { map: "amplitude_db", antenna: "A", sender: "" };

  class LogPanel {
    constructor(host, number) {
      [this.host, this.number, this.asked] = [host, number, 0];
      this.open().catch((error) => host.append(csi.el("p", { class: "bad" }, String(error.message ?? error))));
    }

    async open() {
      this.facts = await csi.get(`/data/log/${this.number}`);
      if (!this.host.isConnected) return;
      if (!this.facts.senders.some((sender) => sender.mac === chosen.sender)) chosen.sender = "";
      this.stretch = new csi.Stretch(this.facts.span_s, () => this.load());
      this.tools = csi.el("div", { class: "tools" });
      this.host.append(this.words(), this.tools);
      this.key = this.host.appendChild(csi.el("div"));
      this.rate = this.rateChart();
      this.levels = this.levelChart();
      this.heat = this.heatChart();
      this.readout = this.host.appendChild(csi.el("p", { class: "readout", "aria-live": "off" }));
      this.column = this.columnChart();
      this.fillTools();
      await this.load();
    }

    // What there is of another card's log, whose records have no numbers.
    cardWords() {
      const f = this.facts;
      const counts = (what) => Object.entries(what).map(([name, count]) => `${name} (${count.toLocaleString("en")})`).join(", ");
      const lost = Object.entries(f.skipped).map(([why, bytes]) => `${csi.size(bytes)} not read: ${why}`);
      const steps = { host: "times are the host's", number: "it tells no times" }[f.time_base];
      return [`${csi.size(f.bytes)}, ${csi.count(f.frames, "frame", "frames")}${this.long()}`, f.format, counts(f.cards), counts(f.shapes), steps, ...lost];
    }

    long() {
      const [from, to] = this.facts.span_s;
      return this.hasClock() ? ` over ${csi.figure(to - from, 1)} s` : "";
    }

    // The log in a line or two.
    words() {
      const f = this.facts;
      const parts = f.format ? this.cardWords() : this.csitoolWords();
      return csi.el("p", { class: "soft" }, `${f.name}: ${parts.filter(Boolean).join("; ")}`);
    }

    csitoolWords() {
      const f = this.facts;
      const steps = f.clock_steps.steps_back;
      const sum = (name) => f.senders.reduce((all, sender) => all + (sender[name] ?? 0), 0);
      const [skipped, repeated] = [sum("frames_skipped"), sum("frames_repeated")];
      return [
        `${csi.size(f.bytes)}, ${csi.count(f.records, "record", "records")}${this.long()}`,
        { host: "times are the host's: the card's clock stands still", number: "no times: the card's clock stands still, and the host has none" }[f.time_base] ?? null,
        f.bfee_missing ? `${csi.count(f.bfee_missing, "number", "numbers")} missing from bfee_count` : "none missing from bfee_count",
        skipped ? `${csi.count(skipped, "frame number", "frame numbers")} not heard` : null,
        repeated ? `${csi.count(repeated, "frame", "frames")} reported twice` : null,
        f.damages ? `${csi.count(f.damages, "damaged stretch", "damaged stretches")} (${csi.size(f.damaged_bytes)})` : null,
        f.bad_bfee ? `${csi.count(f.bad_bfee, "impossible record", "impossible records")}` : null,
        steps ? `the card's clock steps back ${csi.count(steps, "time", "times")}` : null,
        f.cut ? "the last record is cut" : null,
      ];
    }

    fillTools() {
      const toggle = csi.button("", "amplitude or phase (a)", () => this.turn(), { class: "turn" });
      this.turnButton = toggle;
      const antenna = csi.el("select", { "aria-label": "antenna", onchange: () => { chosen.antenna = antenna.value; this.show(); } });
      this.antennaChoice = antenna;
      const sender = csi.el("select", { "aria-label": "sender", onchange: () => { chosen.sender = sender.value; this.load(); } });
      sender.append(csi.el("option", { value: "" }, "all senders"));
      for (const { mac, records, rate_hz } of this.facts.senders) {
        const name = mac === "00:00:00:00:00:00" ? "unknown sender" : mac;
        const words = `${name} (${records.toLocaleString("en")}${rate_hz ? `, ${rate_hz.toFixed(0)}/s` : ""})`;
        sender.append(csi.el("option", { value: mac, selected: mac === chosen.sender }, words));
      }
      const inFile = csi.answers !== null;
      this.tools.append(...this.stretch.buttons(), csi.el("span", { class: "gap" }), toggle, antenna);
      if (this.facts.senders.length > 1 && !inFile) this.tools.append(sender);
    }

    turn() {
      chosen.map = chosen.map === "amplitude_db" ? "phase_rad" : "amplitude_db";
      this.show();
    }

    options(height, y, more = {}) {
      const hooks = { setScale: [(plot, key) => { if (key === "x") this.stretch.chosen(plot); }], ...more.hooks };
      const span = this.facts.span_s;
      return {
        height, y,
        x: { show: more.showX ?? false },
        options: {
          cursor: { sync: { key: `log${this.number}`, scales: ["x", null] }, drag: { x: true, y: false }, y: more.cursorY ?? false, points: { show: false } },
          scales: { x: { time: false, auto: false, min: span[0], max: span[1] }, y: more.scale ?? {} },
          series: more.series,
          bands: more.bands ?? [],
          hooks,
          axes: undefined,
        },
        data: more.data,
      };
    }

    chart(height, y, more) {
      const made = this.options(height, y, more);
      delete made.options.axes;
      const { plot } = csi.chart(this.host, made);
      this.stretch.add(plot);
      return plot;
    }

    // Without a clock there are numbers of records in place of times, and no rate.
    hasClock() {
      return this.facts.time_base !== "number";
    }

    rateChart() {
      const stepped = uPlot.paths.stepped({ align: 1 });
      const rate = this.hasClock() ? "records per second" : "over the records: there is no clock, and no rate";
      // Without a rate its ticks would be of nothing.
      const axis = this.hasClock() ? {} : { values: (_, places) => places.map(() => "") };
      return this.chart(110, { name: `${rate}; losses, gaps and steps back of the clock`, axis }, {
        scale: { range: (_, low, high) => [0, Math.max(1, high * 1.1)] },
        series: [{}, { stroke: () => csi.colour("ink"), width: 1.5, paths: stepped, points: { show: false } }],
        hooks: { draw: [(plot) => this.marks(plot)] },
        data: [this.facts.span_s, [null, null]],
      });
    }

    // Gaps as areas, missing numbers and damage as ticks, steps back of the clock as dashed lines.
    marks(plot) {
      const levels = this.now;
      if (!levels) return;
      csi.clipped(plot, (ctx, bbox, x) => {
        ctx.fillStyle = csi.faint(csi.colour("purple"), 0.3);
        for (const [from, to] of levels.gaps_s) ctx.fillRect(x(from), bbox.top, Math.max(1, x(to) - x(from)), bbox.height);
        const width = (levels.to_s - levels.from_s) / levels.columns;
        // From `high` to `low` of the height; 0 is above.
        const tick = (colour, high, low) => ([column]) => {
          ctx.fillStyle = colour;
          const at = x(levels.from_s + column * width);
          const wide = Math.max(1.5 * devicePixelRatio, x(levels.from_s + (column + 1) * width) - at);
          ctx.fillRect(at, bbox.top + bbox.height * high, wide, bbox.height * (low - high));
        };
        levels.skipped.forEach(tick(csi.colour("sky"), 0, 0.13));
        levels.repeated.forEach(tick(csi.colour("red"), 0.15, 0.28));
        levels.damaged.forEach(tick(csi.colour("ink"), 0.55, 1));
        levels.missing.forEach(tick(csi.colour("bad"), 0.78, 1));
        for (const [at] of levels.steps_back) csi.vertical(ctx, bbox, x(at), csi.colour("ink"), 1.5, [5, 4]);
      });
    }

    // A band from lowest to highest and the mean of each antenna, and the gain.
    levelChart() {
      const series = [{}];
      const bands = [];
      // Other cards tell no gain.
      this.lines = [...this.facts.antennas, ...(this.facts.format ? [] : ["gain"])];
      const unit = this.facts.rssi_in_dbm ? "dBm" : "dB";
      for (const letter of this.lines) {
        const colour = () => (letter === "gain" ? csi.colour("grey") : csi.antennaColour(letter));
        const edge = { stroke: () => csi.faint(colour(), 0.35), width: 0.5, points: { show: false } };
        bands.push({ series: [series.length + 2, series.length], fill: () => csi.faint(colour(), 0.18) });
        series.push({ ...edge }, { stroke: colour, width: 1.6, points: { show: false } }, { ...edge });
      }
      const nothing = series.slice(1).map(() => [null, null]);
      const gain = this.facts.format ? "" : " and gain (AGC)";
      return this.chart(130, { name: `RSSI of ${this.facts.antennas.length > 1 ? "antennas" : "antenna"} ${this.facts.antennas.join(", ")}${gain}: lowest, mean, highest; ${unit}` }, {
        scale: { range: (_, low, high) => (csi.isNumber(low) ? [low - 2, high + 2] : [0, 60]) },
        series, bands, data: [this.facts.span_s, ...nothing],
      });
    }

    // The index of a row's subcarrier about the centre; its place in the record where a 5300's frames of both widths are in the log.
    subcarrier(k) {
      return String(this.maps?.subcarriers[k] ?? "");
    }

    rows() {
      return this.maps?.rows || 1;
    }

    heatChart() {
      const axis = { splits: () => ticked(this.rows()).map((k) => k + 0.5), values: (_, places) => places.map((place) => this.subcarrier(Math.floor(place))) };
      return this.chart(230, { name: "CSI over time and subcarrier, first stream, one sender", axis }, {
        scale: { range: () => [0, this.rows()] }, showX: true, cursorY: true,
        series: [{}, { stroke: "transparent", points: { show: false } }],
        hooks: { draw: [(plot) => this.paint(plot)], setCursor: [(plot) => this.point(plot)] },
        data: [this.facts.span_s, [null, null]],
      });
    }

    columnChart() {
      const series = this.facts.antennas.map((letter) => ({ stroke: () => csi.antennaColour(letter), width: 1.6, points: { show: false } }));
      const { plot } = csi.chart(this.host, {
        height: 130, x: { axis: { splits: () => ticked(this.rows()), values: (_, places) => places.map((k) => this.subcarrier(k)) } },
        y: { name: "under the cursor, over the subcarriers" },
        options: { scales: { x: { time: false, range: () => [0, Math.max(1, this.rows() - 1)] }, y: { range: () => this.range() } }, cursor: { show: false }, series: [{}, ...series] },
        data: [[0, 1], ...this.facts.antennas.map(() => [null, null])],
      });
      return plot;
    }

    async load() {
      const asked = ++this.asked;
      const { from, to } = this.stretch;
      const columns = Math.min(1500, Math.max(200, Math.round(this.heat.bbox.width / devicePixelRatio)));
      const query = `from=${from}&to=${to}&columns=${columns}&sender=${chosen.sender}`;
      try {
        const [levels, maps] = await Promise.all(["levels", "csi"].map((what) => csi.get(`/data/log/${this.number}/${what}`, query)));
        if (asked !== this.asked || !this.host.isConnected) return;
        [this.now, this.maps] = [levels, maps];
        this.images = {};
        this.showLevels();
        this.show();
      } catch (error) {
        this.readout.textContent = String(error.message ?? error);
      }
    }

    showLevels() {
      const { now } = this;
      const bins = now.rate_hz.length;
      const left = csi.middles(now.from_s, now.to_s, bins).map((t) => t - (now.to_s - now.from_s) / bins / 2);
      const rates = [...now.rate_hz, now.rate_hz.at(-1) ?? null];
      this.rate.setData([[...left, now.to_s], this.hasClock() ? rates : rates.map(() => null)]);
      const times = csi.middles(now.from_s, now.to_s, now.columns);
      const none = times.map(() => null);
      const bands = this.lines.map((line, k) => (line === "gain" ? now.agc : now.rssi[k])).flatMap((band) => [band.min, band.mean, band.max].map((line) => (line.length ? line : none)));
      this.levels.setData([times, ...bands]);
      // Not every format tells it.
      this.levels.root.closest(".plot").hidden = bands.every((line) => line === none);
      this.stretch.draw();
      this.showKey();
    }

    showKey() {
      const { now } = this;
      const sum = (pairs) => pairs.reduce((all, [, count]) => all + count, 0);
      const heard = (letter, k) => now.rssi[k].mean.length || this.maps.antennas.some((own) => own.antenna === letter);
      const connected = this.facts.antennas.filter(heard);
      const entries = connected.map((letter) => [csi.antennaName(letter), `antenna ${letter}`]);
      if (this.lines.includes("gain")) entries.push(["grey", "gain"]);
      if (now.gaps_s.length) entries.push(["purple", csi.count(now.gaps_s.length, "gap", "gaps"), "area"]);
      if (now.missing.length) entries.push(["bad", csi.count(sum(now.missing), "number missing from bfee_count", "numbers missing from bfee_count"), "tick"]);
      if (now.damaged.length) entries.push(["ink", csi.count(sum(now.damaged), "damaged stretch", "damaged stretches"), "tick"]);
      if (now.skipped.length) entries.push(["sky", csi.count(sum(now.skipped), "frame number not heard", "frame numbers not heard"), "tick"]);
      if (now.repeated.length) entries.push(["red", csi.count(sum(now.repeated), "frame reported twice", "frames reported twice"), "tick"]);
      if (now.steps_back.length) entries.push(["ink", csi.count(now.steps_back.length, "step back of the clock", "steps back of the clock"), "dash"]);
      this.key.replaceChildren(csi.keyOf(...entries));
    }

    // The antenna that is looked at: the chosen one, or the first that there is.
    antenna() {
      const all = this.maps?.antennas ?? [];
      return all.find((own) => own.antenna === chosen.antenna) ?? all[0];
    }

    show() {
      const all = this.maps?.antennas ?? [];
      const own = this.antenna();
      this.antennaChoice.replaceChildren(...all.map(({ antenna }) => csi.el("option", { value: antenna, selected: antenna === own?.antenna }, `antenna ${antenna}`)));
      this.turnButton.textContent = MAPS[chosen.map].words;
      this.heat.redraw(false);
      this.point(this.heat);
    }

    image() {
      const own = this.antenna();
      if (!own) return null;
      const name = `${own.antenna} ${chosen.map}`;
      if (this.images[name]) return this.images[name];
      const { columns, rows } = this.maps;
      const canvas = csi.el("canvas", { width: columns, height: rows });
      const pixels = new ImageData(columns, rows);
      const cells = csi.bytes(own[chosen.map].cells);
      cells.forEach((value, cell) => {
        if (value === 255) return;
        // Subcarrier 0 is below.
        const at = 4 * ((rows - 1 - Math.floor(cell / columns)) * columns + (cell % columns));
        pixels.data.set(csi.shades[chosen.map][value], at);
        pixels.data[at + 3] = 255;
      });
      canvas.getContext("2d").putImageData(pixels, 0, 0);
      this.images[name] = canvas;
      return canvas;
    }

    paint(plot) {
      const image = this.maps && this.image();
      if (!image) return;
      csi.clipped(plot, (ctx, bbox, x) => {
        ctx.imageSmoothingEnabled = false;
        const [left, right] = [x(this.maps.from_s), x(this.maps.to_s)];
        ctx.drawImage(image, left, bbox.top, right - left, bbox.height);
      });
    }

    // What is under the cursor, in words and over the subcarriers.
    point(plot) {
      const own = this.antenna();
      if (!own || !this.readout) return;
      const { columns, rows, from_s, to_s } = this.maps;
      const { low, high } = own[chosen.map];
      const t = plot.cursor.left >= 0 ? plot.posToVal(plot.cursor.left, "x") : (from_s + to_s) / 2;
      const column = Math.min(columns - 1, Math.max(0, Math.floor(((t - from_s) / (to_s - from_s)) * columns)));
      const value = (map, k) => {
        map.bytes ??= csi.bytes(map.cells);
        const byte = map.bytes[k * columns + column];
        return byte === 255 || byte === undefined ? null : map.low + (byte / 254) * (map.high - map.low);
      };
      const lines = this.facts.antennas.map((letter) => {
        const found = this.maps.antennas.find((other) => other.antenna === letter);
        return Array.from({ length: rows }, (_, k) => (found ? value(found[chosen.map], k) : null));
      });
      this.column.setData([Array.from({ length: rows }, (_, k) => k), ...lines]);
      const { words, unit } = MAPS[chosen.map];
      const k = plot.cursor.top >= 0 && plot.cursor.left >= 0 ? Math.min(rows - 1, Math.max(0, Math.floor(plot.posToVal(plot.cursor.top, "y")))) : null;
      const here = k === null ? "" : `; subcarrier ${this.subcarrier(k)}: ${csi.figure(value(own[chosen.map], k), 2)}`;
      const every = [
        this.maps.sender ? `; sender ${this.maps.sender}` : "",
        this.maps.frames ? `; ${this.maps.frames}` : "",
        this.maps.other_frames ? `, without ${csi.count(this.maps.other_frames, "frame", "frames")} of another kind or width` : "",
        this.maps.subcarriers_a_row > 1 ? `; each row is ${this.maps.subcarriers_a_row} subcarriers` : "",
        this.maps.every > 1 ? `; one record in ${this.maps.every} is in the picture` : "",
      ].join("");
      this.readout.textContent = `antenna ${own.antenna}, ${words} from ${csi.figure(low, 1)} (dark) to ${csi.figure(high, 1)} ${unit}; ${this.facts.time_base === "number" ? `record ${Math.round(t)}` : `${csi.figure(t, 3)} s`}${here}${every}`;
    }

    // The same range under every place of the cursor.
    range() {
      if (!this.maps?.antennas.length) return [0, 1];
      if (chosen.map === "phase_rad") return [-Math.PI, Math.PI];
      const all = this.maps.antennas.map((own) => own.amplitude_db);
      return [Math.min(...all.map((map) => map.low)) - 1, Math.max(...all.map((map) => map.high)) + 1];
    }
  }

  csi.showLog = (host, number) => new LogPanel(host, number);
}
