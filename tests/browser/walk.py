"""What every walk through the dashboard needs: a reader's page, pictures of it, and what is checked everywhere."""

import importlib.resources
import json
from pathlib import Path

from playwright.sync_api import expect

AXE = importlib.resources.files("axe_playwright_python").joinpath("axe.min.js").read_text()
expect.set_options(timeout=15_000)


def check(condition, what):
    if not condition:
        raise AssertionError(what)
    print(f"ok: {what}")


class Walk:
    def __init__(self, browser, base, out):
        self.browser, self.base, self.out, self.faults = browser, base, Path(out), []
        self.page = None

    def open(self, width, height, scheme="light", zone="UTC"):
        """A new context: a new reader with an empty storage."""
        self.close()
        context = self.browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme, timezone_id=zone)
        self.page = context.new_page()
        self.page.on("console", lambda m: self.faults.append(f"console: {m.text} {m.location.get('url', '')}") if m.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda error: self.faults.append(f"error: {error}"))
        self.page.on("dialog", lambda dialog: (self.faults.append(f"a script ran: {dialog.message}"), dialog.dismiss()))
        return self.page

    def close(self):
        """A page that is gone asks for nothing more, and an answer that is still changed on its way comes to nobody."""
        if self.page:
            self.page.goto("about:blank")
            self.page.unroute_all(behavior="ignoreErrors")
            self.page.context.close()

    def go(self, route=""):
        is_new = self.page.url == "about:blank"
        self.page.goto(f"{self.base}/#/{route}")
        # In a page that is there already nothing is loaded where only what stands behind # is another.
        if not is_new:
            self.page.reload()

    def shot(self, name, whole=False):
        # Tiles out of sight are not laid out; a picture of the whole page needs no more than what is seen.
        self.page.screenshot(path=self.out / f"{name}.png", full_page=whole)

    def axe(self, what):
        """With the page's own policy scripts cannot be injected: they are evaluated by the debugger."""
        self.page.evaluate(AXE)
        found = self.page.evaluate("async () => (await axe.run(document, {resultTypes: ['violations']})).violations")
        serious = [v for v in found if v["impact"] in ("serious", "critical")]
        detail = [(v["id"], [n["html"][:160] for n in v["nodes"][:3]], [n.get("failureSummary", "")[:300] for n in v["nodes"][:1]]) for v in serious]
        check(not serious, f"axe finds nothing serious in {what}" + (f": {json.dumps(detail, indent=1)}" if detail else ""))

    def tab_to(self, selector, most=120):
        """Presses Tab until the element has the focus: what a keyboard can reach."""
        for _ in range(most):
            self.page.keyboard.press("Tab")
            if self.page.evaluate("(s) => document.activeElement?.matches(s)", selector):
                return
        raise AssertionError(f"{selector} cannot be reached by Tab")

    def fits(self, what):
        wide = self.page.evaluate("document.documentElement.scrollWidth - innerWidth")
        over = self.page.evaluate("[...document.querySelectorAll('main *')].filter(e => e.getBoundingClientRect().right > innerWidth + 1 && !e.closest('.scroll')).slice(0, 5).map(e => e.outerHTML.slice(0, 100))")
        check(wide <= 0, f"{what} needs no sideways scrolling {over if wide > 0 else ''}")
