// Very many tiles in groups: only the rows on the screen, and a few beside it, are in the document.

import { h } from "./dom.js";
import { tileOf } from "./tiles.js";

// Least width, height and gap of a tile (rem), by how many there are: few fill a wall, very many fit on it.
const SIZES = { large: [14, 7.2, 0.6], middle: [11.8, 6, 0.5], small: [8.2, 3.3, 0.3] };
// Share of the screen above and below it in which rows are in the document, too: more costs each change of the list.
const BESIDE = 1 / 8;
const PHONE = 640;
// From this width on it is a wall: few tiles grow until they fill it.
const WALL = 1800, SCALES = [2, 1.6, 1.3];

export class Board {
  constructor() {
    this.element = h("div", { class: "board" });
    this.sections = [];
    this.home = null;
    this.element.addEventListener("keydown", (event) => this.walk(event));
    this.element.addEventListener("focusin", (event) => event.target.dataset.id && this.settle(event.target.dataset.id));
    this.paint = this.paint.bind(this);
    this.resized = () => this.layout();
    addEventListener("scroll", this.paint, { passive: true });
    addEventListener("resize", this.resized);
  }

  end() {
    removeEventListener("scroll", this.paint);
    removeEventListener("resize", this.resized);
  }

  /** Shows groups of loops: [{ title, note, items }]; a group without a title has no head. */
  show(groups) {
    const focused = this.element.contains(document.activeElement) ? document.activeElement.dataset.id : null;
    const key = JSON.stringify(groups.map(({ title, note, items }) => [title, note, items.length]));
    if (key !== this.key) {
      this.key = key;
      this.sections = groups.map(({ title, note }) => {
        const list = h("div", { class: "tiles" });
        return { list, rows: new Map(), element: h("section", { class: "unit" }, title ? h("h2", null, title, h("small", null, note)) : null, list) };
      });
      this.element.replaceChildren(...this.sections.map((section) => section.element));
      this.width = null;
    }
    groups.forEach(({ items }, i) => (this.sections[i].items = items));
    this.place = new Map();
    this.sections.forEach((section, s) => section.items.forEach((item, i) => this.place.set(item.id, [s, i])));
    // In the tab order stands the tile that was last visited, else the first.
    if (!this.visited || !this.place.has(this.home)) this.home = this.sections.find((section) => section.items.length)?.items[0].id ?? null;
    this.layout();
    if (focused && this.place.has(focused)) this.focus(focused, false);
  }

  /** The height of every group follows from its number of tiles: nothing has to be measured but the width. */
  layout() {
    const count = this.place?.size ?? 0, size = count <= 30 ? "large" : count <= 300 ? "middle" : "small";
    const width = this.element.clientWidth;
    // On a phone the height changes with every scroll that hides the address bar, and nothing depends on it.
    const height = innerWidth >= WALL ? innerHeight : 0;
    if (width !== this.width || height !== this.height || size !== this.element.dataset.size) {
      this.width = width;
      this.height = height;
      this.element.dataset.size = size;
      const rem = parseFloat(getComputedStyle(document.documentElement).fontSize), scale = size === "large" ? this.scale(rem) : 1;
      const [least, tall, gap] = SIZES[size].map((value) => value * rem * scale);
      const phone = innerWidth <= PHONE ? (size === "small" ? 3 : 2) : 1;
      this.columns = Math.max(phone, Math.floor((width + gap) / (least + gap)));
      this.step = Math.round(tall + gap);
      this.element.style.setProperty("--columns", this.columns);
      this.element.style.setProperty("--scale", scale);
      this.element.style.setProperty("--row", `${this.step - gap}px`);
      for (const { rows } of this.sections) {
        rows.forEach((row) => row.remove());
        rows.clear();
      }
    }
    for (const section of this.sections) section.list.style.height = `${Math.ceil(section.items.length / this.columns) * this.step}px`;
    // One measurement for all: where each group begins.
    const top = this.element.getBoundingClientRect().top;
    for (const section of this.sections) section.top = section.list.getBoundingClientRect().top - top;
    this.paint();
  }

