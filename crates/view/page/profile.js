"use strict";
// What an answer was chosen from: power over azimuth, with the answer, its error bar, its mirror, the candidates and the truth.
{
  // The height of a curve at an azimuth, between its two nearest points.
  const height = ({ azimuths_deg: azimuths, values }, deg) => {
    const after = azimuths.findIndex((azimuth) => azimuth >= deg);
    if (after <= 0) return values[after === 0 ? 0 : values.length - 1] ?? 0;
    const share = (deg - azimuths[after - 1]) / (azimuths[after] - azimuths[after - 1] || 1);
    return values[after - 1] + share * (values[after] - values[after - 1]);
  };

  const marks = (plot, row, curve) => csi.clipped(plot, (ctx, bbox, x, y) => {
    const truth = row.true_from_mean_pose_deg;
    if (csi.isNumber(truth)) csi.vertical(ctx, bbox, x(truth), csi.faint(csi.colour("green"), 0.65), 5);
    if (csi.isNumber(row.mirror_deg)) csi.vertical(ctx, bbox, x(row.mirror_deg), csi.colour("grey"), 2, [6, 5]);
    if (!csi.isNumber(row.azimuth_deg)) return;
    for (const [bar, alpha] of [[row.azimuth_95_deg, 0.1], [row.azimuth_sd_deg, 0.2]]) {
      if (!csi.isNumber(bar)) continue;
      ctx.fillStyle = csi.faint(csi.colour("red"), alpha);
      // Around the end of the axis a bar goes on at the other; it is no longer than once around.
      const half = Math.min(bar, 180);
      for (const turn of [-360, 0, 360]) {
        const [left, right] = [row.azimuth_deg - half + turn, row.azimuth_deg + half + turn];
        ctx.fillRect(x(left), bbox.top, Math.max(1, x(right) - x(left)), bbox.height);
      }
    }
    csi.vertical(ctx, bbox, x(row.azimuth_deg), csi.colour("red"), 2);
    const ratio = devicePixelRatio;
    ctx.font = `${12 * ratio}px system-ui, sans-serif`;
    ctx.textAlign = "center";
    (row.candidates ?? []).forEach(({ azimuth_deg: azimuth }, k) => {
      const [px, py] = [x(azimuth), y(height(curve, azimuth))];
      ctx.strokeStyle = ctx.fillStyle = csi.colour("ink");
      ctx.lineWidth = 1.5 * ratio;
      ctx.beginPath();
      ctx.arc(px, py, 5 * ratio, 0, 7);
      ctx.stroke();
      ctx.fillText(String(k + 1), px + 12 * ratio, py + 4 * ratio);
    });
  });

  // Curves have azimuths of their own: one axis for all of them.
  const joined = (curves) => {
    const tables = curves.map((curve) => [curve.azimuths_deg, curve.values]);
    return tables.length === 1 ? tables[0] : uPlot.join(tables);
  };

  csi.showProfile = (host, { row, drawn }) => {
    const { curves } = drawn;
    if (!curves.length) return;
    let range = [-180, 180];
    const readout = csi.el("span", { class: "readout" });
    const point = ({ cursor, posToVal }) => {
      const deg = cursor.left >= 0 ? posToVal(cursor.left, "x") : null;
      readout.textContent = deg === null ? "" : `${deg.toFixed(1)}°: ${height(curves[0], deg).toFixed(3)}`;
    };
    const { plot } = csi.chart(host, {
      height: 230, x: {}, y: { name: "azimuth (degrees); each curve relative to its own highest value" },
      options: {
        scales: { x: { time: false, range: (_, low, high) => (csi.isNumber(low) && high > low ? [low, high] : range) }, y: { range: [0, 1.12] } },
        cursor: { points: { show: false }, y: false },
        series: [{}, ...curves.map((_, k) => ({ stroke: () => csi.colour(k ? "purple" : "blue"), width: k ? 1 : 2.2, spanGaps: true, points: { show: false } }))],
        hooks: { draw: [(own) => marks(own, row, curves[0])], setCursor: [point] },
      },
      data: joined(curves),
    });
    const look = (from, to) => { range = [from, to]; plot.setScale("x", { min: from, max: to }); };
    plot.over.addEventListener("dblclick", () => look(-180, 180));
    const near = Math.min(60, Math.max(8, 4 * (row.azimuth_sd_deg ?? 5), 1.4 * Math.abs(row.error_from_mean_pose_deg ?? 0)));
    host.append(csi.el("div", { class: "tools" },
      csi.button("all around", "from -180 to 180 degrees", () => look(-180, 180)),
      csi.button("near the answer", "the answer and its error bar", () => look(row.azimuth_deg - near, row.azimuth_deg + near)),
      readout));
    look(-180, 180);
    const entries = [["red", `answer ${csi.figure(row.azimuth_deg, 2)}° ± ${csi.figure(row.azimuth_sd_deg, 2)}° (68 %), ± ${csi.figure(row.azimuth_95_deg, 2)}° (95 %)`]];
    if (csi.isNumber(row.mirror_deg)) entries.push(["grey", `mirror ${csi.figure(row.mirror_deg, 2)}°`, "dash"]);
    if (csi.isNumber(row.true_from_mean_pose_deg)) entries.push(["green", `truth ${csi.figure(row.true_from_mean_pose_deg, 2)}°`]);
    curves.forEach(({ name }, k) => entries.push([k ? "purple" : "blue", name]));
    host.append(csi.keyOf(...entries));
  };

  csi.candidateTable = ({ candidates = [] }) => {
    if (!candidates.length) return csi.el("p", { class: "soft" }, "no candidates");
    const head = ["", "azimuth", "elevation", "range", "probability share"];
    const cells = (own, k) => [
      String(k + 1), csi.figure(own.azimuth_deg, 1, "°"),
      csi.isNumber(own.elevation_deg) ? csi.figure(own.elevation_deg, 1, "°") : `±${csi.figure(own.abs_elevation_deg, 1)}°`,
      csi.figure(own.range_m, 1, " m"),
      csi.isNumber(own.share) ? `${(100 * own.share).toFixed(0)} %` : "–",
    ];
    const body = candidates.map((own, k) => csi.el("tr", {}, ...cells(own, k).map((text) => csi.el("td", {}, text))));
    return csi.el("div", { class: "scroll" }, csi.el("table", {},
      csi.el("thead", {}, csi.el("tr", {}, ...head.map((text) => csi.el("th", {}, text)))), csi.el("tbody", {}, ...body)));
  };

  // Phases at the channel centre over time, a point a pair.
  csi.showPhases = (host, { phases }) => {
    const tracks = [
      ["one direction", "orange", phases.t_s, phases.one_way_rad], ["both multiplied", "purple", phases.t_s, phases.round_trip_rad],
      ["and the turn-around removed", "blue", phases.t_s, phases.compensated_rad],
      ["and the motion taken out", "green", phases.left_t_s, phases.left_rad],
    ];
    const wrapped = (rad) => Math.atan2(Math.sin(rad), Math.cos(rad));
    let chosen = 2;
    const place = csi.el("div");
    const choice = csi.el("div", { class: "tools", role: "group", "aria-label": "phase" });
    const known = tracks.filter(([, , times]) => times.length);
    if (!known.length) return;
    host.append(choice, place);
    const draw = () => {
      const [, colour, times, values] = tracks[chosen];
      [...choice.children].forEach((button, k) => button.setAttribute("aria-pressed", String(k === chosen)));
      place.replaceChildren();
      csi.chart(place, {
        height: 170, x: {}, y: { name: "phase (radians) over time (s)" },
        options: {
          scales: { x: { time: false }, y: { range: [-Math.PI, Math.PI] } }, cursor: { show: true, y: false },
          series: [{}, { stroke: () => csi.colour(colour), paths: () => null, points: { show: true, size: 3, width: 0, fill: () => csi.colour(colour) } }],
        },
        data: [times, values.map(wrapped)],
      });
    };
    tracks.forEach(([words], k) => choice.append(csi.button(words, words, () => { chosen = k; draw(); })));
    draw();
  };
}
