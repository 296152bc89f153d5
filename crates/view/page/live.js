"use strict";
// A running node: its peers with their bearings, a map of where it drove, and what its rates and bearings were.
{
  const POINTS = 1200;
  const at = (state, path) => path.split("/").reduce((value, name) => value?.[name], state);

  const words = (state) => {
    const lost = (state.losses ?? 0) + (at(state, "log/dropped") ?? 0) + (at(state, "log/lost_on_disk") ?? 0);
    return [
      `up ${csi.figure(state.uptime_s, 0)} s`, `${csi.figure(state.records_hz, 0)} records/s (${(state.records ?? 0).toLocaleString("en")} in all)`,
      `${csi.count(lost, "loss", "losses")}, ${csi.count(state.missing ?? 0, "number", "numbers")} missing`, `${csi.figure(state.poses_hz, 0)} poses/s`,
      `${csi.figure(at(state, "load/cpu_percent"), 0)} % of a core, ${csi.figure(at(state, "load/memory_mib"), 0)} MiB`,
    ].join("; ");
  };

  const bearing = (report) => {
    if (!csi.isNumber(report?.azimuth_deg)) return report?.words ?? "nothing yet";
    const mirror = csi.isNumber(report.mirror_deg) ? ` or ${csi.figure(report.mirror_deg, 1)}°` : "";
    return `${csi.figure(report.azimuth_deg, 1)}° ± ${csi.figure(report.azimuth_sd_deg, 1)}°${mirror}`;
  };

  // From the frame of the odometry into that of the team.
  const into = ([left, up, yaw]) => ([x, y]) => [left + Math.cos(yaw) * x - Math.sin(yaw) * y, up + Math.sin(yaw) * x + Math.cos(yaw) * y];

  // Ellipses and names of the team's robots, in the colours of their bearings.
  const team = ({ robots }, peers) => {
    const colours = robots.map(({ name }, k) => (k ? csi.seriesName(Math.max(0, peers.findIndex((peer) => peer.name === name))) : "grey"));
    const ellipses = robots.map(({ position_m: centre, covariance: [[a, b], [c, d]] }, k) => ({ centre, covariance: [[a, b], [c, d]], colour: colours[k] }));
    const named = robots.map(({ name, position_m: at }, k) => ({ at, label: name, colour: colours[k] })).slice(1);
    const others = robots.flatMap(({ name, others_m: all }, k) => all.map((at) => ({ at, label: `${name}?`, colour: colours[k] })));
    return { ellipses, places: [...named, ...others] };
  };

  class Live {
    constructor(host) {
      this.states = [];
      this.words = csi.el("p", { class: "soft" });
      this.trouble = csi.el("ul", { class: "notes bad" });
      this.peers = csi.el("tbody");
      const heads = ["peer", "bearing", "prob.", "range", "pairs/s", "losses", "coherence", "moved", "age"];
      const table = csi.el("table", {}, csi.el("thead", {}, csi.el("tr", {}, ...heads.map((name) => csi.el("th", {}, name)))), this.peers);
      this.title = csi.el("h2", {}, "");
      const card = (title, wide, ...children) => csi.el("section", { class: wide ? "card wide" : "card" }, csi.el("h3", {}, title), ...children);
      const [map, lines] = [card("Map", false), card("Over time", false)];
      host.replaceChildren(this.title, this.words, this.trouble, csi.el("div", { class: "cards" },
        card("Peers", true, csi.el("div", { class: "scroll" }, table)), map, lines));
      this.map = csi.map(map);
      map.append(csi.keyOf(["sky", "where the robot was"], [csi.seriesName(0), "bearings in each peer's colour, error bars 68 % and 95 %, ellipses 95 %"]));
      this.notes = map.appendChild(csi.el("p", { class: "soft" }));
      this.lines = lines;
      this.show = csi.seldom(150, () => this.draw());
    }

    add(states) {
      this.states.push(...states);
      this.states.splice(0, Math.max(0, this.states.length - POINTS));
      this.show();
    }

    draw() {
      const state = this.states.at(-1);
      if (!state) return;
      this.title.textContent = state.name || "node";
      this.words.textContent = words(state);
      this.trouble.replaceChildren(...(state.trouble ?? []).map((text) => csi.el("li", {}, text)));
      this.peers.replaceChildren(...(state.peers ?? []).map((peer, k) => this.peer(peer, k)));
      this.drawMap(state);
      this.drawLines(state);
    }

    peer(peer, k) {
      const report = peer.report ?? {};
      const held = report.state === "held";
      const losses = peer.counts?.losses;
      const name = csi.el("td", {}, `● ${peer.name}`);
      name.style.color = `var(--${csi.seriesName(k)})`;
      const cells = [
        bearing(report), csi.figure(report.confidence, 2), csi.figure(report.range_m, 1, " m"), csi.figure(peer.pairs_hz, 0),
        csi.isNumber(losses) ? String(losses) : "–", csi.figure(report.coherence, 2), csi.figure(report.moved_m, 2, " m"), csi.isNumber(report.age_s) ? csi.figure(report.age_s, 0, " s") : "",
      ];
      return csi.el("tr", {}, name, ...cells.map((text) => csi.el("td", { class: held ? "soft" : "" }, text)));
    }

    drawMap(state) {
      const solved = state.team?.solved ? state.team : null;
      const frame = solved?.odometry ?? [0, 0, 0];
      const turned = (frame[2] * 180) / Math.PI;
      const places = this.states.map((other) => at(other, "pose/1")).filter(Boolean).map(into(frame));
      const here = at(state, "pose/1");
      this.notes.textContent = (state.team?.notes ?? []).join("; ");
      if (!here) return;
      const rays = (state.peers ?? []).flatMap((peer, k) => {
        const report = peer.report ?? {};
        const colour = csi.seriesName(k);
        // A bearing is seen from the middle of its motion, where the robot no longer is.
        const from = into(frame)(report.origin_m ?? here);
        const own = csi.isNumber(report.azimuth_deg) ? [{ from, deg: report.azimuth_deg + turned, bars: [report.azimuth_sd_deg, report.azimuth_95_deg], colour }] : [];
        return csi.isNumber(report.mirror_deg) ? [...own, { from, deg: report.mirror_deg + turned, colour, dash: [6, 5], width: 1.2 }] : own;
      });
      // A peer in the team's graph has its ellipse from there, not from its last bearing alone.
      const known = solved ? team(solved, state.peers ?? []) : { ellipses: [], places: [] };
      const ellipses = (state.peers ?? []).flatMap(({ name, report }, k) => {
        if (!report?.position_m || !report.position_covariance_m2 || solved?.frame || solved?.robots.some((robot) => robot.name === name)) return [];
        const [[a, b], [c, d]] = report.position_covariance_m2;
        return [{ centre: report.position_m, covariance: [[a, b], [c, d]], colour: csi.seriesName(k) }];
      });
      const robot = { at: into(frame)(here), heading_deg: csi.isNumber(state.pose[2]) ? state.pose[2] + turned : null };
      this.map.show({ paths: [{ points: places, colour: "sky" }], rays, ellipses: [...known.ellipses, ...ellipses], places: known.places, robot });
    }

    // Rates and azimuths; charts are made anew when peers come.
    drawLines(state) {
      const names = (state.peers ?? []).map((peer) => peer.name);
      const series = names.map((_, k) => ({ stroke: () => csi.series(k), width: 1.6, points: { show: false } }));
      if (this.drawn !== names.join()) {
        this.drawn = names.join();
        this.lines.replaceChildren(csi.el("h3", {}, "Over time"));
        const options = (height, y, own, scale = {}) => ({
          height, x: {}, y, data: [[0], ...own.map(() => [null])],
          options: { scales: { x: { time: false }, y: scale }, series: [{}, ...own], cursor: { sync: { key: "live" }, y: false } },
        });
        const dots = names.map((_, k) => ({ stroke: () => csi.series(k), paths: () => null, points: { show: true, size: 4, width: 0, fill: () => csi.series(k) } }));
        const total = [{ stroke: () => csi.colour("ink"), width: 1.6, points: { show: false } }, ...series];
        const upward = { range: (_, low, high) => [0, Math.max(1, high * 1.1)] };
        this.rates = csi.chart(this.lines, options(150, { name: "records/s (dark) and pairs/s of each peer, over the node's time (s)" }, total, upward)).plot;
        this.azimuths = csi.chart(this.lines, options(170, { name: "azimuth of each peer (degrees)" }, dots, { range: (_, low, high) => (csi.isNumber(low) ? [Math.max(-180, low - 8), Math.min(180, high + 8)] : [-180, 180]) })).plot;
        this.lines.append(csi.keyOf(...names.map((name, k) => [csi.seriesName(k), name])));
      }
      const times = this.states.map((other) => other.uptime_s);
      const of = (k, path) => this.states.map((other) => at(other, `peers/${k}/${path}`) ?? null);
      this.rates.setData([times, this.states.map((other) => other.records_hz ?? null), ...names.map((_, k) => of(k, "pairs_hz"))]);
      this.azimuths.setData([times, ...names.map((_, k) => of(k, "report/azimuth_deg"))]);
    }
  }

  csi.live = (host) => new Live(host);
}
