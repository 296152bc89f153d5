"use strict";
// One link: the answer in words, the map, the profile, the phases, and the logs that it comes from.
{
  const words = ({ row, beside }) => {
    if (row.error) return [csi.el("p", { class: "answer bad" }, row.error)];
    const sd = csi.isNumber(row.azimuth_sd_deg) ? ` ± ${csi.figure(row.azimuth_sd_deg, 1)}°` : "";
    const more = [];
    if (csi.isNumber(row.mirror_deg)) more.push(`or its mirror ${csi.figure(row.mirror_deg, 1)}°`);
    if (csi.isNumber(row.true_from_mean_pose_deg)) more.push(`truth ${csi.figure(row.true_from_mean_pose_deg, 1)}°, error ${csi.figure(row.error_from_mean_pose_deg, 2)}°`);
    if (beside) more.push(`toolbox ${csi.figure(beside.azimuth_deg, 1)}°, error ${csi.figure(beside.error_deg, 2)}°`);
    const facts = [];
    if (csi.isNumber(row.confidence)) facts.push(`within 5° with a probability of ${(100 * row.confidence).toFixed(0)} %`);
    if (csi.isNumber(row.range_m)) facts.push(`range ${csi.figure(row.range_m, 2)} ± ${csi.figure(row.range_sd_m, 2)} m`);
    facts.push(`coherence ${csi.figure(row.coherence, 2)}`, `${csi.count(row.pairs_in_motion, "pair", "pairs")} in motion of ${row.pair_counts.formed}`);
    if (row.geometry) facts.push(`motion: ${row.geometry}`);
    return [
      csi.el("p", { class: "answer" }, `${csi.figure(row.azimuth_deg, 1)}°${sd} `, csi.el("small", {}, more.join("; "))),
      csi.el("p", { class: "soft" }, facts.join("; ")),
    ];
  };

  // The capture's links on one map, this one in front. Places of transmitters are in the frame of motion capture only.
  const scene = ({ number, row, drawn, receiver }, siblings, sameFrame) => {
    const made = { paths: [], dots: [], rays: [], ellipses: [], places: [] };
    if (drawn) {
      made.paths.push({ points: drawn.path_m, colour: "sky", width: 2 });
      made.dots.push({ points: drawn.used_m, colour: "blue" });
    }
    for (const other of siblings) {
      const own = other.number === number;
      const from = other.origin_m ?? other.true_receiver_m ?? [0, 0];
      const name = other.link.split("/").at(-1);
      if (csi.isNumber(other.azimuth_deg)) made.rays.push({ from, deg: other.azimuth_deg, bars: [other.azimuth_sd_deg, other.azimuth_95_deg], colour: own ? "red" : "grey", quiet: !own, width: own ? 2.5 : 1.2 });
      if (own && csi.isNumber(other.mirror_deg)) made.rays.push({ from, deg: other.mirror_deg, colour: "grey", dash: [7, 5], width: 1.5 });
      if (own && csi.isNumber(other.true_from_mean_pose_deg)) made.rays.unshift({ from, deg: other.true_from_mean_pose_deg, colour: "green", width: 5, quiet: true });
      if (sameFrame && other.true_transmitter_m) made.places.push({ at: other.true_transmitter_m, label: name, colour: own ? "green" : "soft" });
      if (other.position_m && other.position_covariance_m2) {
        const [[a, b], [c, d]] = other.position_covariance_m2;
        made.ellipses.push({ centre: other.position_m, covariance: [[a, b], [c, d]], colour: own ? "red" : "grey" });
      }
    }
    if (sameFrame && receiver?.position_m && receiver.covariance_m2) made.ellipses.push({ centre: receiver.position_m, covariance: receiver.covariance_m2, colour: "purple" });
    return made;
  };

  const mapKey = ({ row, receiver }, sameFrame) => {
    const entries = [["sky", "path of the receiver"], ["red", "bearing, error bar 68 % and 95 %"]];
    if (csi.isNumber(row.mirror_deg)) entries.push(["grey", "mirror", "dash"]);
    if (csi.isNumber(row.true_from_mean_pose_deg)) entries.push(["green", "truth"]);
    if (row.position_m) entries.push(["red", "ellipse: position, 95 %", "area"]);
    if (sameFrame && receiver?.position_m) entries.push(["purple", `receiver located${csi.isNumber(receiver.off_m) ? `, ${csi.figure(receiver.off_m, 2)} m off` : ""}`]);
    return csi.keyOf(...entries);
  };

  const card = (title, wide, ...children) => csi.el("section", { class: wide ? "card wide" : "card" }, csi.el("h3", {}, title), ...children);

  const logCard = ({ logs, row }, keep) => {
    const host = csi.el("div");
    const choice = csi.el("div", { class: "tools", role: "group", "aria-label": "log" });
    const known = [["the receiver's log", logs.receiver], ["the transmitter's log", logs.transmitter]].filter(([, number]) => number !== null);
    const show = (number) => {
      [...choice.children].forEach((button, k) => button.setAttribute("aria-pressed", String(known[k][1] === number)));
      host.replaceChildren();
      keep.panel = csi.showLog(host, number);
    };
    known.forEach(([name, number]) => choice.append(csi.button(name, name, () => show(number))));
    const section = card("Log", true, known.length ? choice : csi.el("p", { class: "soft" }, "its log is not here"), host);
    const counts = csi.el("p", { class: "soft" }, [["receiver", row.receiver_records], ["transmitter", row.transmitter_records]]
      .filter(([, side]) => side?.handed).map(([name, side]) => `${name}: ${side.paired} of ${csi.count(side.handed, "record", "records")} found their partner, ${csi.count(side.missing, "frame number", "frame numbers")} not heard, ${side.duplicates} reported twice`).join("; "));
    section.insertBefore(counts, host);
    return { section, begin: () => known.length && show(known[0][1]) };
  };

  // Shows a link; `keep` holds the panel of its log, which keys move.
  csi.showLink = (host, link, { siblings, sameFrame, keep }) => {
    const { row, drawn } = link;
    host.replaceChildren(csi.el("h2", {}, row.link), ...words(link));
    const cards = host.appendChild(csi.el("div", { class: "cards" }));
    const logs = logCard(link, keep);
    if (!drawn) {
      cards.append(logs.section);
      return logs.begin();
    }
    const map = card("Map", false);
    const profile = card("Where the signal comes from", false);
    const phases = card("Phase at the channel centre", true);
    cards.append(map, profile, phases, logs.section);
    csi.map(map).show(scene(link, siblings, sameFrame));
    map.append(mapKey(link, sameFrame));
    csi.showProfile(profile, link);
    profile.append(csi.candidateTable(row));
    csi.showPhases(phases, drawn);
    return logs.begin();
  };
}
