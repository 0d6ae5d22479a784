// Colours, fonts, and the layout that figures of plotly.js share.

// Colours of the page in a light and in a dark scheme; outcomes and limbs keep their own in both. Text has a
// contrast of at least 4.5 : 1 against what is behind it.
const SCHEMES = {
  light: { paper: "#fff", ink: "#1d2125", faint: "#5c636b", grid: "#eee", axis: "#888", edge: "#333", mark: "#000", halo: "#fff",
    bar: "#f1f2f4", trail: "rgba(90,95,105,.35)", dot: "rgba(0,0,0,.5)", hatch: "#888",
    body: "#DDE0E4", near: "#BFC4CC", bone: "#4A4F57", strip: "#F1EEE8", tick: "#CFC9BE", length: "#6B665B" },
  dark: { paper: "#14181c", ink: "#e6e9ed", faint: "#a7afb8", grid: "#2a3036", axis: "#8b939c", edge: "#d5dade", mark: "#fff", halo: "#000",
    bar: "#262c32", trail: "rgba(170,178,188,.4)", dot: "rgba(0,0,0,.6)", hatch: "#3c4148",
    body: "#39414a", near: "#525c67", bone: "#b4bcc5", strip: "#20252a", tick: "#454d55", length: "#a7afb8" },
};
const darkness = matchMedia("(prefers-color-scheme: dark)");
let shade = SCHEMES[darkness.matches ? "dark" : "light"];

const FONT = "system-ui, -apple-system, Segoe UI, Roboto, DejaVu Sans, sans-serif";

/** The channels of a colour #rrggbb, from 0 to 255. */
const channelsOf = colour => [1, 3, 5].map(k => parseInt(colour.slice(k, k + 2), 16));

/** The luminance of a colour #rrggbb, from 0 to 1 (WCAG 2.2, relative luminance). */
function luminance(colour) {
  const linear = channelsOf(colour).map(channel => channel / 255).map(c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
  return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
}

/** A colour of a figure; in a dark scheme one that is nearly black is lighter, 3 : 1 against the paper. */
function visible(colour) {
  if (shade !== SCHEMES.dark) return colour;
  const behind = luminance(shade.paper) + 0.05, channels = channelsOf(colour);
  let lighter = colour;
  for (let white = 0; (luminance(lighter) + 0.05) / behind < 3; white += 0.05)
    lighter = "#" + channels.map(c => Math.round(c + white * (255 - c)).toString(16).padStart(2, "0")).join("");
  return lighter;
}

/** A limb's colour; that of the ink instead of black, which limbs have that are all alike. */
const limbColour = limb => limb.colour === "#000000" ? shade.mark : visible(limb.colour);

/** A small square in the colour of an outcome. */
function chip(outcome) {
  const span = document.createElement("span");
  span.className = `chip${outcome.hollow ? " hollow" : ""}${outcome.hatched ? " hatched" : ""}`;
  span.style.backgroundColor = visible(outcome.colour);
  if (outcome.hollow) span.style.borderColor = visible(outcome.colour);
  return span;
}

const SYMBOLS = { "o": "circle", "s": "square", "^": "triangle-up", "D": "diamond", "v": "triangle-down",
  "<": "triangle-left", ">": "triangle-right", "x": "x", "P": "cross", "X": "x", "*": "star" };

// A finger scrolls the page; it does not zoom the map.
const TOUCH = matchMedia("(pointer: coarse)").matches;

// Of plotly.js' buttons those that stay in the page: others offer an upload.
const BUTTONS = [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]];
const NO_UPLOAD = { modeBarButtons: BUTTONS, showSendToCloud: false, plotlyServerURL: "", topojsonURL: "about:blank", displaylogo: false };

/** The layout that figures of plotly.js share, with letters of `size` pixels. */
const figureLayout = size => ({ font: { family: FONT, size, color: shade.ink }, hovermode: "closest", paper_bgcolor: shade.paper, plot_bgcolor: shade.paper,
  hoverlabel: { bgcolor: shade.paper, bordercolor: shade.ink, font: { family: FONT, color: shade.ink } },
  modebar: { bgcolor: "rgba(0,0,0,0)", color: shade.faint, activecolor: shade.ink } });
