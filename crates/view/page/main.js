"use strict";
// The whole page: what is shown, its address (#link=3, #log=0), what the server tells, and the keys.
{
  const byId = (id) => document.getElementById(id);
  const [list, shown, state] = [byId("list"), byId("shown"), byId("state")];
  const page = { overview: null, events: null, table: null, rows: new Map(), known: 0, link: null, waits: false, keep: { panel: null } };

  const failed = (error) => shown.replaceChildren(csi.el("p", { class: "bad" }, String(error.message ?? error)));

  const go = (address) => { location.hash = address; };
  const address = () => /^#(link|log)=(\d+)$/.exec(location.hash);

  // What the address names; without one all links, or the only log.
  const show = async () => {
    const [, kind, text] = address() ?? [];
    const number = Number(text);
    page.keep.panel = null;
    page.link = null;
    if (kind === "link" && page.table) return showLink(number);
    if (kind === "log" || page.overview.kind === "logs") return showLog(kind ? number : 0);
    page.table?.choose(null);
    return showAll();
  };

  const showLog = (number) => {
    const log = page.overview.logs[number];
    if (!log) return failed(new Error("there is no such log"));
    for (const line of list.querySelectorAll("[data-log]")) line.setAttribute("aria-selected", String(Number(line.dataset.log) === number));
    const host = csi.el("div");
    shown.replaceChildren(csi.el("h2", {}, log.name), csi.el("section", { class: "card" }, host));
    page.keep.panel = csi.showLog(host, number);
    page.log = number;
  };

  const showLink = async (number) => {
    page.link = number;
    page.table.choose(number);
    const link = await csi.get(`/data/link/${number}`);
    if (page.link !== number) return;
    page.waits = link.waiting === true;
    if (page.waits) {
      // What is there at once: the log that the receiver wrote.
      const log = csi.el("section", { class: "card wide" }, csi.el("h3", {}, "Log"));
      shown.replaceChildren(csi.el("h2", {}, page.overview.links[number] ?? ""), csi.el("p", { class: "soft" }, "its capture is evaluated next…"), log);
      if (csi.isNumber(link.logs?.receiver)) page.keep.panel = csi.showLog(log, link.logs.receiver);
      return;
    }
    const capture = link.row.link.slice(0, link.row.link.lastIndexOf("/"));
    const siblings = [...page.rows.values()].filter((row) => row.link.slice(0, row.link.lastIndexOf("/")) === capture);
    shown.scrollTop = 0;
    csi.showLink(shown, link, { siblings, sameFrame: page.overview.trajectory === "ground_truth", keep: page.keep });
  };

  const showAll = async () => {
    const sets = await csi.get("/data/sets");
    if (page.link !== null || address()) return;
    const rows = [...page.rows.values()];
    const judged = !rows.length || rows.some((row) => csi.isNumber(row.error_from_mean_pose_deg) || row.beside);
    const chart = judged ? csi.el("section", { class: "card wide" }, csi.el("h3", {}, "Errors by set")) : null;
    const title = judged ? "Absolute errors against the bearing from the mean pose, degrees" : "Links by set (no errors: the transmitters' places are unknown)";
    const table = csi.el("section", { class: "card wide" }, csi.el("h3", {}, title), csi.setTable(sets, judged));
    shown.replaceChildren(csi.el("h2", {}, "All links"), csi.el("div", { class: "cards" }, ...(chart ? [chart] : []), table));
    if (chart) csi.showErrors(chart, rows);
    if (page.notes?.length) {
      shown.append(csi.el("section", { class: "card" }, csi.el("h3", {}, "Lost or left out"), csi.el("ul", { class: "notes bad" }, ...page.notes.map((note) => csi.el("li", {}, note)))));
    }
    shown.append(csi.el("p", { class: "soft" }, "Click a link in the table to show it, or a heading to sort. ? lists the keys."));
  };

  const showAllLater = csi.seldom(1000, () => { if (page.link === null && !address()) showAll().catch(failed); });

  // Rows that came since the last time.
  const fetchRows = csi.seldom(150, async () => {
    try {
      const { known, of, rows, notes } = await csi.get("/data/rows", `known=${page.known}`);
      page.known = known;
      page.notes = notes;
      rows.forEach((row) => page.rows.set(row.number, row));
      page.table.add(rows);
      state.textContent = known < of ? `${known} of ${csi.count(of, "link", "links")} evaluated` : `${csi.count(of, "link", "links")}`;
      if (page.waits && page.rows.has(page.link)) await showLink(page.link);
      else showAllLater();
      // A browser has six connections to a server, for all its tabs: one that brings nothing more is closed.
      if (known >= of) page.events?.close();
    } catch (error) {
      state.textContent = String(error.message ?? error);
    }
  });

  const listLogs = () => {
    const lines = page.overview.logs.map((log, number) => csi.el("tr", { "data-log": number, onclick: () => go(`log=${number}`) },
      csi.el("td", {}, log.name), csi.el("td", {}, csi.isNumber(log.bytes) ? csi.size(log.bytes) : "–")));
    list.append(csi.el("table", {}, csi.el("thead", {}, csi.el("tr", {}, csi.el("th", {}, "log"), csi.el("th", {}, "size"))), csi.el("tbody", {}, ...lines)));
  };

  const listen = (live) => {
    const events = new EventSource("/events");
    page.events = events;
    const silent = () => { if (events.readyState === EventSource.OPEN) state.textContent = "no word from the node: it ended, or hangs"; };
    // A node tells its state twice a second.
    const silentLater = csi.later(3000, silent);
    if (live) silentLater();
    events.addEventListener("rows", () => { if (page.table) fetchRows(); });
    events.addEventListener("state", (event) => {
      state.textContent = "live";
      silentLater();
      live?.add([JSON.parse(event.data)]);
    });
    events.addEventListener("silent", silent);
    events.addEventListener("open", () => { if (page.table) fetchRows(); });
    events.onerror = () => { state.textContent = events.readyState === EventSource.CLOSED ? "too many pages are open: close one and load this one again" : csi.ENDED; };
  };

  const move = (by) => {
    if (page.table) return page.table.next(by);
    const last = page.overview.logs.length - 1;
    if (last > 0) go(`log=${Math.min(last, Math.max(0, (page.log ?? 0) + by))}`);
    return undefined;
  };

  const KEYS = {
    ArrowUp: () => move(-1), ArrowDown: () => move(1), k: () => move(-1), j: () => move(1),
    ArrowLeft: () => page.keep.panel?.stretch?.move(-0.25), ArrowRight: () => page.keep.panel?.stretch?.move(0.25),
    "+": () => page.keep.panel?.stretch?.zoom(0.5), "=": () => page.keep.panel?.stretch?.zoom(0.5), "-": () => page.keep.panel?.stretch?.zoom(2),
    0: () => { const own = page.keep.panel?.stretch; own?.set(...own.whole); },
    "/": () => page.table?.search.focus(), a: () => page.keep.panel?.turn?.(), t: () => csi.turnTheme(),
    "?": () => byId("keys").showModal(), Escape: () => go(""),
  };

  const key = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || byId("keys").open) return;
    const typing = event.target.closest?.("input, select");
    if (typing) {
      if (event.key === "Escape" || event.key === "Enter") typing.blur();
      return;
    }
    const act = KEYS[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  };

  const begin = async () => {
    byId("theme").addEventListener("click", csi.turnTheme);
    byId("help").addEventListener("click", KEYS["?"]);
    document.addEventListener("keydown", key);
    page.overview = await csi.get("/data/overview");
    const { kind, name, program, links, has_beside: beside, logs } = page.overview;
    byId("name").textContent = name;
    byId("name").title = program;
    document.title = `${name}: csi5300`;
    let live = null;
    byId("main").classList.toggle("alone", kind === "node" || (kind === "logs" && logs.length === 1));
    if (kind === "node") {
      live = csi.live(shown);
      live.add(await csi.get("/data/states"));
      return listen(live);
    }
    addEventListener("hashchange", () => show().catch(failed));
    if (kind === "captures") {
      page.table = csi.linkTable(list, { names: links, beside, open: (number) => go(`link=${number}`) });
      fetchRows();
    } else {
      listLogs();
      state.textContent = csi.count(logs.length, "log", "logs");
    }
    if (kind === "captures" && !csi.answers) listen(live);
    return show();
  };
  begin().catch(failed);
}
