// Light or dark: the system's setting, or the choice made here.
const system = matchMedia("(prefers-color-scheme: dark)");
let chosen = null;
try { chosen = localStorage.getItem("theme"); } catch { /* storage is switched off: follow the system */ }
const colours = new Map();
const listeners = [];

function apply() {
  document.documentElement.dataset.theme = chosen ?? (system.matches ? "dark" : "light");
  colours.clear();
  for (const listener of listeners) listener();
}

export function colour(name) {
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  return colours.get(name);
}

export function onTheme(listener) { listeners.push(listener); }

export function startTheme(button) {
  button.addEventListener("click", () => {
    chosen = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    try { localStorage.setItem("theme", chosen); } catch { /* holds until the page is closed */ }
    apply();
  });
  system.addEventListener("change", apply);
  apply();
}
