// Elements from code. Whatever comes from the plant becomes a text node or an attribute's value, never markup.

const SVG = "http://www.w3.org/2000/svg";

function build(node, properties, children) {
  for (const [name, value] of Object.entries(properties ?? {})) {
    if (value === undefined || value === null || value === false) continue;
    if (name === "on") for (const [event, listener] of Object.entries(value)) node.addEventListener(event, listener);
    else node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return node;
}

/** An HTML element; children are elements or text. */
export const h = (tag, properties, ...children) => build(document.createElement(tag), properties, children);

/** An SVG element. */
export const s = (tag, properties, ...children) => build(document.createElementNS(SVG, tag), properties, children);

/** A box that scrolls sideways when it must, by keyboard too. */
export const scroll = (label, ...children) => h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": label }, ...children);

// What stands for a part of a row, whatever row it is in.
const nameOf = (part) => part.dataset.act ?? part.getAttribute("href") ?? part.textContent;

/** Draws the rows of a table anew; each has its own `key` among its data. What has the focus keeps it: what is called the same in the row of
 * the same key, else the first part of that row. */
export function redraw(body, rows, key) {
  const focused = body.contains(document.activeElement) ? document.activeElement : null, at = focused?.closest("tr")?.dataset[key];
  body.replaceChildren(...rows);
  if (at === undefined) return;
  const row = [...body.children].find((own) => own.dataset[key] === at), parts = [...(row?.querySelectorAll("a, button, summary") ?? [])];
  (parts.find((own) => nameOf(own) === nameOf(focused)) ?? parts[0])?.focus({ preventScroll: true });
}

export const byId = (id) => document.getElementById(id);

/** What the browser remembers; nothing where it is told not to remember. */
export const memory = {
  get(key) {
    try {
      return localStorage.getItem(key);
    } catch {
      return null;
    }
  },
  set(key, value) {
    try {
      localStorage.setItem(key, value);
    } catch {
      // Then it is asked for again.
    }
  },
};

let hiding = null;

/** Says something for some seconds, also to a screen reader. */
export function toast(text, bad = false) {
  const box = byId("toast");
  box.textContent = text;
  box.classList.toggle("bad", bad);
  box.hidden = false;
  clearTimeout(hiding);
  hiding = setTimeout(() => (box.hidden = true), bad ? 8000 : 4000);
}

/** The colour that a CSS variable stands for now, as a canvas can take it. */
export function colour(name) {
  const probe = byId("main");
  const before = probe.style.caretColor;
  probe.style.caretColor = `var(${name})`;
  const found = getComputedStyle(probe).caretColor;
  probe.style.caretColor = before;
  return found;
}
