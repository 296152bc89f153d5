"use strict";
// Light and dark, and colours. Lines have those of Okabe and Ito (2008), lighter where the page is dark.
{
  const root = document.documentElement;
  const system = matchMedia("(prefers-color-scheme: dark)");
  let listeners = [];
  // What is no longer on the page is forgotten.
  const tell = () => {
    listeners = listeners.filter(({ owner }) => owner.isConnected);
    listeners.forEach(({ call }) => call());
  };
  const stored = () => { try { return localStorage.getItem("csi5300-theme"); } catch { return null; } };
  const apply = () => {
    root.dataset.theme = stored() ?? (system.matches ? "dark" : "light");
    tell();
  };
  // Calls whenever light turns to dark, for as long as the owner is on the page.
  csi.onTheme = (owner, call) => {
    listeners = listeners.filter((other) => other.owner.isConnected);
    listeners.push({ owner, call });
  };
  csi.turnTheme = () => {
    const other = root.dataset.theme === "dark" ? "light" : "dark";
    try { localStorage.setItem("csi5300-theme", other); } catch { /* A file may keep nothing. */ }
    root.dataset.theme = other;
    tell();
  };
  system.addEventListener("change", apply);
  apply();

  csi.colour = (name) => getComputedStyle(root).getPropertyValue(`--${name}`).trim();
  const SERIES = ["blue", "orange", "green", "purple", "red", "sky", "grey"];
  csi.seriesName = (k) => SERIES[k % SERIES.length];
  csi.series = (k) => csi.colour(csi.seriesName(k));
  csi.antennaName = (letter) => csi.seriesName(letter.charCodeAt(0) - 65);
  csi.antennaColour = (letter) => csi.colour(csi.antennaName(letter));

  // The colour with an alpha, for areas.
  csi.faint = (colour, alpha) => {
    const parts = /^#(..)(..)(..)$/.exec(colour);
    return parts ? `rgba(${parts.slice(1).map((part) => parseInt(part, 16)).join(",")},${alpha})` : colour;
  };

  // Viridis (van der Walt and Smith), as the polynomial of degree 6 that fits it within a hundredth.
  const VIRIDIS = [
    [0.2777273, 0.0054073, 0.3340998], [0.1050930, 1.4046136, 1.3845902], [-0.3308618, 0.2148476, 0.0950951],
    [-4.6342305, -5.7991010, -19.3324410], [6.2282699, 14.1799334, 56.6905526],
    [4.7763850, -13.7451454, -65.3530326], [-5.4354559, 4.6458526, 26.3124352],
  ];
  const viridis = (share) => [0, 1, 2].map((k) => {
    const value = VIRIDIS.reduceRight((sum, term) => sum * share + term[k], 0);
    return Math.round(255 * Math.min(1, Math.max(0, value)));
  });
  // A colour for each angle, the same at both ends of the range.
  const circular = (share) => [0.5, 0.83, 0.17].map((shift) => Math.round(127.5 + 100 * Math.cos(2 * Math.PI * (share + shift))));
  const table = (colour) => Array.from({ length: 255 }, (_, k) => colour(k / 254));
  csi.shades = { amplitude_db: table(viridis), phase_rad: table(circular) };
}
