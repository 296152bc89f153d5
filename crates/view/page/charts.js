"use strict";
// Charts by uPlot in the page's colours, and time lines that are looked at together.
{
  const font = "12px system-ui, sans-serif";
  const axis = (more) => ({
    stroke: () => csi.colour("soft"),
    grid: { stroke: () => csi.colour("rule"), width: 1 },
    ticks: { stroke: () => csi.colour("line"), width: 1, size: 4 },
    font, size: 34, gap: 3, ...more,
  });

  // uPlot keeps charts that share a cursor: those that left the page are taken away.
  let living = [];
  const sweep = () => {
    living.filter(({ box }) => !box.isConnected).forEach(({ plot }) => plot.destroy());
    living = living.filter(({ box }) => box.isConnected);
  };

  // A chart as wide as its host. `y` has a label, a range and a size; `options` are uPlot's, which they complete.
  csi.chart = (host, { height, x, y, options, data }) => {
    sweep();
    const box = csi.el("div", { class: "plot" });
    if (y.name) box.append(csi.el("div", { class: "name" }, y.name));
    const inner = csi.el("div");
    box.append(inner);
    host.append(box);
    const whole = {
      width: Math.max(200, host.clientWidth), height,
      padding: [8, 12, x.show === false ? 6 : 0, 0],
      legend: { show: false },
      axes: [axis({ ...x.axis, show: x.show ?? true }), axis({ size: 52, ...y.axis })],
      ...options,
    };
    const plot = new uPlot(whole, data, inner);
    const resize = new ResizeObserver(() => {
      if (!box.isConnected) {
        resize.disconnect();
        return;
      }
      const width = Math.max(200, Math.floor(box.clientWidth));
      if (Math.abs(width - plot.width) > 1) plot.setSize({ width, height });
    });
    resize.observe(box);
    csi.onTheme(box, () => plot.redraw(false));
    living.push({ plot, box });
    return { plot, box };
  };

  // A horizontal stretch of time that several charts show; `load` is asked for finer data when it changes.
  csi.Stretch = class {
    constructor(span, load) {
      [this.whole, this.from, this.to] = [span, span[0], span[1]];
      this.plots = [];
      this.busy = false;
      this.load = csi.later(40, () => load(this.from, this.to));
    }

    add(plot) {
      this.plots.push(plot);
      plot.over.addEventListener("wheel", (event) => {
        event.preventDefault();
        const at = plot.posToVal(event.offsetX, "x");
        this.zoom(event.deltaY < 0 ? 1 / 1.35 : 1.35, at);
      }, { passive: false });
      plot.over.addEventListener("dblclick", () => this.set(...this.whole));
    }

    // Hook of uPlot: a drag has chosen a part.
    chosen(plot) {
      if (this.busy) return;
      const { min, max } = plot.scales.x;
      if (csi.isNumber(min) && csi.isNumber(max) && (min !== this.from || max !== this.to)) this.set(min, max);
    }

    set(from, to) {
      const [low, high] = this.whole;
      const width = Math.min(Math.max(to - from, (high - low) * 1e-6, 1e-4), high - low);
      this.from = Math.min(Math.max(from, low), high - width);
      this.to = this.from + width;
      this.draw();
      this.load();
    }

    draw() {
      this.busy = true;
      for (const plot of this.plots) plot.setScale("x", { min: this.from, max: this.to });
      // uPlot sets scales at the end of the task.
      queueMicrotask(() => { this.busy = false; });
    }

    zoom(factor, at = (this.from + this.to) / 2) {
      this.set(at - (at - this.from) * factor, at + (this.to - at) * factor);
    }

    move(share) {
      const step = share * (this.to - this.from);
      this.set(this.from + step, this.to + step);
    }

    buttons() {
      return [
        csi.button("−", "further (-)", () => this.zoom(2), { "aria-label": "further" }),
        csi.button("+", "nearer (+)", () => this.zoom(0.5), { "aria-label": "nearer" }),
        csi.button("◀", "earlier (left arrow)", () => this.move(-0.25), { "aria-label": "earlier" }),
        csi.button("▶", "later (right arrow)", () => this.move(0.25), { "aria-label": "later" }),
        csi.button("whole", "the whole log (0)", () => this.set(...this.whole)),
      ];
    }
  };

  // Middles of n columns between two values.
  csi.middles = (from, to, n) => Array.from({ length: n }, (_, k) => from + ((k + 0.5) * (to - from)) / n);

  // Draws marks on a chart in its own coordinates, clipped to its plotting area.
  csi.clipped = (plot, draw) => {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    draw(ctx, bbox, (value) => plot.valToPos(value, "x", true), (value) => plot.valToPos(value, "y", true));
    ctx.restore();
  };

  csi.vertical = (ctx, bbox, x, colour, width, dash = []) => {
    ctx.strokeStyle = colour;
    ctx.lineWidth = width * devicePixelRatio;
    ctx.setLineDash(dash.map((part) => part * devicePixelRatio));
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.setLineDash([]);
  };
}
