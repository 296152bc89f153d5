"use strict";
// Helpers of all other parts: elements, numbers, questions to the server or to the answers in this file.
const csi = {};
{
  const inFile = document.getElementById("answers");
  // In a page that is one file all answers are in it; a stretch of a log is then the whole log.
  csi.answers = inFile ? JSON.parse(inFile.textContent) : null;

  csi.ENDED = "no word from csi5300: it ended";
  csi.get = async (path, query = "") => {
    if (csi.answers) {
      if (path in csi.answers) return csi.answers[path];
      throw new Error("this is not in the file: `csi5300 view` on the captures has it");
    }
    const response = await fetch(query ? `${path}?${query}` : path).catch(() => { throw new Error(csi.ENDED); });
    if (!response.ok) throw new Error((await response.text()).trim());
    return response.json();
  };

  // An element with properties, listeners (on...) and children; strings become text, never markup.
  csi.el = (tag, properties = {}, ...children) => {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(properties)) {
      if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
      else if (name === "class") element.className = value;
      else if (value !== undefined && value !== false) element.setAttribute(name, value === true ? "" : value);
    }
    element.append(...children.filter((child) => child !== null && child !== undefined));
    return element;
  };

  csi.isNumber = (value) => typeof value === "number" && Number.isFinite(value);
  csi.figure = (value, digits = 1, unit = "") => {
    if (!csi.isNumber(value)) return "–";
    const text = value.toFixed(digits);
    return (Number(text) === 0 ? (0).toFixed(digits) : text) + unit;
  };
  csi.wrapDeg = (deg) => ((((deg + 180) % 360) + 360) % 360) - 180;
  csi.count = (value, one, many) => `${value.toLocaleString("en")} ${value === 1 ? one : many}`;
  csi.size = (bytes) => (bytes >= 1e6 ? `${(bytes / 1e6).toFixed(1)} MB` : `${Math.ceil(bytes / 1e3)} kB`);

  // Calls once, a while after the last time that it was asked to.
  csi.later = (wait, call) => {
    let timer = 0;
    return (...values) => {
      clearTimeout(timer);
      timer = setTimeout(() => call(...values), wait);
    };
  };

  // Calls at once, and at most once in a while.
  csi.seldom = (wait, call) => {
    let [last, timer] = [-Infinity, 0];
    return () => {
      clearTimeout(timer);
      const left = wait - (performance.now() - last);
      if (left <= 0) {
        last = performance.now();
        call();
      } else timer = setTimeout(() => { last = performance.now(); call(); }, left);
    };
  };

  csi.bytes = (base64) => Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));

  csi.button = (words, title, onclick, more = {}) => csi.el("button", { type: "button", title, onclick, ...more }, words);

  // What a line or a mark of a colour means; colours by their names, so that they follow light and dark. How it looks, where that
  // is no line: dash, area, tick.
  csi.keyOf = (...entries) => {
    const key = csi.el("div", { class: "key" });
    for (const [colour, words, look] of entries) {
      const entry = csi.el("span", { class: look }, words);
      entry.style.setProperty("--swatch", `var(--${colour})`);
      key.append(entry);
    }
    return key;
  };
}