  /** How much larger than usual few tiles may be, so that all of them are still on the screen. */
  scale(rem) {
    const room = innerHeight - this.element.getBoundingClientRect().top - scrollY - 2 * rem;
    const fits = (scale) => {
      const [least, height, gap] = SIZES.large.map((value) => value * rem * scale), columns = Math.max(1, Math.floor((this.width + gap) / (least + gap)));
      const rows = this.sections.reduce((sum, { items }) => sum + Math.ceil(items.length / columns), 0);
      return rows * (height + gap) + 3 * rem * (this.sections.length - 1) <= room;
    };
    return (innerWidth >= WALL && SCALES.find(fits)) || 1;
  }

  paint() {
    if (!this.columns) return;
    const top = this.element.getBoundingClientRect().top, from = -top - BESIDE * innerHeight, to = -top + (1 + BESIDE) * innerHeight;
    for (const section of this.sections) {
      const last = Math.ceil(section.items.length / this.columns) - 1;
      const first = Math.max(0, Math.floor((from - section.top) / this.step)), end = Math.min(last, Math.floor((to - section.top) / this.step));
      for (const [at, row] of section.rows) {
        if (at >= first && at <= end) continue;
        row.remove();
        section.rows.delete(at);
      }
      for (let at = first; at <= end; at++) this.row(section, at);
      if (section.rows.size) section.list.setAttribute("role", "list");
      else section.list.removeAttribute("role");
    }
    const there = this.element.querySelector('.tile[tabindex="0"]');
    if (!there || there.dataset.id !== this.home) {
      if (there) there.tabIndex = -1;
      const home = this.element.querySelector(`.tile[data-id="${CSS.escape(this.home ?? "")}"]`) ?? this.element.querySelector(".tile");
      if (home) home.tabIndex = 0;
    }
  }

  row(section, at) {
    let row = section.rows.get(at);
    if (!row) {
      row = h("div", { class: "row" });
      row.style.transform = `translateY(${at * this.step}px)`;
      section.rows.set(at, row);
      section.list.append(row);
    }
    const links = section.items.slice(at * this.columns, (at + 1) * this.columns).map(tileOf);
    if (row.childElementCount === links.length && links.every((link, i) => row.children[i].firstChild === link)) return;
    row.replaceChildren(...links.map((link, i) => h("div", { role: "listitem", "aria-setsize": section.items.length, "aria-posinset": at * this.columns + i + 1 }, link)));
  }

  settle(id) {
    this.visited = true;
    this.home = id;
    this.paint();
  }

  /** Brings a loop's tile onto the screen and into focus. */
  focus(id, scroll = true) {
    const [s, i] = this.place.get(id), section = this.sections[s], y = this.element.getBoundingClientRect().top + section.top + Math.floor(i / this.columns) * this.step;
    const bar = document.querySelector(".bar")?.offsetHeight ?? 0;
    if (scroll && y < bar + 8) scrollBy(0, y - bar - 8);
    else if (scroll && y + this.step > innerHeight) scrollBy(0, y + this.step - innerHeight + 8);
    this.home = id;
    this.paint();
    this.element.querySelector(`.tile[data-id="${CSS.escape(id)}"]`)?.focus({ preventScroll: true });
  }

  // Arrow keys walk over the tiles as they lie on the screen; one tile at a time is in the tab order.
  walk(event) {
    const at = this.place?.get(event.target.dataset?.id);
    // With these keys they are the browser's, as for the page before.
    if (!at || event.ctrlKey || event.metaKey || event.altKey) return;
    const [s, i] = at, n = this.sections[s].items.length, here = (k) => this.sections[s].items[k]?.id;
    const next = () => this.sections.slice(s + 1).find((section) => section.items.length)?.items[0].id;
    const before = () => this.sections.slice(0, s).findLast((section) => section.items.length)?.items.at(-1).id;
    const lastRow = Math.floor((n - 1) / this.columns);
    const down = () => here(i + this.columns) ?? (Math.floor(i / this.columns) < lastRow ? here(n - 1) : next());
    const to = { ArrowRight: () => here(i + 1) ?? next(), ArrowLeft: () => (i > 0 ? here(i - 1) : before()), ArrowDown: down, ArrowUp: () => (i >= this.columns ? here(i - this.columns) : before()), Home: () => this.sections.find((section) => section.items.length)?.items[0].id, End: () => this.sections.findLast((section) => section.items.length)?.items.at(-1).id }[event.key];
    if (!to) return;
    event.preventDefault();
    const id = to();
    if (id !== undefined) this.focus(id);
  }
}
