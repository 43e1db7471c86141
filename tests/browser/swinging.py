"""The work list, the groups of loops that swing together, and a loop's indicators."""

import re

from playwright.sync_api import expect

from trouble import patch
from walk import check


# Loops whose cause is not known and that are among those to do something about.
MISPLACED = """() => {
  let part = "";
  return [...document.querySelectorAll("tbody tr")].flatMap((row) => {
    if (row.className === "part") part = row.textContent;
    const is_unknown = row.dataset.id && row.children[2].textContent.startsWith("unknown");
    return is_unknown && !part.startsWith("Not at rest") ? [row.dataset.id] : [];
  });
}"""


def swinging(walk):
    page = walk.open(1366, 900)
    walk.go("work")
    row = page.locator("tbody tr[data-id]")
    expect(row.first).to_be_visible(timeout=60_000)
    source = row.first.get_attribute("data-id")
    check(any(state in row.first.text_content() for state in ("open", "unexplained")), f"{source} is to be looked at")
    check("to do" in page.locator(".summary").text_content(), "how much there is to do is told")
    check(page.evaluate(MISPLACED) == [], "a loop whose cause is not known is listed apart")
    walk.shot("work", whole=True)
    walk.axe("the work list, light")
    walk.tab_to(f"[data-act='Order {source}']")
    page.keyboard.press("Enter")
    page.get_by_label("Your name").fill("A. Fitter")
    page.get_by_label("Note").fill("order 4711")
    page.keyboard.press("Tab")
    page.get_by_role("dialog").get_by_role("button", name="Order", exact=True).press("Enter")
    line = page.locator(f"tr[data-id='{source}']")
    expect(line).to_contain_text("ordered")
    expect(line).to_contain_text("A. Fitter: order 4711")
    check(True, "the work is ordered by keyboard alone, with a name and a note")
    page.keyboard.press("p")
    expect(page.locator(".tile").first).to_be_visible()
    page.keyboard.press("w")
    expect(line).to_contain_text("ordered")

    walk.go("groups")
    group = page.locator("[data-group='1']")
    expect(group).to_contain_text("swing together")
    walk.axe("the groups, light")
    group.get_by_role("link", name="Group 1").click()
    expect(page.locator(".swing svg")).to_have_count(4)
    shapes = page.locator(".swing polyline").count()
    check(shapes >= 6 and page.locator(".swing script, .swing foreignObject").count() == 0, f"trends and spectra of {shapes // 2} loops are drawn")
    check(page.locator(".swing polyline.look").count() == 2, "the likeliest source stands out in both")
    walk.shot("group", whole=True)
    walk.axe("a group, light")

    check("Arrow: comes later" in page.locator(".swing figcaption").nth(2).text_content(), "the graph says what an arrow and a line mean")
    cause = {"time": "2026-01-01T00:00:00Z", "name": "neighbour", "probability": 0.88, "why": "it swings with 3 others", "neighbour": "FIC9", "causes": []}
    detail = re.compile(rf"/api/v1/loops/{source}$")
    patch(page, detail, lambda answer: answer.update(cause=cause))
    walk.go(f"loop/{source}")
    expect(page.locator("p.cause")).to_have_text(re.compile(r"^Cause by the look at the plant of .+: neighbour FIC9, 88 %: it swings with 3 others\.$"))
    expect(page.locator("p.cause a")).to_have_attribute("href", "#/loop/FIC9")
    page.unroute(detail)
    expect(page.locator(".spark").first).to_be_visible()
    card = page.locator(".card", has=page.locator("h2", has_text="Health"))
    check("Harris index" in card.text_content() and "week" in card.text_content(), "indicators are shown over hour, shift, day and week")
    card.screenshot(path=walk.out / "health.png")

    for name, width, height, scheme in [("dark", 1366, 900, "dark"), ("phone", 390, 844, "light")]:
        page = walk.open(width, height, scheme)
        for route, ready in [("work", "tbody tr"), ("groups/1", ".swing svg")]:
            walk.go(route)
            expect(page.locator(ready).first).to_be_visible()
            walk.shot(f"{route.split('/')[0]}-{name}", whole=True)
            walk.axe(f"{route}, {name}")
            if width < 500:
                walk.fits(f"{route} on a phone")
