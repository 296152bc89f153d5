"use strict";
// A map in metres, the same scale in x and y: paths, robots, bearings with their error bars, ellipses. It can be moved
// and zoomed. Azimuths count from +x (right) towards +y (up).
{
  const rad = (deg) => (deg * Math.PI) / 180;

  // The ellipse that holds 95 %: the square root of a covariance on a circle of `sqrt(-2 ln 0.05)` deviations.
  const deviations = 2.44775;
  const around = ({ centre, covariance }) => {
    const [[a, b], [, d]] = covariance;
    const l = Math.sqrt(Math.max(a, 1e-12));
    const [m, n] = [b / l, Math.sqrt(Math.max(d - (b * b) / (l * l), 0))];
    return Array.from({ length: 72 }, (_, k) => {
      const [cos, sin] = [Math.cos((2 * Math.PI * k) / 72), Math.sin((2 * Math.PI * k) / 72)];
      return [centre[0] + deviations * l * cos, centre[1] + deviations * (m * cos + n * sin)];
    });
  };

  // A step of 1, 2 or 5 that fits about `wish` times into `length`.
  const step = (length, wish) => {
    const power = 10 ** Math.floor(Math.log10(length / wish));
    return [1, 2, 5, 10].map((k) => k * power).find((size) => length / size <= wish * 1.5) ?? 10 * power;
  };

  class Map {
    constructor(host) {
      this.canvas = host.appendChild(csi.el("canvas", { class: "map", role: "img", "aria-label": "map of robots and bearings" }));
      this.scene = null;
      this.view = null;
      const resize = new ResizeObserver(() => {
        if (!this.canvas.isConnected) return resize.disconnect();
        if (!this.moved) this.view = null;
        return this.draw();
      });
      resize.observe(this.canvas);
      csi.onTheme(this.canvas, () => this.draw());
      this.listen();
    }

    listen() {
      const { canvas } = this;
      const held = new globalThis.Map();
      canvas.addEventListener("pointerdown", (event) => {
        held.set(event.pointerId, [event.offsetX, event.offsetY]);
        canvas.setPointerCapture(event.pointerId);
      });
      canvas.addEventListener("pointermove", (event) => {
        const before = held.get(event.pointerId);
        if (!before || !this.view) return;
        const at = [event.offsetX, event.offsetY];
        if (held.size === 2) {
          const [other] = [...held].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
          const apart = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]);
          this.zoom(apart(at) / Math.max(1, apart(before)), other);
        } else {
          this.moved = true;
          this.view.x -= (at[0] - before[0]) / this.view.scale;
          this.view.y += (at[1] - before[1]) / this.view.scale;
        }
        held.set(event.pointerId, at);
        this.draw();
      });
      for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => held.delete(event.pointerId));
      canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        this.zoom(event.deltaY < 0 ? 1.25 : 0.8, [event.offsetX, event.offsetY]);
        this.draw();
      }, { passive: false });
      canvas.addEventListener("dblclick", () => {
        [this.view, this.moved] = [null, false];
        this.draw();
      });
    }

    zoom(factor, [px, py]) {
      if (!this.view) return;
      this.moved = true;
      const { clientWidth: width, clientHeight: height } = this.canvas;
      const scale = Math.min(1e5, Math.max(0.5, this.view.scale * factor));
      const held = 1 / this.view.scale - 1 / scale;
      this.view = { x: this.view.x + (px - width / 2) * held, y: this.view.y - (py - height / 2) * held, scale };
    }

    // `scene`: paths, dots, rays, ellipses, places, robot. The view stays where the user moved it.
    show(scene) {
      this.scene = scene;
      const named = (scene.places ?? []).map((place) => place.label).filter(Boolean);
      this.canvas.setAttribute("aria-label", ["map of robots and bearings", ...named].join(", "));
      if (!this.moved) this.view = null;
      this.draw();
    }

    // All that is to be seen at the beginning.
    fit(width, height) {
      const points = [
        ...(this.scene.paths ?? []).flatMap((path) => path.points), ...(this.scene.places ?? []).map((place) => place.at),
        ...(this.scene.rays ?? []).map((ray) => ray.from), ...(this.scene.robot ? [this.scene.robot.at] : []),
        ...(this.scene.ellipses ?? []).map(({ centre }) => [centre[0], centre[1]]),
      ].filter((point) => point.every(csi.isNumber));
      const range = (k) => (points.length ? [Math.min(...points.map((p) => p[k])), Math.max(...points.map((p) => p[k]))] : [-1, 1]);
      const [[x0, x1], [y0, y1]] = [range(0), range(1)];
      const room = Math.max(x1 - x0, y1 - y0, 0.5) * 0.3;
      return { x: (x0 + x1) / 2, y: (y0 + y1) / 2, scale: Math.min(width / (x1 - x0 + room), height / (y1 - y0 + room)) };
    }

    draw() {
      const { clientWidth: width, clientHeight: height } = this.canvas;
      if (!this.scene || !width || !height) return;
      this.view ??= this.fit(width, height);
      const ratio = devicePixelRatio;
      [this.canvas.width, this.canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
      const ctx = this.canvas.getContext("2d");
      ctx.scale(ratio, ratio);
      const { x, y, scale } = this.view;
      this.at = ([px, py]) => [width / 2 + (px - x) * scale, height / 2 - (py - y) * scale];
      this.far = (width + height) / scale + Math.hypot(x, y) + 100;
      ctx.font = "12px system-ui, sans-serif";
      this.grid(ctx, width, height);
      const { ellipses = [], paths = [], dots = [], rays = [], places = [], robot } = this.scene;
      rays.forEach((ray) => this.wedge(ctx, ray));
      ellipses.forEach((ellipse) => this.area(ctx, around(ellipse), ellipse.colour, 0.28));
      rays.forEach((ray) => this.ray(ctx, ray));
      for (const { points, colour, width: wide = 2 } of paths) this.line(ctx, points, colour, wide);
      ctx.globalAlpha = 0.8;
      for (const { points, colour } of dots) {
        ctx.fillStyle = csi.colour(colour);
        for (const point of points) { const [px, py] = this.at(point); ctx.fillRect(px - 1.2, py - 1.2, 2.4, 2.4); }
      }
      ctx.globalAlpha = 1;
      places.forEach((place) => this.place(ctx, place, width));
      if (robot) this.robot(ctx, robot);
    }

    grid(ctx, width, height) {
      const size = step(width / this.view.scale, 7);
      const digits = Math.max(0, -Math.floor(Math.log10(size)));
      const { x, y, scale } = this.view;
      ctx.lineWidth = 1;
      ctx.strokeStyle = csi.colour("rule");
      ctx.fillStyle = csi.colour("soft");
      const [left, right] = [x - width / 2 / scale, x + width / 2 / scale];
      const [below, above] = [y - height / 2 / scale, y + height / 2 / scale];
      for (let k = Math.ceil(left / size); k * size < right; k += 1) {
        const [px] = this.at([k * size, 0]);
        this.stroke(ctx, [[px, 0], [px, height]]);
        ctx.fillText((k * size).toFixed(digits), px + 3, height - 5);
      }
      for (let k = Math.ceil(below / size); k * size < above; k += 1) {
        const [, py] = this.at([0, k * size]);
        this.stroke(ctx, [[0, py], [width, py]]);
        if (py < height - 24) ctx.fillText((k * size).toFixed(digits), 3, py - 3);
      }
      ctx.fillText("x, y in m", width - 58, 14);
    }

    stroke(ctx, points) {
      ctx.beginPath();
      points.forEach(([px, py], k) => (k ? ctx.lineTo(px, py) : ctx.moveTo(px, py)));
      ctx.stroke();
    }

    line(ctx, points, colour, width, dash = []) {
      ctx.strokeStyle = csi.colour(colour);
      ctx.lineWidth = width;
      ctx.setLineDash(dash);
      this.stroke(ctx, points.map(this.at));
      ctx.setLineDash([]);
    }

    area(ctx, points, colour, alpha) {
      ctx.fillStyle = csi.faint(csi.colour(colour), alpha);
      ctx.beginPath();
      points.map(this.at).forEach(([px, py], k) => (k ? ctx.lineTo(px, py) : ctx.moveTo(px, py)));
      ctx.closePath();
      ctx.fill();
    }

    // The error bars of 95 and 68 % to each side.
    wedge(ctx, { from, deg, bars = [], colour, quiet }) {
      if (quiet) return;
      for (const [bar, alpha] of [[bars[1], 0.1], [bars[0], 0.18]]) {
        if (!csi.isNumber(bar)) continue;
        const half = Math.min(bar, 180);
        const edge = (k) => {
          const angle = rad(deg - half + (2 * half * k) / 48);
          return [from[0] + this.far * Math.cos(angle), from[1] + this.far * Math.sin(angle)];
        };
        this.area(ctx, [from, ...Array.from({ length: 49 }, (_, k) => edge(k))], colour, alpha);
      }
    }

    ray(ctx, { from, deg, colour, dash, width = 2, quiet }) {
      const to = [from[0] + this.far * Math.cos(rad(deg)), from[1] + this.far * Math.sin(rad(deg))];
      ctx.globalAlpha = quiet ? 0.45 : 1;
      this.line(ctx, [from, to], colour, width, dash);
      ctx.globalAlpha = 1;
    }

    place(ctx, { at, label, colour }, width) {
      const [px, py] = this.at(at);
      ctx.fillStyle = csi.colour(colour);
      ctx.strokeStyle = csi.colour(colour);
      ctx.lineWidth = 1.5;
      ctx.beginPath();
      ctx.arc(px, py, 4, 0, 7);
      ctx.fill();
      ctx.beginPath();
      ctx.arc(px, py, 7.5, 0, 7);
      ctx.stroke();
      const long = ctx.measureText(label).width;
      const left = px + 12 + long > width ? px - 12 - long : px + 12;
      ctx.fillStyle = csi.faint(csi.colour("card"), 0.85);
      ctx.fillRect(left - 2, py - 17, long + 4, 15);
      ctx.fillStyle = csi.colour("ink");
      ctx.fillText(label, left, py - 5);
    }

    robot(ctx, { at, heading_deg: heading }) {
      const [px, py] = this.at(at);
      ctx.save();
      ctx.translate(px, py);
      ctx.rotate(-rad(heading ?? 0));
      ctx.fillStyle = csi.colour("ink");
      ctx.beginPath();
      if (csi.isNumber(heading)) [[11, 0], [-7, 6], [-4, 0], [-7, -6]].forEach(([dx, dy], k) => (k ? ctx.lineTo(dx, dy) : ctx.moveTo(dx, dy)));
      else ctx.arc(0, 0, 6, 0, 7);
      ctx.fill();
      ctx.restore();
    }
  }

  csi.map = (host) => new Map(host);
}
